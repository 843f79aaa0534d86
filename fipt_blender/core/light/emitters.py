"""Emitters (paper Sec. 4.4 "Emitter extraction"), grouped into fixtures; :mod:`.evidence` finds them.

An emitter is assumed to reflect nothing, so its radiance is the median of the pixels that see it (closed form
of paper Eq. 13). Connected triangles of similar radiance form a fixture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..optics.lights import LUMINANCE, EmitterTable
from ..parts.components import component_means, graph_components
from ..parts.labels import room_pieces
from ..pixels.grouped import grouped_sums, grouped_weighted_median
from ..pixels.store import PixelStore
from ..surface.adjacency import weld
from ..surface.room import Room
from .scan_fixtures import scan_groups, seen_sides

# A side of a fixture emits if its luminance is at least this share of the brighter side's.
DIM_SIDE = 0.1
# Neighbouring triangles belong to one fixture if their luminance differs by less than this factor.
ALIKE = 1.5
# A triangle's radiance is measured if the weights of its pixels sum to at least this (a pure pixel has 1);
# others take that of their neighbours.
MIN_MEASURED = 1.0
# Triangles that exceed the room's mean by this factor are aimed at before emitters are known.
BRIGHT = 8.0
# Of presumed lamps: largest median deviation of the radiance of a lamp, relative to its median (lamps of the
# test rooms are below 0.03, shades that a bulb lights above 0.15); unseen triangles are bright if more than
# this share of their component's seen area is; least weight of the pixels that show a lamp, as the
# radiance of single ones is constant in any case.
CONSTANT_DEVIATION, MAJORITY, MIN_PIXELS = 0.08, 0.5, 5.0
# Pixels per chunk: arrays of all pixels of a large capture would take gigabytes.
CHUNK = 1 << 20


@dataclass(frozen=True)
class Fixture:
    """A lamp: connected triangles with one radiance per side.

    Attributes:
        triangles: (n,) int64 room triangle indices.
        radiance: (3,) of the front side, in the units of the pixels.
        back_radiance: (3,) of the back side.
        area: square metres.
        centroid: (3,) area-weighted, metres.
        probability: that it emits.
    """

    triangles: np.ndarray
    radiance: np.ndarray
    back_radiance: np.ndarray
    area: float
    centroid: np.ndarray
    probability: float = 1.0


def fixture_of(fixtures: Sequence[Fixture], triangles: int) -> np.ndarray:
    """(T,) int64 fixture of each of so many triangles, -1 for none."""
    result = np.full(triangles, -1, np.int64)
    for index, fixture in enumerate(fixtures):
        result[fixture.triangles] = index
    return result


def pixels_on(pixels: PixelStore, marked: np.ndarray) -> np.ndarray:
    """(R,) int64 pixels that see one of the triangles marked ((T,) bool)."""
    rows = [np.zeros(0, np.int64)]
    for start in range(0, len(pixels.triangle), CHUNK):
        chunk = pixels.triangle[start : start + CHUNK]
        rows.append(np.flatnonzero((chunk >= 0) & marked[np.maximum(chunk, 0)]) + start)
    return np.concatenate(rows)


def side_medians(pixels: PixelStore, rows: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Per-channel weighted median of the radiance of each group's two sides.

    Args:
        rows: (R,) pixels that see triangles; few.
        group: (T,) int group of each triangle, negative without.

    Returns:
        (groups, 2, 3) medians, front first, and (groups, 2) sums of weights.
    """
    groups = int(group.max(initial=-1)) + 1
    rows = rows[group[pixels.triangle[rows]] >= 0]
    side = group[pixels.triangle[rows]] * 2 + ~pixels.front[rows]
    weight = pixels.weight[rows].astype(np.float64)
    columns = pixels.own[rows].T.astype(np.float64)
    medians = [grouped_weighted_median(column, weight, side, groups * 2) for column in columns]
    weights = np.bincount(side, weight, minlength=groups * 2)
    return np.stack(medians, axis=1).reshape(groups, 2, 3), weights.reshape(groups, 2)


