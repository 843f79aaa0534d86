# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Presumed lamps of stage 1: bright surfaces of constant radiance, before anything is estimated.

A voxel of the radiance cache that holds a bulb or a strip of light and the surfaces beside it is too dark for
the one and too bright for the others. The radiance of presumed lamps is therefore that of their fixture.
"""

from __future__ import annotations

import numpy as np

from ..optics.lights import LUMINANCE, EmitterTable
from ..parts.components import component_means
from ..parts.labels import room_pieces
from ..pixels.grouped import grouped_weighted_median
from ..surface.room import Room
from .emitters import CHUNK, EmitterPixels, emitter_table, group_fixtures, pixels_on

# Largest median deviation of the radiance of a lamp, relative to its median: lamps of the test rooms are
# below 0.03, shades that a bulb lights above 0.15.
CONSTANT_DEVIATION = 0.08
# Triangles that no pixel shows are bright if more than this share of their component's seen area is.
MAJORITY = 0.5
# Least weight of the pixels that show a lamp: the radiance of single ones is constant in any case.
MIN_PIXELS = 5.0


def presume_lamps(room: Room, pixels: EmitterPixels, bright: EmitterTable) -> tuple[EmitterTable, np.ndarray]:
    """Triangles to aim at in stage 1, and which of them have a radiance of their own.

    Args:
        bright: triangles much brighter than the room (:func:`.emitters.bright_triangles`).

    Returns:
        a table of presumed lamps and of other bright triangles, which are `reflective`: their radiance is in
        the cache; and (T,) bool, the lamps.
    """
    lamps = np.zeros(len(room.triangles), bool)
    if not len(bright.triangles):
        return bright, lamps
    marked = lamps.copy()
    marked[bright.triangles] = True
    seen = _seen(pixels, len(lamps))
    marked |= ~seen & (component_means(room.areas, room_pieces(room), marked, seen) > MAJORITY)
    fixtures = group_fixtures(room, marked, pixels)
    fixture = np.full(len(lamps), -1, np.int64)
    for index, each in enumerate(fixtures):
        fixture[each.triangles] = index
    on_them = pixels.rows(pixels_on(pixels.triangle, fixture >= 0))
    shown = np.bincount(fixture[on_them.triangle], on_them.weight, minlength=len(fixtures)) >= MIN_PIXELS
    shown &= _deviation(on_them, fixture, len(fixtures)) < CONSTANT_DEVIATION
    table = emitter_table([each for each, kept in zip(fixtures, shown, strict=True) if kept])
    lamps[table.triangles] = True
    others = ~lamps[bright.triangles]
    columns = (bright.triangles[others], bright.radiance[others], bright.back_radiance[others])
    return table.joined(EmitterTable(*columns, reflective=np.ones(int(others.sum()), bool))), lamps


def _seen(pixels: EmitterPixels, triangles: int) -> np.ndarray:
    """(T,) bool, triangles that some pixel shows."""
    seen = np.zeros(triangles, bool)
    for start in range(0, len(pixels.triangle), CHUNK):
        rows = slice(start, start + CHUNK)
        triangle = np.asarray(pixels.triangle[rows])
        seen[triangle[(triangle >= 0) & (pixels.weight[rows] > 0.0)]] = True
    return seen


def _deviation(pixels: EmitterPixels, fixture: np.ndarray, count: int) -> np.ndarray:
    """(count,) weighted median deviation of luminance from the median of its side, relative to that.

    Args:
        pixels: that see fixtures; in memory.
        fixture: (T,) int fixture of each triangle.
    """
    index = fixture[pixels.triangle]
    side = index * 2 + ~pixels.front
    luminance, weight = pixels.radiance @ LUMINANCE, pixels.weight.astype(np.float64)
    median = grouped_weighted_median(luminance, weight, side, 2 * count)[side]
    deviation = np.abs(luminance - median) / np.maximum(median, 1e-12)
    return grouped_weighted_median(deviation, weight, index, count)
