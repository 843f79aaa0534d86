# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitters from the emission mask (paper Sec. 4.4 "Emitter extraction"), grouped into fixtures.

A triangle whose mean mask is above the threshold may emit; which ones do says :mod:`.evidence`. The radiance
is the median of the pixels that see it, as an emitter is taken to reflect nothing. Connected triangles of
like radiance make a fixture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..render.lights import LUMINANCE, EmitterTable
from ..scene.labels import weld
from ..scene.room import Room

# A side of a triangle emits if it is at least this bright against the brighter side.
DIM_SIDE = 0.1
# Neighbours belong to one fixture where their radiance differs by less than this factor.
ALIKE = 1.5
# Pixels at a time: arrays of all pixels of a large capture would take gigabytes.
CHUNK = 1 << 20


@dataclass(frozen=True)
class Fixture:
    """A lamp: connected triangles with one radiance a side.

    Attributes:
        triangles: (n,) int64 room triangle indices.
        radiance: (3,) of the front side, in the units of the pixels.
        back_radiance: (3,) of the back side.
        area: square metres.
        centroid: (3,) area-weighted, metres.
        beside: whether the surface also reflects as the room's materials say there.
    """

    triangles: np.ndarray
    radiance: np.ndarray
    back_radiance: np.ndarray
    area: float
    centroid: np.ndarray
    beside: bool = False


def find_emitters(
    room: Room,
    mask: Callable[[np.ndarray], np.ndarray],
    threshold: float,
    samples: int,
    rng: np.random.Generator,
    among: np.ndarray | None = None,
) -> np.ndarray:
    """(T,) bool, triangles whose mean emission mask over random points exceeds the threshold.

    Args:
        mask: (N, 3) world positions to (N,) alpha.
        samples: points a triangle.
        among: (T,) bool, triangles that are asked; all where None.
    """
    asked = np.arange(len(room.triangles)) if among is None else np.flatnonzero(among)
    found = np.zeros(len(room.triangles), bool)
    for start in range(0, len(asked), 4096):
        part = asked[start : start + 4096]
        mean = mask(random_points(room, part, samples, rng)).reshape(-1, samples).mean(axis=1)
        found[part] = mean > threshold
    return found


def random_points(room: Room, triangles: np.ndarray, samples: int, rng: np.random.Generator) -> np.ndarray:
    """(len(triangles) * samples, 3) float32 points, uniform on each triangle."""
    u, v = rng.random((2, len(triangles), samples), dtype=np.float32)
    root = np.sqrt(u)
    weights = np.stack([1.0 - root, root * (1.0 - v), root * v], axis=-1)
    corners = room.vertices[room.triangles[triangles]]
    return np.einsum("tsc,tcd->tsd", weights, corners).reshape(-1, 3)


def pixels_of(triangle: np.ndarray, marked: np.ndarray) -> np.ndarray:
    """(R,) int64 pixels that see one of the triangles marked ((T,) bool).

    Args:
        triangle: (N,) triangle of each pixel, negative where none; memory-mapped arrays will do.
    """
    found = [np.zeros(0, np.int64)]
    for start in range(0, len(triangle), CHUNK):
        part = triangle[start : start + CHUNK]
        found.append(np.flatnonzero((part >= 0) & marked[np.maximum(part, 0)]) + start)
    return np.concatenate(found)


