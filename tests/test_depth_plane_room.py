# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms of planes from sparse points, on rooms whose planes are known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.depth.plane_room import plane_room
from samples.refusals import error_of

NOISE = 0.005
UP = np.array([0.0, 0.0, 1.0])


def on_rectangle(rng, count, corner, first, second):
    """Points on a rectangle with a corner and two sides, with noise."""
    share = rng.random((count, 2))
    points = np.asarray(corner) + share[:, :1] * np.asarray(first) + share[:, 1:] * np.asarray(second)
    return points + NOISE * rng.normal(size=points.shape)


def extruded(rng, plan, height, count=150):
    """Points on the walls, floor and ceiling over a floor plan (K, 2), and cameras inside of it."""
    plan = np.asarray(plan, float)
    parts = [
        on_rectangle(rng, count, [*start, 0.0], [*(end - start), 0.0], [0.0, 0.0, height])
        for start, end in zip(plan, np.roll(plan, -1, axis=0), strict=True)
    ]
    flat = rng.uniform(plan.min(axis=0), plan.max(axis=0), (6 * count, 2))
    flat = flat[within(flat, plan)]
    for level in (0.0, height):
        parts.append(
            np.column_stack([flat, np.full(len(flat), level)]) + NOISE * rng.normal(size=(len(flat), 3))
        )
    eyes = rng.uniform(plan.min(axis=0), plan.max(axis=0), (60, 2))
    inner = 0.8 * (plan - plan.mean(axis=0)) + plan.mean(axis=0)
    eyes = eyes[within(eyes, plan) & within(eyes, inner)][:12]
    return np.concatenate(parts), np.column_stack([eyes, np.full(len(eyes), 1.4)])


def within(points, plan):
    """Whether points lie in a polygon, by the crossings of a ray."""
    inside = np.zeros(len(points), bool)
    for start, end in zip(plan, np.roll(plan, -1, axis=0), strict=True):
        crosses = (start[1] > points[:, 1]) != (end[1] > points[:, 1])
        rise = np.where(end[1] == start[1], 1.0, end[1] - start[1])
        place = start[0] + (points[:, 1] - start[1]) / rise * (end[0] - start[0])
        inside ^= crosses & (points[:, 0] < place)
    return inside


def area_and_volume(pieces):
    """Area of all polygons, and the volume that they enclose if they are seen from inside."""
    area = volume = 0.0
    for piece in pieces:
        for face in piece.faces:
            corners = piece.vertices[list(face)]
            for second, third in pairwise(corners[1:]):
                cross = np.cross(second - corners[0], third - corners[0])
                area += 0.5 * np.linalg.norm(cross)
                volume -= corners[0] @ cross / 6.0
    return area, volume


def shell(room):
    return [piece for piece in room.pieces if not piece.name.startswith("Box")]


RECTANGLE = [[0, 0], [5, 0], [5, 4], [0, 4]]
L_SHAPE = [[0, 0], [6, 0], [6, 3], [3, 3], [3, 5], [0, 5]]
BAY = [[0, 0], [5, 0], [5, 3], [4, 4], [0, 4]]


@pytest.mark.parametrize(
    ("plan", "area"), [(RECTANGLE, 20.0), (L_SHAPE, 24.0), (BAY, 19.5)], ids=["box", "l", "cut"]
)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_room_is_closed_and_its_planes_are_found(plan, area, seed):
    rng = np.random.default_rng(seed)
    points, eyes = extruded(rng, plan, 2.5)
    scale, turn = 37.0, turn_by(np.radians([4.0, -6.0, 50.0]))
    room = plane_room(scale * points @ turn.T + 5.0, scale * eyes @ turn.T + 5.0, UP)
    assert not room.guessed
    assert [piece.name for piece in room.pieces[:3]] == ["Floor", "Ceiling", "Wall.001"]
    walls = [piece for piece in shell(room) if piece.name.startswith("Wall")]
    assert len(walls) == len(plan)
    found, volume = area_and_volume(shell(room))
    sides = np.linalg.norm(np.diff([*plan, plan[0]], axis=0), axis=1).sum()
    assert volume / scale**3 == pytest.approx(2.5 * area, rel=0.01)
    assert found / scale**2 == pytest.approx(2.0 * area + 2.5 * sides, rel=0.01)


def test_furniture_becomes_boxes_and_not_walls():
    rng = np.random.default_rng(2)
    points, eyes = extruded(rng, RECTANGLE, 2.5, count=400)
    low, high = np.array([1.0, 2.5, 0.0]), np.array([2.5, 3.3, 0.8])
    size = high - low
    table = [
        on_rectangle(rng, 120, [low[0], low[1], high[2]], [size[0], 0, 0], [0, size[1], 0]),
        on_rectangle(rng, 60, low, [size[0], 0, 0], [0, 0, size[2]]),
        on_rectangle(rng, 60, low, [0, size[1], 0], [0, 0, size[2]]),
    ]
    outside = rng.uniform([6.0, -1.0, 0.0], [9.0, 5.0, 3.0], (40, 3))  # seen through a window
    eyes = eyes[~((eyes[:, :2] > low[:2] - 0.1) & (eyes[:, :2] < high[:2] + 0.1)).all(axis=1)]
    room = plane_room(np.concatenate([points, *table, outside]), eyes, UP)
    assert area_and_volume(shell(room))[1] == pytest.approx(50.0, rel=0.02)
    assert not room.guessed
    (box,) = [piece for piece in room.pieces if piece.name.startswith("Box")]
    assert np.allclose(np.sort(np.ptp(box.vertices, axis=0)), np.sort(size), atol=0.25)
    assert area_and_volume([box])[1] < 0.0  # seen from outside


def test_a_missing_wall_and_ceiling_are_guessed_and_named():
    rng = np.random.default_rng(3)
    points, eyes = extruded(rng, RECTANGLE, 2.5)
    points = points[(points[:, 2] < 2.4) & (points[:, 0] < 4.9)]
    room = plane_room(points, eyes, UP)
    assert "Ceiling" in room.guessed and len(room.guessed) == 2
    _, volume = area_and_volume(shell(room))
    assert volume == pytest.approx(4.9 * 4.0 * 2.4, rel=0.05)


def test_few_points_are_refused():
    assert error_of(plane_room, np.zeros((20, 3)), np.zeros((3, 3)), UP).code == "room-points"
