# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a run on a full disk, and damaged ones: clear errors, no partial files, no code that runs."""

import errno
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.inference import Fields
from fipt_blender.core.material.networks import BrdfNetwork
from fipt_blender.core.material.reliability import PlaceColors, part_detail
from fipt_blender.core.material.seen import Box, seen_cells
from fipt_blender.core.material.training import load_tensors, save_tensors
from fipt_blender.core.pixels.store import open_array
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, explained_write_errors, write_json
from fipt_blender.core.run.settings import Settings
from samples.refusals import error_of

SMALL = Settings(rounds=2, hash_levels=2, hash_log2_size=6, brdf_width=8)


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_damaged_weights_are_an_error_of_ours_and_run_no_code(tmp_path: Path) -> None:
    path = tmp_path / "bad.pt"

    class Touch:
        def __reduce__(self):
            return (open, (str(tmp_path / "touched"), "w"))

    path.write_bytes(pickle.dumps(Touch()))
    caught = error_of(load_tensors, path, torch.device("cpu"))
    assert caught.code == "file-damaged" and not (tmp_path / "touched").exists()


def to_full_disk(path: Path) -> None:
    """Put the temporary file beside `path` on a device that is always full."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(f".{os.getpid()}.{path.name}").symlink_to("/dev/full")


BOX = Box(np.zeros(3), 1.0)


def room_fields(points: np.ndarray, *detail: object) -> RoomFields:
    """Of a room of one unit that was seen at these points (N, 3)."""
    network = BrdfNetwork(SMALL, 2, np.full((2, 5), 0.5), torch.Generator(), torch.device("cpu"))
    cells = seen_cells(BOX, [(points, np.zeros(len(points), np.int32))])
    errors = [np.full((len(cells.keys), 3), 0.02, np.float32), 0.0] if detail else []
    return RoomFields(Fields(network, BOX), Units(np.zeros(1, np.int32), np.ones(1, bool)), cells, *errors, *detail)


WRITERS = {
    "results/fields.npz": lambda run: room_fields(np.zeros((1, 3), np.float32)).save(run),
    "results/emitters.json": lambda run: write_json(run.emitters_json, {"fixtures": [1] * 99}),
    "stage/weights.pt": lambda run: save_tensors(run.stage / "weights.pt", {"x": torch.ones(9999)}),
}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # a zip file closed twice
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_said_so_and_keeps_what_was_there(name: str, tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    run.create(SMALL)
    run.stage.mkdir(exist_ok=True)
    path = run.root / name
    path.write_text("what was there")
    to_full_disk(path)
    caught = error_of(WRITERS[name], run)
    assert caught.code == "disk-full" and str(path) in caught.text
    assert path.read_text() == "what was there"
    assert [entry.name for entry in path.parent.iterdir() if entry.name.startswith(".")] == []


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="only POSIX reserves blocks by call")
def test_mapped_arrays_reserve_their_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a full disk would end the process by SIGBUS at the first page without space."""
    array = open_array(tmp_path / "a.npy", (1000, 700), np.float32, create=True)
    assert (array == 0).all()
    assert (tmp_path / "a.npy").stat().st_blocks * 512 >= array.nbytes
    del array
    assert open_array(tmp_path / "a.npy", (1000, 700), np.float32, create=False).shape == (1000, 700)
    caught = error_of(open_array, tmp_path / "a.npy", (1000, 701), np.float32, create=False)
    assert caught.code == "file-damaged"

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(FiptError, match="full"), explained_write_errors(tmp_path):
        open_array(tmp_path / "b.npy", (10, 3), np.float32, create=True)


def test_the_detail_of_parts_is_kept_with_the_fields(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    run.create(SMALL)
    part, rng = np.zeros(200, np.int32), np.random.default_rng(0)
    points = rng.random((200, 3)).astype(np.float32)
    color = rng.random((200, 3))
    places = PlaceColors(points, part, color, np.stack([color] * 2), np.ones((2, 200)), np.zeros(200))
    saved = room_fields(points, part_detail(places, np.array([[0.1, 0.2, 0.3]]), 0.02, BOX))
    saved.save(run)
    for one, other in zip(saved.query(points, part), RoomFields.load(run).query(points, part), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)
    with np.load(run.fields_npz) as data:
        arrays = dict(data)
    for name, wrong in (("detail_median", np.zeros((2, 3))), ("detail_sums", arrays["detail_sums"][1:])):
        np.savez(run.fields_npz, **arrays | {name: wrong})
        assert error_of(RoomFields.load, run).code == "results-damaged"
