"""The preferences: their values, what survives a removal, set-up and check, clearing, drawing, start-up."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest

import fipt_blender
from fipt_blender import machine
from fipt_blender.bridge import pins, places, storage
from fipt_blender.bridge.interpreter import PYTHON_VARIABLE
from fipt_blender.core.device.cuda import VISIBLE_VARIABLE
from fipt_blender.core.run.lock import hold
from fipt_blender.core.run.runfolder import PRODUCT_VERSION, RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import data_job, running
from fipt_blender.jobs.tasks import begin
from fipt_blender.operators import environment as operators
from fipt_blender.panels import preferences as panel
from samples.child_processes import SLEEPER
from samples.enabling import needless
from samples.layouts import Layout
from samples.operator_calls import refused
from samples.refusals import error_of
from samples.stand_in_jobs import tick_until

OLD = time.time() - 86400
GPUS = [{"name": f"Card {n}", "uuid": f"GPU-{n}", "memory_gb": 8.0} for n in (1, 2)]


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The default data folder of the test."""
    monkeypatch.setenv(places.DATA_VARIABLE, str(tmp_path / "data"))
    monkeypatch.delenv(PYTHON_VARIABLE, raising=False)
    return tmp_path / "data"


def enable() -> Any:
    """Enable the package as an add-on is."""
    addon = bpy.context.preferences.addons.new()
    addon.module = fipt_blender.__name__
    fipt_blender.register()
    return addon


def disable(addon: Any) -> None:
    fipt_blender.unregister()
    bpy.context.preferences.addons.remove(addon)


@pytest.fixture
def values(data: Path) -> Iterator[Any]:
    """The preferences of the package."""
    addon = enable()
    yield addon.preferences
    disable(addon)


def make_run(data: Path, name: str, modified: float = OLD) -> RunFolder:
    run = RunFolder(data / "runs" / name)
    run.create(make_settings("draft"))
    (run.results / "fields.npz").write_bytes(b"x" * 1000)
    age(run.root, modified)
    return run


def age(folder: Path, modified: float) -> None:
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (modified, modified))


def make_environment(data: Path, groups: dict[str, list[str]]) -> Path:
    folder = data / pins.environment_name(groups, sys.version_info[:2])
    folder.mkdir(parents=True)
    (folder / pins.STAMP_NAME).write_text(json.dumps({"complete": True}))
    return folder


def check_result(**changes: Any) -> dict[str, Any]:
    engine = {"python": "3.11.7", "interpreter": "/python", "packages": {"mitsuba": "3.9.1", "torch": None}}
    engine |= {"llvm": "/usr/lib/libLLVM.so.19.1", "cuda": None, "gpus": GPUS, "device": "llvm", "oidn": True}
    engine |= {"cores": 8, "memory_gb": 32.0, "memory_free_gb": 20.0, "ready": True, **changes}
    return {"time": 0.0, "product_version": PRODUCT_VERSION, "engine": engine, "warnings": [], "error": None}


def test_values_and_a_data_folder_of_the_users_own(values: Any, data: Path, tmp_path: Path) -> None:
    assert machine.get_preferences() == values
    values.data_folder, values.device = str(tmp_path / "own"), "llvm"
    assert machine.data_folder() == tmp_path / "own" and machine.device_setting() == "llvm"
    values.engine_python = str(tmp_path / "gone")
    assert error_of(machine.engine_python).code == "engine-missing"


def test_gpu_is_chosen_by_its_identity(values: Any) -> None:
    assert values.gpu == "AUTO" and machine.engine_variables() == {}
    machine.store_status(check_result())
    values.gpu = "GPU-2"
    assert machine.engine_variables() == {VISIBLE_VARIABLE: "GPU-2"}
    machine.store_status(check_result(gpus=GPUS[1:]))
    assert values.gpu == "GPU-2", "the list changed, the card did not"
    machine.store_status(check_result(gpus=[]))
    assert values.gpu == "GPU-2", "a card that is gone is shown as such, not replaced in silence"
    values.gpu = "AUTO"
    assert machine.chosen_gpu() == ""


