# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints: kept for the same input, dropped for another; a full disk is said so, with no half files."""

import errno
import os
import pickle
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import torch

mi.set_variant("llvm_ad_rgb")

from fipt_blender.core.job.checkpoints import Checkpoints, input_key  # noqa: E402
from fipt_blender.core.job.errors import FiptError  # noqa: E402
from fipt_blender.core.job.runfolder import RunFolder, explained_write_errors, write_json  # noqa: E402
from fipt_blender.core.job.settings import Settings  # noqa: E402
from fipt_blender.core.material.fields import Fields, RoomFields  # noqa: E402
from fipt_blender.core.material.networks import BrdfNetwork  # noqa: E402
from fipt_blender.core.material.seen import Box, seen_cells  # noqa: E402
from fipt_blender.core.scene.pixels import open_array  # noqa: E402

SMALL = Settings(hash_levels=2, hash_log2_size=6, brdf_width=8)


def test_stages_are_remembered_for_the_same_input_only(tmp_path: Path) -> None:
    first = Checkpoints(tmp_path / "stage", "a")
    first.remember("scale", 0.25)
    first.mark("pixels", {"seconds": 2.0})
    first.save_tensors("networks-0", {"x": torch.arange(3)})
    again = Checkpoints(tmp_path / "stage", "a")
    assert again.done("pixels") and not again.done("shadings") and again.recall("scale") == 0.25
    assert again.facts() == [{"name": "pixels", "seconds": 2.0}]
    assert again.load_tensors("networks-0", torch.device("cpu"))["x"].tolist() == [0, 1, 2]
    other = Checkpoints(tmp_path / "stage", "b")
    assert not other.done("pixels") and list((tmp_path / "stage").iterdir()) == []
    (tmp_path / "stage" / "stages.json").write_text("{ cut off")
    assert not Checkpoints(tmp_path / "stage", "b").done("pixels")


def test_the_key_follows_all_that_matters(tmp_path: Path) -> None:
    file = tmp_path / "capture.json"
    file.write_text("one")
    key = input_key(SMALL, [file])
    assert input_key(replace(SMALL), [file]) == key
    for later in (
        {"texel_density": 5.0},
        {"write_back": "paper"},
        {"checkpoint_steps": 7},
        {"preset": "high"},
    ):
        assert input_key(replace(SMALL, **later), [file]) == key
    for changed in ({"seed": 1}, {"training_steps": 7}, {"lambda_part": 0.5}, {"device": "llvm"}):
        assert input_key(replace(SMALL, **changed), [file]) != key
    file.write_text("two")
    assert input_key(SMALL, [file]) != key


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_damaged_weights_are_an_error_of_ours_and_run_no_code(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path / "stage", "a")

    class Touch:
        def __reduce__(self):
            return (open, (str(tmp_path / "touched"), "w"))

    (tmp_path / "stage" / "bad.pt").write_bytes(pickle.dumps(Touch()))
    with pytest.raises(FiptError) as caught:
        checkpoints.load_tensors("bad", torch.device("cpu"))
    assert caught.value.code == "file-damaged" and not (tmp_path / "touched").exists()


def to_full_disk(path: Path) -> None:
    """Let the temporary file beside `path` lie on a device that is always full."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(f".{os.getpid()}.{path.name}").symlink_to("/dev/full")


def save_fields(run: RunFolder) -> None:
    network = BrdfNetwork(SMALL, 2, torch.Generator(), torch.device("cpu"))
    box, part = Box(np.zeros(3), 1.0), np.zeros(1, np.int32)
    cells = seen_cells(box, np.zeros((1, 3), np.float32), part)
    RoomFields(Fields(network, box), part, cells).save(run)


WRITERS = {
    "results/fields.npz": save_fields,
    "results/emitters.json": lambda run: write_json(run.emitters_json, {"fixtures": [1] * 99}),
    "stage/weights.pt": lambda run: Checkpoints(run.stage, "a").save_tensors(
        "weights", {"x": torch.ones(9999)}
    ),
}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # a zip file closed twice
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_said_so_and_keeps_what_was_there(name: str, tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    run.create(SMALL)
    Checkpoints(run.stage, "a").mark("pixels", {})
    path = run.root / name
    path.write_text("what was there")
    to_full_disk(path)
    with pytest.raises(FiptError) as caught:
        WRITERS[name](run)
    assert caught.value.code == "disk-full" and str(path) in caught.value.text
    assert path.read_text() == "what was there"
    assert [entry.name for entry in path.parent.iterdir() if entry.name.startswith(".")] == []


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="only POSIX reserves blocks by call")
def test_mapped_arrays_reserve_their_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a full disk would end the process by SIGBUS at the first page that has no room."""
    array = open_array(tmp_path / "a.npy", (1000, 700), np.float32, create=True)
    assert (array == 0).all()
    assert (tmp_path / "a.npy").stat().st_blocks * 512 >= array.nbytes
    del array
    assert open_array(tmp_path / "a.npy", (1000, 700), np.float32, create=False).shape == (1000, 700)
    with pytest.raises(FiptError) as caught:
        open_array(tmp_path / "a.npy", (1000, 701), np.float32, create=False)
    assert caught.value.code == "file-damaged"

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(FiptError) as caught, explained_write_errors(tmp_path):
        open_array(tmp_path / "b.npy", (10, 3), np.float32, create=True)
    assert caught.value.code == "disk-full"