def group_fixtures(
    room: Room,
    emitting: np.ndarray,
    pixels: PixelStore,
    surface: np.ndarray | None = None,
    probability: np.ndarray | None = None,
) -> list[Fixture]:
    """Fixtures of the emitting triangles ((T,) bool), in descending order of power.

    Args:
        surface: (T,) int, on a scan a fixture belongs to one of these surfaces; None: all are one.
        probability: (T,) of the triangles to emit; None: they do.
    """
    corners = weld(room.vertices)[room.triangles]
    ids = np.flatnonzero(emitting)
    if not len(ids):
        return []
    rows = pixels_on(pixels, emitting)  # few, so they fit into memory
    emitter = np.full(len(emitting), -1, np.int64)  # a group per triangle
    emitter[ids] = np.arange(len(ids))
    medians, weights = side_medians(pixels, rows, emitter)
    luminance = (medians @ LUMINANCE).max(axis=1)
    measured = weights.sum(axis=1) >= MIN_MEASURED
    group = np.full(len(emitting), -1, np.int64)
    if room.scan is None:
        group[ids] = emitter_components(corners[ids], luminance, measured)
    else:
        group[ids] = scan_groups(room.scan, ids, surface)
    medians, total = side_medians(pixels, rows, group)
    known = total >= np.minimum(total.max(axis=1, keepdims=True, initial=0.0), MIN_MEASURED)
    if room.scan is not None:
        known &= seen_sides(room.areas[ids], weights > 0.0, group[ids])
    fixtures = []
    closing = room.closing
    for index in range(len(medians)):
        members = np.flatnonzero(group == index)
        if closing[members].all():
            continue  # the light is what is seen through a hole that was closed
        sides = medians[index] * known[index][:, None]
        luminance = sides @ LUMINANCE
        if not luminance.max() > 0.0:
            continue
        sides = np.where((luminance >= DIM_SIDE * luminance.max())[:, None], sides, 0.0)
        area = room.areas[members]
        if not area.sum() > 0.0:
            continue
        middle = room.vertices[room.triangles[members]].mean(axis=1)
        centroid = (middle * area[:, None]).sum(axis=0) / area.sum()
        likely = 1.0 if probability is None else float(np.average(probability[members], weights=area))
        fixtures.append(Fixture(members, sides[0], sides[1], float(area.sum()), centroid, probability=likely))
    return sorted(fixtures, key=lambda f: -f.area * float((f.radiance + f.back_radiance) @ LUMINANCE))