def test_kept_values_return_after_a_removal_but_override_none(data: Path) -> None:
    addon = enable()
    addon.preferences.data_folder, addon.preferences.device = str(data / "far"), "cuda"
    machine.store_status(check_result())
    disable(addon)
    addon = enable()
    assert (addon.preferences.data_folder, addon.preferences.device) == (str(data / "far"), "cuda")
    assert machine.status() == check_result()
    disable(addon)
    file = data / machine.KEPT_NAME
    file.write_text(json.dumps({"device": "NONSENSE", "gpu_uuid": "GPU-2", "on_close": "KEEP"}))
    addon = enable()
    assert (addon.preferences.device, addon.preferences.gpu_uuid) == ("auto", "GPU-2")
    disable(addon)
    file.write_text("{")
    disable(enable())


def test_check_looks_at_the_engine_and_keeps_what_it_saw(values: Any, data: Path) -> None:
    assert bpy.ops.fipt.check_engine() == {"FINISHED"}
    status = machine.status()
    assert status["engine"]["ready"] is True and status["error"] is None
    assert panel.headline(status)[1] == "CHECKMARK"
    assert "check" in (data / "environment.log").read_text()
    assert json.loads((data / machine.KEPT_NAME).read_text())["status"] == values.status


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands for Python")
def test_broken_interpreters_are_explained(values: Any, tmp_path: Path) -> None:
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\nexit 3\n")
    broken.chmod(0o755)
    for interpreter in (tmp_path / "gone", broken, tmp_path):
        values.engine_python = str(interpreter)
        assert "can't be used" in refused(bpy.ops.fipt.check_engine)
        assert machine.status()["error"]["code"] == "engine-missing"
        assert panel.headline(machine.status())[1] == "ERROR"


def test_set_up_says_why_it_can_not(values: Any, tmp_path: Path) -> None:
    system = bpy.context.preferences.system
    system.use_online_access = False
    assert not bpy.ops.fipt.set_up_engine.poll()
    system.use_online_access = True
    assert bpy.ops.fipt.set_up_engine.poll()
    values.engine_python = "/python"
    assert not bpy.ops.fipt.set_up_engine.poll()
    values.engine_python = ""
    system.use_online_access = False
    values.wheel_folder = str(tmp_path / "wheels")
    assert bpy.ops.fipt.set_up_engine.poll(), "a folder of wheels needs no network"
    assert "does not exist" in refused(bpy.ops.fipt.set_up_engine)
    (tmp_path / "wheels").mkdir()
    assert "does not contain the wheels" in refused(bpy.ops.fipt.set_up_engine)
    assert machine.status()["error"]["code"] == "wheels-missing"


