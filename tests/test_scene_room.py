"""Damaged meshes of rooms: each fault is named for what it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.surface.room import load_room
from samples.refusals import error_of
from samples.small_rooms import BOX, make_room, write_room

CORNERS = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    "changes, code, text",
    [
        *(({"triangles": np.array([[0, 1, 2], [0, 2, index]], np.int32)}, "file-damaged", "missing vertices")
          for index in (4, 2**30, -1)),
        *(({"vertices": np.full((4, 3), value, np.float32)}, "mesh-damaged", "infinity")
          for value in (np.inf, -np.inf, np.nan)),
        ({"vertices": np.zeros((4, 3), np.float32)}, "mesh-empty", ""),
    ],
)  # fmt: skip
def test_faults_are_named_for_what_they_are(tmp_path: Path, changes: dict, code: str, text: str) -> None:
    """A square of two triangles, with other arrays: missing vertices are named before areas are computed."""
    write_room(tmp_path, make_room([CORNERS]), **changes)
    error = error_of(load_room, RunFolder(tmp_path))
    assert error.code == code and text in error.text


FAR = np.float32([[420, 5, 1], [420.1, 5, 1], [420.1, 5, 1.1], [420, 5, 1.1]])
GROUND = np.float32([[-110, -110, -0.1], [110, -110, -0.1], [110, 110, -0.1], [-110, 110, -0.1]])


@pytest.mark.parametrize("quads", [[FAR], [GROUND], [FAR, GROUND]], ids=["stray", "terrain", "both"])
def test_the_bounds_are_of_what_surrounds_the_cameras(quads: list) -> None:
    """Also of a room with an opening, behind which the terrain goes on."""
    places = np.random.default_rng(1).uniform([-1.0, -1.0, 0.5], [1.0, 1.0, 2.0], (20, 3))
    alone, more = (replace(make_room([*BOX, *each]), cameras=places) for each in ([], quads))
    assert np.array_equal(alone.bounds, alone.mesh_bounds)
    assert np.ptp(more.mesh_bounds, axis=0).max() > 200.0
    np.testing.assert_allclose(more.bounds, alone.bounds, atol=0.61)  # a margin
    wall = max(BOX, key=lambda quad: np.mean(quad, axis=0)[0])
    window = np.array(wall, np.float32) * [1.0, 1.0, 0.8]  # a slot below the ceiling is open
    open_room = replace(make_room([*[each for each in BOX if each is not wall], window, *quads]), cameras=places)
    assert np.ptp(open_room.bounds, axis=0).max() < 3.0 * np.ptp(alone.bounds, axis=0).max()


def test_a_mesh_that_surrounds_no_camera_is_used_as_a_whole() -> None:
    away = replace(make_room(BOX), cameras=np.array([[50.0, 0.0, 1.0]]))
    assert np.array_equal(away.bounds, away.mesh_bounds)
