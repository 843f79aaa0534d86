# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What every test starts from: an LLVM found as the product finds it, fixed seeds, an empty run folder."""

from __future__ import annotations

import importlib.util
import os
import random
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from fipt_blender.core.device.llvm import LLVM_VARIABLE, companions, find_llvm  # noqa: E402
from fipt_blender.core.device.probe import preload  # noqa: E402
from fipt_blender.core.job.errors import FiptError  # noqa: E402
from fipt_blender.core.job.runfolder import RunFolder  # noqa: E402
from fipt_blender.core.job.settings import make_settings  # noqa: E402


def pytest_configure(config: pytest.Config) -> None:
    """Choose LLVM before any test module imports Mitsuba, where that is there: Dr.Jit looks for it once."""
    if importlib.util.find_spec("mitsuba") is None:  # tests/matrix.py: Blender's side alone
        return
    try:
        library = find_llvm(Path(sys.executable))
    except FiptError as error:
        raise pytest.UsageError(str(error)) from None
    preload(companions(library))
    os.environ[LLVM_VARIABLE] = str(library)
    # As in the engine: torch's threads must not spin while Dr.Jit's or another process's work.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


@pytest.fixture(autouse=True)
def fixed_seeds() -> None:
    """Python's and numpy's global generators start alike in every test."""
    random.seed(0)
    np.random.seed(0)


@pytest.fixture(scope="module")
def registered() -> Iterator[None]:
    """The add-on in the Blender that runs the test."""
    import fipt_blender

    fipt_blender.register()
    yield
    fipt_blender.unregister()


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Torch on one thread: networks as small as the tests' lose more by waiting for a second one."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded generator."""
    return np.random.default_rng(0)


@pytest.fixture
def run_folder(tmp_path: Path) -> RunFolder:
    """A new run folder with the draft preset's settings."""
    run = RunFolder(tmp_path / "run")
    run.create(make_settings("draft"))
    return run
