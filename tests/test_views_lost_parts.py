# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that a scan lost: which are found by their masks, and the shape that they get."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.geometry.prism import prism
from fipt_blender.core.run.run_files import PANES
from fipt_blender.core.scene.camera_rays import trace_pixels
from fipt_blender.core.scene.room import Room, load_room
from fipt_blender.core.views import panes
from fipt_blender.core.views.masked_views import masked_views
from fipt_blender.core.views.panes import close_holes
from samples.part_views import THING_PART, looking_views, write_run
from samples.scans import scanned_box
from samples.small_rooms import mesh_room

LOW, HIGH = np.array([-0.6, -0.4, 0.3]), np.array([0.6, 0.4, 0.7])


def box() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of the thing that is lost."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (HIGH - LOW) + LOW
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return vertices, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def true_room(scan: Room) -> Room:
    vertices, triangles = box()
    count = len(scan.triangles)
    return mesh_room(
        np.concatenate([scan.vertices, vertices]),
        np.concatenate([scan.triangles, triangles + len(scan.vertices)]),
        np.repeat([0, 1], [count, len(triangles)]),
    )


def inside(points: np.ndarray, room: Room, added: np.ndarray) -> np.ndarray:
    """Whether points (N, 3) are inside the closed surface of some triangles, by its solid angle."""
    corners = room.vertices[room.triangles[added]].astype(np.float64)
    winding = np.zeros(len(points))
    for one, two, three in corners:
        a, b, c = one - points, two - points, three - points
        la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        volume = np.einsum("nc,nc->n", a, np.cross(b, c))
        total = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        winding += 2.0 * np.arctan2(volume, total)
    return np.abs(winding) > 2.0 * np.pi


def test_a_lost_box_is_put_back(tmp_path: Path, rng: np.random.Generator) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    run = write_run(tmp_path, scan, "masks")
    views = looking_views(tmp_path, true_room(scan))
    close_holes(run, views)
    room = load_room(run)
    added = room.triangle_object == 1
    assert room.objects == ("scan", PANES) and added.any()
    points = rng.uniform(LOW - 0.3, HIGH + 0.3, (3000, 3))
    true = ((points > LOW) & (points < HIGH)).all(axis=1)
    found = inside(points, room, added)
    assert (true & found).sum() / (true | found).sum() > 0.75
    # The pixels of its mask now meet it.
    for view in views[:3]:
        surface = trace_pixels(room, view)
        mask = view.part_ids() == THING_PART
        assert (added[np.array(surface.triangle)].reshape(mask.shape) & mask).sum() > 0.85 * mask.sum()
    # Once more: the room has it.
    written = run.panes_npz.read_bytes()
    close_holes(run, views)
    assert run.panes_npz.read_bytes() == written


@pytest.mark.parametrize("parts", ["masks", "none"])
def test_nothing_is_added_where_nothing_is_lost_or_no_masks_are_used(tmp_path: Path, parts: str) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    run = write_run(tmp_path, scan, parts)
    shown = scan if parts == "masks" else true_room(scan)
    close_holes(run, looking_views(tmp_path, shown))
    assert load_room(run).objects == ("scan",)


def test_masks_that_ask_for_nothing_are_searched_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    run = write_run(tmp_path, scan, "masks")
    views = looking_views(tmp_path, scan)
    close_holes(run, views)
    searched = []
    monkeypatch.setattr(panes, "masked_views", lambda *given: searched.append(given) or masked_views(*given))
    close_holes(run, views)
    assert not searched and load_room(run).objects == ("scan",)
    # Other masks are searched again.
    close_holes(run, looking_views(tmp_path, true_room(scan)))
    assert searched and load_room(run).objects == ("scan", PANES)


def test_a_prism_is_closed_and_faces_outwards() -> None:
    footprint = np.zeros((12, 9), bool)
    footprint[1:11, 2:8] = True
    footprint[1:4, 6:8] = False
    vertices, triangles, normals = prism(footprint, np.array([1.0, 2.0, 3.0]), 0.1, 4)
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge) for edge in edges[:, ::-1].tolist()}
    assert len(np.unique(edges, axis=0)) == len(edges)
    corners = vertices[triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = (corners[:, 0] * cross).sum() / 6.0
    # Smoothing rounds the corners of the outline.
    assert 0.85 * footprint.sum() * 0.4 * 0.01 < volume <= footprint.sum() * 0.4 * 0.01
    assert ((normals.mean(axis=1) * cross).sum(axis=1) > 0.0).all()
    assert vertices[:, 2].min() == pytest.approx(3.0) and vertices[:, 2].max() == pytest.approx(3.4)