def emitter_components(corners: np.ndarray, luminance: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """(n,) int64 component of each emitting triangle: neighbours (shared vertex) of similar luminance.

    Args:
        corners: (n, 3) welded vertices.
        luminance: (n,) of the brighter side.
        measured: (n,) bool, whether pixels measured it; other triangles join all their neighbours.
    """
    # Around each vertex, unmeasured triangles first, which join all others there; then by luminance: if two
    # are similar, all between them are too, so that links between neighbours in this order suffice.
    of_corner = np.repeat(np.where(measured, luminance, -1.0), 3)
    order = np.lexsort((of_corner, corners.reshape(-1)))
    vertex = corners.reshape(-1)[order]
    owner = order // 3
    first = np.concatenate([[True], vertex[1:] != vertex[:-1]])
    anchor = owner[np.maximum.accumulate(np.where(first, np.arange(len(owner)), 0))]
    chain = np.stack([owner[1:], owner[:-1]], axis=1)[vertex[1:] == vertex[:-1]]
    pairs = np.concatenate([chain, np.stack([owner, anchor], axis=1)])
    low, high = np.sort(luminance[pairs], axis=1).T
    similar = ~(measured[pairs].all(axis=1)) | (high <= ALIKE * np.maximum(low, 1e-12))
    return graph_components(pairs[similar], len(corners))


def bright_triangles(room: Room, pixels: PixelStore) -> EmitterTable:
    """Triangles to sample before any emitter is known: those much brighter than the room's mean.

    They affect the variance only, never the expectation.
    """
    sums = np.zeros((2 * len(room.triangles), 4))
    for start in range(0, len(pixels.triangle), CHUNK):
        rows = slice(start, start + CHUNK)
        hit = np.flatnonzero(np.asarray(pixels.triangle[rows]) >= 0)
        side = np.asarray(pixels.triangle[rows])[hit] * 2 + ~pixels.front[rows][hit]
        sums += grouped_sums(np.insert(pixels.radiance[rows][hit], 3, 1.0, axis=1), side, len(sums))
    means = sums[:, :3] / np.maximum(sums[:, 3:], 1.0)
    sides = means[0::2], means[1::2]
    light = np.maximum(*(side @ LUMINANCE for side in sides))
    seen = light > 0
    mean = float(np.average(light[seen], weights=room.areas[seen])) if (room.areas * seen).sum() > 0 else 0.0
    bright = np.flatnonzero(light > BRIGHT * mean) if mean > 0 else np.zeros(0, np.int64)
    return EmitterTable(
        bright.astype(np.int32), sides[0][bright].astype(np.float32), sides[1][bright].astype(np.float32)
    )


def presume_lamps(room: Room, pixels: PixelStore, bright: EmitterTable) -> tuple[EmitterTable, np.ndarray]:
    """Triangles to aim at in stage 1, and which of them are presumed to be lamps: bright and of one radiance.

    A voxel of the radiance cache that holds a bulb or a strip of light and the surfaces beside it is too dark
    for the one and too bright for the others. The radiance of presumed lamps is therefore that of their
    fixture.

    Args:
        bright: triangles much brighter than the room (:func:`bright_triangles`).

    Returns:
        a table of presumed lamps and of other bright triangles, which are `reflective`: their radiance is in
        the cache; and (T,) bool, the lamps.
    """
    lamps = np.zeros(len(room.triangles), bool)
    if not len(bright.triangles):
        return bright, lamps
    marked = lamps.copy()
    marked[bright.triangles] = True
    seen = _shown(pixels, len(lamps))
    marked |= ~seen & (component_means(room.areas, room_pieces(room), marked, seen) > MAJORITY)
    fixtures = group_fixtures(room, marked, pixels)
    fixture = fixture_of(fixtures, len(lamps))
    rows = pixels_on(pixels, fixture >= 0)
    index, weight = fixture[pixels.triangle[rows]], pixels.weight[rows].astype(np.float64)
    shown = np.bincount(index, weight, minlength=len(fixtures)) >= MIN_PIXELS
    side, luminance = index * 2 + ~pixels.front[rows], pixels.own[rows] @ LUMINANCE
    median = grouped_weighted_median(luminance, weight, side, 2 * len(fixtures))[side]
    deviation = np.abs(luminance - median) / np.maximum(median, 1e-12)
    shown &= grouped_weighted_median(deviation, weight, index, len(fixtures)) < CONSTANT_DEVIATION
    table = EmitterTable.from_fixtures([each for each, kept in zip(fixtures, shown, strict=True) if kept])
    lamps[table.triangles] = True
    others = ~lamps[bright.triangles]
    columns = (bright.triangles[others], bright.radiance[others], bright.back_radiance[others])
    return table.joined(EmitterTable(*columns, reflective=np.ones(int(others.sum()), bool))), lamps


def _shown(pixels: PixelStore, triangles: int) -> np.ndarray:
    """(T,) bool, triangles that some pixel shows."""
    seen = np.zeros(triangles, bool)
    for start in range(0, len(pixels.triangle), CHUNK):
        rows = slice(start, start + CHUNK)
        triangle = np.asarray(pixels.triangle[rows])
        seen[triangle[(triangle >= 0) & (pixels.weight[rows] > 0.0)]] = True
    return seen
