"""Holes of a scan: which small ones are closed, and by what triangles; flat ones, and panes that close them."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.core.surface.adjacency import Mesh, face_vectors, make_mesh
from fipt_blender.core.surface.closing import Closing, close_small_holes, open_loops
from fipt_blender.core.surface.holes import SET_BACK, FlatHole, flat_holes
from samples.counted import counted_calls
from samples.scans import grid_triangles

EDGE = 0.02


def plane(count: int, openings=(), noise: float = 0.0, bend: float = 0.0) -> Mesh:
    """A wall of count x count quads in the plane y = 0 with its front at y < 0, without some quads.

    Args:
        openings: pairs of slices of rows and columns.
    """
    x, z = np.meshgrid(np.arange(count + 1) * EDGE, np.arange(count + 1) * EDGE)
    depth = noise * np.random.default_rng(1).normal(size=x.shape) + bend * np.sin(12.0 * x)
    kept = np.ones((count, count), bool)
    for opening in openings:
        kept[opening] = False
    triangles = grid_triangles(count, count)[:, ::-1][np.repeat(kept.ravel(), 2)]
    return Mesh(np.stack([x, depth, z], axis=2).reshape(-1, 3), triangles)


def closed(mesh: Mesh, most_edges: int = 120) -> Closing:
    return close_small_holes(mesh, face_vectors(mesh.vertices, mesh.triangles)[0], most_edges)


def joined(mesh: Mesh, closing: Closing) -> Mesh:
    vertices = np.concatenate([mesh.vertices, closing.vertices])
    return make_mesh(vertices, np.concatenate([mesh.triangles, closing.triangles + len(mesh.vertices)]))[0]


def at(row: int, column: int, rows: int = 1, columns: int = 1):
    return slice(row, row + rows), slice(column, column + columns)


def test_pinholes_of_a_wall_are_closed_and_its_border_is_not() -> None:
    openings = [at(3, 3), at(3, 10), at(10, 3, 3, 5), at(20, 20, 6, 6)]
    mesh = plane(30, openings)
    closing = closed(mesh)
    area = (1 + 1 + 15 + 36) * EDGE**2
    normals, areas = face_vectors(closing.vertices, closing.triangles)
    assert (closing.closed, closing.left) == (4, 0)
    assert closing.closed_area == pytest.approx(area) == areas.sum()
    assert (normals @ [0.0, -1.0, 0.0] > 0.999).all()
    assert np.abs(closing.vertices[:, 1]).max() == 0.0
    # The longest edge is of the order of the rim's, and the border of the wall is all that stays open.
    corners = closing.vertices[closing.triangles]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() < 2.5 * EDGE
    assert [len(loop.vertices) for loop in open_loops(joined(mesh, closing))] == [120]


def test_rims_keep_their_places_and_say_what_is_beside() -> None:
    mesh = plane(20, [at(5, 5), at(12, 4, 4, 7)], noise=0.2 * EDGE)
    closing = closed(mesh)
    places = {tuple(vertex) for vertex in mesh.vertices}
    assert sum(tuple(vertex) in places for vertex in closing.vertices) == 4 + 22
    centre = closing.vertices[closing.triangles].mean(axis=1)
    near = mesh.vertices[mesh.triangles[closing.beside]].mean(axis=1)
    assert np.linalg.norm(centre - near, axis=1).max() < 8.0 * EDGE
    assert len(list(open_loops(joined(mesh, closing)))) == 1


def test_holes_of_more_edges_and_what_may_be_a_window_stay_open() -> None:
    mesh = plane(80, [at(5, 5), at(10, 10, 6, 6), at(30, 25, 16, 16), at(30, 50, 28, 28)])
    closing = closed(mesh, 20)
    assert (closing.closed, closing.left) == (1, 3)
    closing = closed(mesh, 110)
    assert (closing.closed, closing.left) == (2, 2)
    assert closing.open_area == pytest.approx((256 + 784) * EDGE**2)
    assert not len(closed(mesh, 0).triangles)


def box(cells: int, door: bool) -> Mesh:
    """A box whose wall y = 1 has a hole around its upper edge, and may have a door."""
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(0.0, 1.0, cells + 1)], indexing="ij"))
    low, high = np.zeros_like(u), np.ones_like(u)
    sides = [(u, v, low), (v, u, high), (v, low, u), (u, high, v), (low, u, v), (high, v, u)]
    vertices = np.concatenate([np.stack(side, axis=1) for side in sides])
    triangles = np.concatenate([grid_triangles(cells, cells) + len(u) * n for n in range(6)])
    mesh, _ = make_mesh(vertices, triangles)
    x, y, z = mesh.vertices[mesh.triangles].mean(axis=1).T
    gone = (np.abs(x - 0.5) < 0.15) & ((y > 0.9) & (z > 0.9))
    if door:
        gone |= (y > 0.99) & (np.abs(x - 0.3) < 0.2) & (z < 0.6)
    return Mesh(mesh.vertices, mesh.triangles[~gone])


def test_a_hole_around_an_edge_is_closed_and_the_door_stays_open() -> None:
    mesh = box(40, door=True)
    closing = closed(mesh)
    assert (closing.closed, closing.left) == (1, 1)
    normals, areas = face_vectors(closing.vertices, closing.triangles)
    # What closes it has no more area than what is gone, and the side of the surfaces beside it.
    facing = (face_vectors(mesh.vertices, mesh.triangles)[0][closing.beside] * normals).sum(axis=1)
    assert (facing > 0.0).mean() > 0.9
    assert areas.sum() < 0.3 * (0.1 + 0.1) * 1.1
    assert len(list(open_loops(joined(mesh, closing)))) == 1


def test_specks_and_open_sheets_have_rims_and_no_holes() -> None:
    speck = plane(3)
    assert (closed(speck).closed, closed(speck).left) == (0, 0)
    lone = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    assert (closed(lone).closed, closed(lone).left) == (0, 0)
    assert closed(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))).closed == 0


def test_holes_that_touch_at_a_corner_are_two() -> None:
    mesh = plane(20, [at(5, 5, 2, 2), at(7, 7, 3, 3)])
    closing = closed(mesh)
    assert (closing.closed, closing.left) == (2, 0)
    assert closing.closed_area == pytest.approx(13 * EDGE**2)
    assert len(list(open_loops(joined(mesh, closing)))) == 1


def test_a_notched_hole_is_covered_once() -> None:
    """A hole in the shape of a horseshoe: what lies in its notch is there already."""
    mesh = plane(24, [at(6, 6, 8, 2), at(6, 12, 8, 2), at(12, 6, 2, 8)])
    closing = closed(mesh)
    areas = face_vectors(closing.vertices, closing.triangles)[1]
    assert closing.closed == 1 and areas.sum() == pytest.approx((16 + 16 + 8) * EDGE**2)


@pytest.mark.parametrize("fault", ["fin", "flipped", "double", "degenerate", "random"])
def test_junk_does_no_harm(fault: str, rng: np.random.Generator) -> None:
    """Edges of three triangles, other windings, triangles twice, without area, or at random."""
    mesh = plane(20, [at(5, 5), at(12, 12, 2, 2)])
    triangles = mesh.triangles.copy()
    vertices = np.concatenate([mesh.vertices, [[0.1, -0.1, 0.1]]])
    if fault == "fin":
        triangles = np.concatenate([triangles, [[*triangles[0][:2], len(vertices) - 1]]])
    elif fault == "flipped":
        turned = rng.random(len(triangles)) < 0.1
        triangles[turned] = triangles[turned][:, ::-1]
    elif fault == "double":
        triangles = np.concatenate([triangles, triangles[:50]])
    elif fault == "degenerate":
        triangles = np.concatenate([triangles, np.repeat(triangles[:20, :1], 3, axis=1)])
    else:
        triangles = rng.integers(0, len(vertices), (500, 3))
    closing = closed(Mesh(vertices, triangles))
    assert np.isfinite(closing.vertices).all()
    assert closing.triangles.max(initial=-1) < len(closing.vertices)
    if fault in ("fin", "degenerate"):
        assert closing.closed >= 2


def test_the_work_grows_with_the_holes_not_with_their_square() -> None:
    openings = [(slice(1, None, 3), slice(1, None, 3))]
    calls, holes = [], []
    for size in (60, 120):
        mesh = plane(size, openings)
        with counted_calls() as counted:
            holes.append(closed(mesh).closed)
        calls.append(counted.calls)
    assert holes[1] > 3.5 * holes[0] and calls[1] < 5 * calls[0], (holes, calls)
    assert closed(plane(550, openings)).closed > 33_000


# ------------------------------------------------------------------------------------- flat holes and panes

WINDOW = np.s_[10:40, 20:45]


def only_hole(given: Mesh) -> FlatHole:
    mesh, _ = make_mesh(given.vertices, given.triangles)
    holes = [hole for hole in flat_holes(mesh, EDGE) if hole.axes[2][1] < 0.0]
    assert len(holes) == 1
    return holes[0]


@pytest.mark.parametrize("turned", [False, True])
def test_a_window_is_found_with_its_area_and_front(turned: bool) -> None:
    mesh = plane(60, [WINDOW], noise=0.003)
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
    for mesh in (plane(60), plane(60, [at(10, 20, 5, 5)]), plane(60, [WINDOW], bend=0.1)):
        assert not [hole for hole in flat_holes(mesh, EDGE) if hole.axes[2] @ front > 0.5]


def test_rays_enter_from_the_front_within_the_rim() -> None:
    hole = only_hole(plane(60, [WINDOW]))
    eye = np.array([0.6, -2.0, 0.5])
    targets = np.array([[0.6, 0.0, 0.5], [0.42, 0.0, 0.22], [0.2, 0.0, 0.5], [0.6, 0.0, 1.0]])
    directions = (targets - eye) / np.linalg.norm(targets - eye, axis=1, keepdims=True)
    enters, distance = hole.crossed(eye, directions)
    assert enters.tolist() == [True, True, False, False]
    assert distance[:2] == pytest.approx(np.linalg.norm(targets - eye, axis=1)[:2])
    assert not hole.crossed(eye, -directions)[0].any()
    assert not hole.crossed(eye * [1.0, -1.0, 1.0], directions * [1.0, -1.0, 1.0])[0].any()


def test_a_pane_lies_behind_the_rim_and_reaches_under_it() -> None:
    hole = only_hole(plane(60, [WINDOW]))
    vertices, triangles = hole.pane()
    assert vertices[:, 1] == pytest.approx(SET_BACK * EDGE, abs=1e-6)
    assert vertices[:, 0].min() < 0.4 - EDGE and vertices[:, 0].max() > 0.9 + EDGE
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals @ hole.axes[2] > 0.0).all()
