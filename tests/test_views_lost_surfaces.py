# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Things that a scan lost, found from photographs without masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.run.run_files import PANES
from fipt_blender.core.scene.camera_rays import first_hits, trace_pixels
from fipt_blender.core.scene.room import Room, load_room
from fipt_blender.core.views.lost_surfaces import lost_surfaces
from fipt_blender.core.views.panes import close_holes
from samples.part_views import looking_views, write_run
from samples.scans import scanned_box
from samples.small_rooms import mesh_room

LOW, HIGH = np.array([-0.6, -0.4, 0.3]), np.array([0.6, 0.4, 0.7])
EDGE = 0.05  # metres between vertices of the scan


def with_box(room: Room) -> Room:
    """A room with the thing that is lost as one more object."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (HIGH - LOW) + LOW
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3) + len(room.vertices)
    return mesh_room(
        np.concatenate([room.vertices, vertices]),
        np.concatenate([room.triangles, triangles]),
        np.repeat([0, 1], [len(room.triangles), len(triangles)]),
    )


def photographed(folder: Path, room: Room, rng: np.random.Generator, glossy: float = 0.0) -> list[View]:
    """Views of a room with a patterned floor and walls and plain things, each with an exposure of its own.

    Args:
        glossy: how much the floor's radiance, as a logarithm, differs between views without any order.
    """
    views = looking_views(folder, room)
    for view in views:
        surface = trace_pixels(room, view)
        triangle, _ = first_hits(surface)
        position = np.array(surface.position).T
        pattern = np.sin(7.0 * position).sum(axis=1) + np.sin(3.1 * position[:, ::-1]).prod(axis=1)
        normal = np.array(surface.geometric_normal).T
        shade = 1.0 + 0.5 * normal[:, 2] + 0.2 * normal[:, 0]
        plain = room.triangle_object[triangle] == 1
        grey = np.where(plain, 3.0 * shade, np.exp(0.4 * pattern))
        grey = grey * np.exp(np.where(position[:, 2] < 0.02, glossy * rng.normal(size=len(grey)), 0.0))
        exposure = np.exp(0.3 * rng.normal(size=3))
        image = grey[:, None] * exposure * np.exp(0.02 * rng.normal(size=(len(grey), 3)))
        write_exr(view.image, image.reshape(view.height, view.width, 3).astype(np.float32))
    return views


def test_a_lost_box_is_put_back_without_masks(tmp_path: Path, rng: np.random.Generator) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    run = write_run(tmp_path, scan, "none")
    close_holes(run, photographed(tmp_path, with_box(scan), rng))
    room = load_room(run)
    added = room.vertices[room.triangles[room.triangle_object == 1].reshape(-1)]
    assert room.objects == ("scan", PANES)
    # To a cell or two, which are as wide as a pixel.
    assert np.abs(added.min(axis=0) - LOW).max() < 0.1 and np.abs(added.max(axis=0) - HIGH).max() < 0.1


@pytest.mark.parametrize("glossy", [0.0, 0.5])
def test_nothing_is_found_where_nothing_is_lost(
    tmp_path: Path, rng: np.random.Generator, glossy: float
) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    assert lost_surfaces(scan, photographed(tmp_path, scan, rng, glossy), EDGE) == []


def test_a_thing_that_the_scanner_looked_into_is_not_closed(tmp_path: Path, rng: np.random.Generator) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    views = photographed(tmp_path, with_box(scan), rng)
    assert lost_surfaces(scan, views, EDGE)
    inner, _ = scanned_box(cells=12)
    size = 0.5 * (HIGH - LOW) / np.ptp(inner.vertices, axis=0)
    vertices = 0.5 * (LOW + HIGH) + size * (inner.vertices - inner.vertices.mean(axis=0))
    both = mesh_room(
        np.concatenate([scan.vertices, vertices]),
        np.concatenate([scan.triangles, inner.triangles + len(scan.vertices)]),
        np.zeros(len(scan.triangles) + len(inner.triangles)),
    )
    assert lost_surfaces(both, views, EDGE) == []


def test_masked_pixels_tell_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    views = photographed(tmp_path, with_box(scan), rng)
    masked = []
    for view in views:
        mask = tmp_path / f"mask_{view.name}.exr"
        write_exr(mask, (view.part_ids() == 1).astype(np.float32))
        masked.append(replace(view, mask=mask))
    assert lost_surfaces(scan, views, EDGE)
    assert lost_surfaces(scan, masked, EDGE) == []
