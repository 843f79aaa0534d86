# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Flat holes of a scan, and the panes that close them."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.core.surface.adjacency import make_mesh
from fipt_blender.core.surface.holes import SET_BACK, FlatHole, flat_holes

EDGE = 0.02


def wall(opening: tuple[slice, slice], noise: float = 0.0, bend: float = 0.0):
    """A wall of 1.2 m in the plane y = 0 that is seen from y < 0, without the quads of `opening`."""
    count = 60
    x, z = np.meshgrid(np.arange(count + 1) * EDGE, np.arange(count + 1) * EDGE)
    depth = noise * np.random.default_rng(1).normal(size=x.shape) + bend * np.sin(12.0 * x)
    vertices = np.stack([x, depth, z], axis=2).reshape(-1, 3)
    kept = np.ones((count, count), bool)
    kept[opening] = False
    row, column = np.nonzero(kept)
    first = row * (count + 1) + column
    quads = np.stack([first, first + 1, first + count + 2, first + count + 1], axis=1)
    return make_mesh(vertices, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))[0]


def only_hole(mesh) -> FlatHole:
    holes = [hole for hole in flat_holes(mesh, EDGE) if hole.axes[2][1] < 0.0]
    assert len(holes) == 1
    return holes[0]


@pytest.mark.parametrize("turned", [False, True])
def test_a_window_is_found_with_its_area_and_front(turned: bool) -> None:
    mesh = wall((slice(10, 40), slice(20, 45)), noise=0.003)
    if turned:  # the front is told by the winding of the surface, not by axes
        mesh = make_mesh(mesh.vertices * [-1.0, -1.0, 1.0], mesh.triangles)[0]
        holes = [hole for hole in flat_holes(mesh, EDGE) if hole.axes[2][1] > 0.0]
    else:
        holes = [only_hole(mesh)]
    assert [hole.area for hole in holes] == pytest.approx([30 * 25 * EDGE**2], rel=0.1)
    assert abs(holes[0].axes[2][1]) > 0.99
    assert np.linalg.det(holes[0].axes) == pytest.approx(1.0)


def test_small_and_bent_holes_are_none() -> None:
    """The border of the wall itself is no hole of the side from which the wall is seen."""
    front = [0.0, -1.0, 0.0]
    for mesh in (
        wall((slice(0, 0), slice(0, 0))),
        wall((slice(10, 15), slice(20, 25))),
        wall((slice(10, 40), slice(20, 45)), bend=0.1),
    ):
        assert not [hole for hole in flat_holes(mesh, EDGE) if hole.axes[2] @ front > 0.5]


def test_rays_enter_from_the_front_within_the_rim() -> None:
    hole = only_hole(wall((slice(10, 40), slice(20, 45))))
    eye = np.array([0.6, -2.0, 0.5])
    targets = np.array([[0.6, 0.0, 0.5], [0.42, 0.0, 0.22], [0.2, 0.0, 0.5], [0.6, 0.0, 1.0]])
    directions = (targets - eye) / np.linalg.norm(targets - eye, axis=1, keepdims=True)
    enters, distance = hole.crossed(eye, directions)
    assert enters.tolist() == [True, True, False, False]
    assert distance[:2] == pytest.approx(np.linalg.norm(targets - eye, axis=1)[:2])
    assert not hole.crossed(eye, -directions)[0].any()
    assert not hole.crossed(eye * [1.0, -1.0, 1.0], directions * [1.0, -1.0, 1.0])[0].any()


def test_a_pane_lies_behind_the_rim_and_reaches_under_it() -> None:
    hole = only_hole(wall((slice(10, 40), slice(20, 45))))
    vertices, triangles = hole.pane()
    assert vertices[:, 1] == pytest.approx(SET_BACK * EDGE, abs=1e-6)
    assert vertices[:, 0].min() < 0.4 - EDGE and vertices[:, 0].max() > 0.9 + EDGE
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals @ hole.axes[2] > 0.0).all()