def test_set_up_runs_beside_the_users_work_and_is_cancelled(
    values: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values.wheel_folder = str(tmp_path)
    failure = {"code": "pip-missing", "text": "Python has neither pip nor ensurepip.", "remedy": "Install it."}
    machine.store_status({"error": failure})
    monkeypatch.setattr(data_job, "setup_command", lambda *arguments: [sys.executable, "-c", SLEEPER])
    begin(operators.set_up_engine(bpy.context.scene), bpy.context.scene, wait=False)
    for _ in range(3):
        running.tick()
    assert not bpy.ops.fipt.check_engine.poll() and bpy.ops.fipt.cancel.poll()
    bpy.ops.fipt.cancel()
    tick_until(lambda: running.current() is None)
    assert machine.status() == {"error": failure, "cancelled": True}
    panel.draw(layout := Layout(), bpy.context, values)
    assert "set-up cancelled, press Set Up Engine" in " ".join(layout.drawn)
    assert "ensurepip" not in " ".join(layout.drawn)
    assert not bpy.ops.fipt.cancel.poll()


def test_clearing_takes_what_is_ours_and_unused(values: Any, data: Path) -> None:
    groups = pins.read_pins()
    old, used, held, fresh = (make_run(data, name) for name in ("old", "used", "held", "fresh"))
    age(fresh.root, time.time())
    foreign = data / "runs" / "photographs"
    foreign.mkdir()
    (foreign / "a.exr").touch()
    empty = machine.new_run_folder("empty")
    age(empty, OLD)
    current, other = make_environment(data, groups), make_environment(data, {"engine": ["torch==1"]})
    runs, environments = {old.root, used.root, held.root, fresh.root, empty}, {current, other}
    assert {item.folder for item in storage.list_items(data)} == runs | environments
    assert storage.size(old.root) > 1000
    bpy.context.scene.fipt.run_folder = str(used.root)
    with hold(held, ["estimate"]):
        age(held.root, OLD)
        assert bpy.ops.fipt.clear_data() == {"FINISHED"}
    bpy.context.scene.fipt.run_folder = ""
    assert not old.root.exists() and not empty.exists()
    assert used.root.exists() and held.root.exists() and fresh.root.exists() and foreign.exists()
    assert current.exists() and other.exists()
    assert bpy.ops.fipt.clear_data(names=other.name) == {"FINISHED"}
    assert current.exists() and not other.exists()


def test_clearing_never_takes_what_is_named_but_not_ours(values: Any, data: Path, tmp_path: Path) -> None:
    outside = make_run(tmp_path / "elsewhere", "mine")
    make_run(data, "kept", time.time())
    link = data / "runs" / "link"
    link.symlink_to(outside.root)
    for name in ("..", "link", "photographs", str(outside.root)):
        assert "no run and no environment" in refused(bpy.ops.fipt.clear_data, names=name)
    assert bpy.ops.fipt.clear_data(names="kept;") == {"FINISHED"}
    assert (data / "runs" / "kept").exists(), "it changed just now"
    assert outside.fields_npz.exists() and link.exists()
    item = storage.Item(storage.RUN, outside.root, OLD)
    assert error_of(list, storage.delete(item, data, [])).code == "run-foreign"


def test_images_of_the_open_file_keep_their_run(values: Any, data: Path) -> None:
    run = make_run(data, "textured")
    image = bpy.data.images.new("fipt-test", 4, 4)
    image.filepath = str(run.textures / "base.png")
    bpy.ops.fipt.clear_data()
    assert run.root.exists()
    bpy.data.images.remove(image)
    bpy.ops.fipt.clear_data()
    assert not run.root.exists()


def test_drawing_asks_no_disk_and_starts_nothing(values: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    machine.store_status(check_result())
    values_draw = panel.FIPT_Preferences.draw
    stand_in = type("Self", (), {"layout": Layout(), "status": values.status})()
    for name in machine.Preferences.__dataclass_fields__:
        setattr(stand_in, name, getattr(values, name))
    for name in ("builtins.open", "os.open", "os.stat", "os.listdir", "os.scandir", "subprocess.Popen"):
        monkeypatch.setattr(name, lambda *_, name=name, **options: pytest.fail(f"draw calls {name}"))
    values_draw(stand_in, bpy.context)


START = """
import json, sys
import bpy
sys.path.insert(0, sys.argv[1])
before = set(sys.modules)
import fipt_blender
fipt_blender.register()
loaded = set(sys.modules) - before
names = {"classes": sorted(name for name in dir(bpy.types) if name.upper().startswith("FIPT_"))}
fipt_blender.unregister()
names["left"] = sorted(name for name in dir(bpy.types) if name.upper().startswith("FIPT_"))
names["state"] = hasattr(bpy.types.Scene, "fipt")
print(json.dumps({"loaded": sorted(loaded), **names}), flush=True)
import os
os._exit(0)
"""


def test_enabling_loads_only_what_it_needs_and_disabling_leaves_nothing() -> None:
    command = [sys.executable, "-c", START, str(places.PACKAGE_FOLDER.parent)]
    result = subprocess.run(command, capture_output=True, text=True)
    answer = json.loads(result.stdout.splitlines()[-1])
    assert needless(answer["loaded"], "fipt_blender") == []
    assert "FIPT_OT_set_up_engine" in answer["classes"]
    assert answer["left"] == [] and answer["state"] is False
