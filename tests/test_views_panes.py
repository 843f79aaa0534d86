# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Panes in holes of a scan: which holes are closed, and how the room is extended."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.completion.panes import close_holes
from fipt_blender.core.run.run_files import PANES, read_room_files
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import Settings
from fipt_blender.core.surface.room import load_room
from fipt_blender.core.surface.stored import prepare_geometry
from samples.scans import scanned_box
from samples.small_rooms import BOX, make_room, mesh_room, write_room

SIZE = 48


def opened(behind: bool = False):
    """A scanned room with an opening in the wall y = 2, and a board behind it."""
    room, side = scanned_box(cells=30, noise=0.003)
    middle = room.vertices[room.triangles].mean(axis=1)
    opening = (side == 2) & (np.abs(middle[:, 0]) < 1.0) & (np.abs(middle[:, 2] - 1.5) < 0.7)
    vertices, triangles = room.vertices, room.triangles[~opening]
    if behind:
        board = np.array([[-3, 3, -1], [3, 3, -1], [3, 3, 4], [-3, 3, 4]], np.float32)
        triangles = np.concatenate([triangles, np.array([[0, 1, 2], [0, 2, 3]]) + len(vertices)])
        vertices = np.concatenate([vertices, board])
    return mesh_room(vertices, triangles, np.zeros(len(triangles)), parts="none")


def write_run(root: Path, room) -> RunFolder:
    run = RunFolder(root)
    write_room(root, room)
    prepare_geometry(run)
    return run


def view(folder: Path, through: float) -> View:
    """Seen from the middle of the room, all radiance 1 but that of the opening."""
    image = np.ones((SIZE, SIZE, 3), np.float32)
    image[14:34, 14:34] = through
    write_exr(folder / "view.exr", image)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]).T
    pose[:3, 3] = [0.0, 0.0, 1.5]
    middle, focal = 0.5 * SIZE, 0.5 * SIZE
    return View("view", "train", folder / "view.exr", SIZE, SIZE, focal, focal, middle, middle, pose)


def test_a_dark_opening_gets_a_pane(tmp_path: Path) -> None:
    run = write_run(tmp_path, opened())
    before = load_room(run)
    close_holes(run, [view(tmp_path, 0.1)])
    room = load_room(run)
    added = slice(len(before.triangles), None)
    assert room.objects == (*before.objects, PANES) and len(room.triangles) > len(before.triangles)
    assert (room.triangle_object[added] == 1).all() and (room.triangle_material[added] == -1).all()
    assert np.array_equal(room.vertices[: len(before.vertices)], before.vertices)
    assert np.array_equal(room.triangles[: len(before.triangles)], before.triangles)
    pane = room.vertices[room.triangles[added]]
    assert 2.0 < pane[..., 1].mean() < 2.1 and np.ptp(pane[..., 1]) < 0.05
    assert 2.0 * 1.4 < room.areas[added].sum() < 2.0 * 2.0 * 1.4
    assert room.plane is not None and (room.plane[added] > before.plane.max()).all()
    assert room.corner_normals[added][..., 1].max() < -0.99
    # Once more: the room has them.
    written = run.panes_npz.read_bytes(), run.geometry_npz.read_bytes()
    prepare_geometry(run)
    close_holes(run, [view(tmp_path, 0.1)])
    assert written == (run.panes_npz.read_bytes(), run.geometry_npz.read_bytes())


@pytest.mark.parametrize(("behind", "through"), [(False, 8.0), (True, 0.1)])
def test_what_shows_the_outside_or_a_surface_stays_open(tmp_path: Path, behind: bool, through: float) -> None:
    run = write_run(tmp_path, opened(behind))
    close_holes(run, [view(tmp_path, through)])
    assert PANES not in load_room(run).objects


def test_panes_that_are_switched_off_are_looked_for_once_they_are_on(tmp_path: Path) -> None:
    run = write_run(tmp_path, opened())
    for there in (False, True, False):
        close_holes(run, [view(tmp_path, 0.1)], Settings(panes=there, close_holes_edges=0))
        room = load_room(run)
        assert (PANES in room.objects) == there and room.scan is not None


def test_a_modelled_room_is_never_closed(tmp_path: Path) -> None:
    run = write_run(tmp_path, make_room(BOX[:2] + BOX[3:]))
    close_holes(run, [view(tmp_path, 0.1)])
    assert not run.panes_npz.exists() and len(load_room(run).triangles) == 10


@pytest.mark.parametrize("fault", ["cut", "index", "other mesh"])
def test_panes_that_do_not_fit_are_left_out(tmp_path: Path, fault: str) -> None:
    run = write_run(tmp_path, opened())
    count = len(read_room_files(run)[0]["triangles"])
    close_holes(run, [view(tmp_path, 0.1)])
    with np.load(run.panes_npz) as archive:
        arrays = dict(archive)
    if fault == "cut":
        run.panes_npz.write_bytes(run.panes_npz.read_bytes()[:500])
    else:
        if fault == "index":
            arrays["triangles"][0, 0] = len(arrays["vertices"])
        else:
            arrays["source"] = arrays["source"][::-1].copy()
        np.savez(run.panes_npz, **arrays)
    found, names = read_room_files(run)
    assert len(found["triangles"]) == count and PANES not in names.objects
