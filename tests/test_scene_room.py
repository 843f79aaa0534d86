# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged meshes of rooms: each fault is named for what it is."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.run.arrays import read_arrays
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.surface.room import load_room
from samples.refusals import error_of

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)


def write_room(root: Path, **changes: np.ndarray) -> RunFolder:
    """A square of two triangles, with other arrays where they are given."""
    run = RunFolder(root)
    arrays = {
        "vertices": VERTICES,
        "triangles": TRIANGLES,
        "corner_normals": np.tile(np.float32([0, 0, 1]), (2, 3, 1)),
        "triangle_object": np.zeros(2, np.int32),
        "triangle_material": np.zeros(2, np.int32),
        "triangle_polygon": np.arange(2, dtype=np.int32),
    }
    root.mkdir(parents=True, exist_ok=True)
    np.savez(run.room_npz, **{**arrays, **changes})
    write_json(run.room_json, {"objects": ["a"], "materials": ["b"], "parts": "objects"})
    return run


@pytest.mark.parametrize("index", [4, 2**30, -1])
def test_indices_of_missing_vertices_are_named_before_areas_are_computed(tmp_path: Path, index: int) -> None:
    triangles = TRIANGLES.copy()
    triangles[1, 2] = index
    error = error_of(load_room, write_room(tmp_path, triangles=triangles))
    assert error.code == "mesh-damaged" and "missing vertices" in error.text


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_vertices_at_infinity_are_not_called_a_mesh_without_surface(tmp_path: Path, value: float) -> None:
    error = error_of(load_room, write_room(tmp_path, vertices=np.full_like(VERTICES, value)))
    assert error.code == "mesh-damaged" and "infinity" in error.text


def test_a_mesh_without_area_is_empty(tmp_path: Path) -> None:
    assert error_of(load_room, write_room(tmp_path, vertices=np.zeros_like(VERTICES))).code == "mesh-empty"


def test_arrays_of_other_lengths_are_refused(tmp_path: Path) -> None:
    assert error_of(load_room, write_room(tmp_path, triangle_object=np.zeros(3, np.int32))).code == "mesh-damaged"


def test_an_archive_that_unpacks_to_far_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(100))
    data = bytearray(path.read_bytes())
    # The size that the central directory announces, at its offset from the entry's signature.
    place = data.index(b"PK\x01\x02") + 24
    data[place : place + 4] = (4_000_000_000).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(FiptError, match=r"unpacks to 4\.0 GB") as caught:
        read_arrays(path, {})
    assert caught.value.code == "file-damaged"
