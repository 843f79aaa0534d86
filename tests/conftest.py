"""What every test starts from: a device found as the product finds it, fixed seeds, an empty Blender file."""

from __future__ import annotations

import atexit
import importlib.util
import os
import random
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fipt_blender.core.capture import mesh_file
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from samples.mesh_process import MeshProcess

_STATUS = pytest.StashKey[int]()


def pytest_configure(config: pytest.Config) -> None:
    """Choose LLVM and Mitsuba's variant before any test module is imported, where Mitsuba is installed."""
    atexit.register(leave, config)  # the first one: it comes after all others
    os.fsync = lambda descriptor: None  # no test outlives a power failure, and waiting for the disk is slow
    if importlib.util.find_spec("mitsuba") is None:  # tests/matrix.py: Blender's side alone
        return
    # As in the engine: torch's threads must not spin while those of Dr.Jit or another process work.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ["OMP_NUM_THREADS"] = "1"  # quicker for networks as small as those of the tests
    try:
        # The engine's modules need a variant when they are imported, and torch must be imported after it.
        set_variant(os.environ.get("FIPT_TEST_DEVICE", "llvm"))
    except FiptError as error:
        raise pytest.UsageError(str(error)) from None
    import drjit

    # Workers share the cores: more threads than these take a fifth more of the processors' time.
    drjit.set_thread_count(max(1, (os.cpu_count() or 1) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Keep the status for `leave`."""
    session.config.stash[_STATUS] = int(exitstatus)


def leave(config: pytest.Config) -> None:
    """End without the destructors of bpy, in which the process may hang or crash after the last test."""
    if "bpy" in sys.modules and _STATUS in config.stash:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash[_STATUS])


@pytest.fixture(scope="session", autouse=True)
def meshes_are_read_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """One Blender reads each content of an OBJ or PLY file once; another one starts for a file that it refuses."""
    read = mesh_file.read_in_blender
    known: dict[tuple[str, bytes], tuple[np.ndarray, np.ndarray]] = {}
    here, blender, arrays = os.getpid(), MeshProcess(), tmp_path_factory.mktemp("mesh") / "mesh.npz"

    def once(path: Path, changed: int) -> tuple[np.ndarray, np.ndarray]:
        if path.suffix not in (".obj", ".ply"):  # others refer to more files
            return read(path, changed)
        content = path.suffix, path.read_bytes()
        if content not in known:
            if os.getpid() == here and blender.read(path, arrays):  # not in a fork of this process
                with np.load(arrays) as found:
                    known[content] = found["vertices"], found["triangles"]
            else:
                known[content] = read(path, changed)
        vertices, triangles = known[content]
        return vertices.copy(), triangles.copy()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mesh_file, "read_in_blender", once)
        yield
    blender.close()


@pytest.fixture(autouse=True)
def fixed_seeds() -> None:
    """Python's and numpy's global generators have the same seed in every test."""
    random.seed(0)
    np.random.seed(0)


@pytest.fixture(scope="module")
def factory_preferences(request: pytest.FixtureRequest) -> None:
    """A module that imports bpy starts with factory settings, which take six times an empty file's time."""
    if bpy := getattr(request.module, "bpy", None):
        bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture(autouse=True)
def empty_blender_file(request: pytest.FixtureRequest, factory_preferences: None) -> None:
    """Each test of a module that imports bpy starts with an empty file, as factory settings have it."""
    if bpy := getattr(request.module, "bpy", None):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


@pytest.fixture(scope="module")
def registered() -> Iterator[None]:
    """The add-on is registered in the Blender that runs the test."""
    import fipt_blender

    fipt_blender.register()
    yield
    fipt_blender.unregister()


@pytest.fixture
def bakes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The bakes of Apply Results, by an engine in this process that bakes constants."""
    from samples.applied_rooms import use_fake_engine

    return use_fake_engine(monkeypatch)


@pytest.fixture
def scene(tmp_path: Path, bakes: list[str]) -> Any:
    """An artist's room with a finished run (`samples.applied_rooms`); some modules define another scene."""
    from samples.applied_rooms import make_scene

    return make_scene(tmp_path / "run")


@pytest.fixture
def applied(scene: Any) -> Any:
    """The scene with its run's results."""
    import bpy

    assert bpy.ops.fipt.apply_results("EXEC_DEFAULT") == {"FINISHED"}
    return scene


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def run_folder(tmp_path: Path) -> RunFolder:
    """A new run folder with the draft preset's settings."""
    run = RunFolder(tmp_path / "run")
    run.create(make_settings("draft"))
    return run