def side_medians(
    triangle: np.ndarray, front: np.ndarray, pure: np.ndarray, radiance: np.ndarray, group: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Per-channel median radiance of each group's two sides.

    Pixels that see more than the emitter are left out where a group has others.

    Args:
        triangle: (N,) triangle of each pixel.
        front: (N,) whether its front is seen.
        pure: (N,) whether the pixel sees nothing else.
        radiance: (N, 3).
        group: (T,) int group of each triangle, negative without.

    Returns:
        (groups, 2, 3) medians, front first, and (groups, 2) pixels behind them.
    """
    groups = int(group.max(initial=-1)) + 1
    medians = np.zeros((groups, 2, 3))
    counts = np.zeros((groups, 2), np.int64)
    pixel_group = np.where(triangle >= 0, group[np.maximum(triangle, 0)], -1)
    inside = np.flatnonzero(pixel_group >= 0)
    key = pixel_group[inside] * 2 + ~front[inside]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    for part in np.split(inside[order], starts[1:]) if len(inside) else []:
        clean = part[pure[part]]
        chosen = clean if len(clean) else part
        where = pixel_group[part[0]], int(not front[part[0]])
        medians[where] = np.median(radiance[chosen], axis=0)
        counts[where] = len(chosen)
    return medians, counts


def group_fixtures(
    room: Room,
    emitting: np.ndarray,
    triangle: np.ndarray,
    front: np.ndarray,
    pure: np.ndarray,
    radiance: np.ndarray,
) -> list[Fixture]:
    """Fixtures of the emitting triangles, brightest power first.

    Args:
        emitting: (T,) bool.
        triangle, front, pure, radiance: of the pixels, as in :func:`side_medians`; memory-mapped arrays do.
    """
    corners = weld(room.vertices)[room.triangles]
    ids = np.flatnonzero(emitting)
    if not len(ids):
        return []
    rows = pixels_of(triangle, emitting)  # few: all that follows may be in memory
    triangle, front, pure, radiance = (array[rows] for array in (triangle, front, pure, radiance))
    own = np.full(len(emitting), -1, np.int64)
    own[ids] = np.arange(len(ids))
    medians, counts = side_medians(triangle, front, pure, radiance, own)
    brightness = (medians * (counts > 0)[..., None] @ LUMINANCE).max(axis=1)
    seen = (counts.sum(axis=1) > 0) & ~_vague(corners[ids], own[triangle[pure]])
    group = np.full(len(emitting), -1, np.int64)
    group[ids] = connected(corners[ids], brightness, seen)
    medians, counts = side_medians(triangle, front, pure, radiance, group)
    fixtures = []
    for index in range(len(medians)):
        members = np.flatnonzero(group == index)
        sides = medians[index] * (counts[index] > 0)[:, None]
        light = sides @ LUMINANCE
        if not light.max() > 0.0:
            continue
        sides = np.where((light >= DIM_SIDE * light.max())[:, None], sides, 0.0)
        area = room.areas[members]
        if not area.sum() > 0.0:
            continue
        middle = room.vertices[room.triangles[members]].mean(axis=1)
        centroid = (middle * area[:, None]).sum(axis=0) / area.sum()
        fixtures.append(Fixture(members, sides[0], sides[1], float(area.sum()), centroid))
    return sorted(fixtures, key=lambda f: -f.area * float((f.radiance + f.back_radiance) @ LUMINANCE))


def _vague(corners: np.ndarray, clean: np.ndarray) -> np.ndarray:
    """(n,) bool, emitting triangles that no pixel sees alone, though it does others of their piece.

    Args:
        corners: (n, 3) welded vertices of the emitting triangles.
        clean: numbers, among these, of triangles that some pixel sees without anything else.
    """
    alone = np.zeros(len(corners), bool)
    alone[clean] = True
    piece = _pieces(corners)
    return ~alone & (np.bincount(piece, alone)[piece] > 0)


def _pieces(corners: np.ndarray) -> np.ndarray:
    """(T,) int64 connected piece of each triangle, by shared (welded) vertices."""
    label = np.arange(int(corners.max(initial=0)) + 1)
    while True:
        lowest = label[corners].min(axis=1)
        update = label.copy()
        np.minimum.at(update, corners.reshape(-1), np.repeat(lowest, 3))
        update = update[update]  # pointer jumping
        if (update == label).all():
            return np.unique(label[corners[:, 0]], return_inverse=True)[1]
        label = update


def connected(corners: np.ndarray, brightness: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(n,) int64 group of each emitting triangle: neighbours (shared vertex) of like brightness.

    Triangles without pixels join any neighbour.
    """
    label = np.arange(len(corners))
    order = np.argsort(corners.reshape(-1), kind="stable")
    vertex = corners.reshape(-1)[order]
    owner = order // 3
    first = np.concatenate([[True], vertex[1:] != vertex[:-1]])
    anchor = owner[np.maximum.accumulate(np.where(first, np.arange(len(owner)), 0))]
    chain = np.stack([owner[1:], owner[:-1]], axis=1)[vertex[1:] == vertex[:-1]]
    pairs = np.concatenate([chain, np.stack([owner, anchor], axis=1)])
    low, high = np.sort(brightness[pairs], axis=1).T
    like = ~(seen[pairs].all(axis=1)) | (high <= ALIKE * np.maximum(low, 1e-12))
    pairs = pairs[like]
    while True:
        lowest = label[pairs].min(axis=1)
        update = label.copy()
        np.minimum.at(update, pairs.reshape(-1), np.repeat(lowest, 2))
        update = update[update]
        if (update == label).all():
            return np.unique(label, return_inverse=True)[1]
        label = update


def emitter_table(fixtures: list[Fixture]) -> EmitterTable:
    """The fixtures' triangles as light sources."""
    if not fixtures:
        return EmitterTable.empty()
    sizes = [len(fixture.triangles) for fixture in fixtures]
    return EmitterTable(
        np.concatenate([fixture.triangles for fixture in fixtures]).astype(np.int32),
        np.repeat([fixture.radiance for fixture in fixtures], sizes, axis=0).astype(np.float32),
        np.repeat([fixture.back_radiance for fixture in fixtures], sizes, axis=0).astype(np.float32),
        beside=np.repeat([fixture.beside for fixture in fixtures], sizes),
    )


def bright_triangles(
    room: Room, triangle: np.ndarray, front: np.ndarray, radiance: np.ndarray, factor: float = 8.0
) -> EmitterTable:
    """Triangles worth aiming rays at before any emitter is known: much brighter than the room's mean.

    Only sampling depends on them, never the result's expectation.
    """
    number = np.zeros((2, len(room.triangles)))
    sums = np.zeros((2, 3, len(room.triangles)))
    for start in range(0, len(triangle), CHUNK):
        rows = slice(start, start + CHUNK)
        seen = np.asarray(triangle[rows]) >= 0
        for side in range(2):
            chosen = np.flatnonzero(seen & (front[rows] != bool(side)))
            on = triangle[rows][chosen]
            np.add.at(number[side], on, 1.0)
            for channel in range(3):
                np.add.at(sums[side, channel], on, radiance[rows][chosen, channel].astype(np.float64))
    sides = (sums / np.maximum(number, 1.0)[:, None]).transpose(0, 2, 1)
    light = np.maximum(sides[0] @ LUMINANCE, sides[1] @ LUMINANCE)
    seen = light > 0
    mean = float(np.average(light[seen], weights=room.areas[seen])) if (room.areas * seen).sum() > 0 else 0.0
    bright = np.flatnonzero(light > factor * mean) if mean > 0 else np.zeros(0, np.int64)
    return EmitterTable(
        bright.astype(np.int32), sides[0][bright].astype(np.float32), sides[1][bright].astype(np.float32)
    )
