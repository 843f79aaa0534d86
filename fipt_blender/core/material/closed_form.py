# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form estimate on all surfaces: one base colour for each cell, a cache entry and a group in it.

It serves the search for emitters and stage 3 in all rounds. Once roughness and metallic of the groups are
given, the rendering is linear in base colour (paper Eq. 5), so the pixels of a cell determine it by least
squares.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..run.threads import in_threads
from .pixel_samples import DIFFUSE, GroupedPixels, rows_with_donor
from .projection import residual_weight

# Photographed radiance above this multiple of what a white surface would reflect is emission.
CLEAR_EMISSION = 1.5
# Share of a triangle's pixels that must be brighter than any reflection for the triangle to be marked.
MARKED_SHARE = 0.5
# Emission is not looked for in pixels darker than the capture's median.
LEAST_EMISSION = 1.0
# Roughness of groups that paths follow although they may be rough, in units of the limit; tables are rounded.
BELOW_LIMIT = 0.99
# Keys of the cells of single views that are kept before they are merged.
MERGED_KEYS = 1 << 22


@dataclass(frozen=True)
class CellEstimate:
    """Values of C cells, in ascending order of their keys.

    Attributes:
        keys: (C,) int64: cache entry times the number of groups plus one, plus the group plus one.
        groups: number of groups.
        color: (C, 3) float32 base colour.
        emission: (C, 3) float32 L_e in units of the capture's median; zero unless it is fitted jointly.
        pixels: (C,) number of pixels, mixed ones by their weight.
        triangle: (C,) int64 a triangle that one of them sees.
        materials: (groups + 1, 2) roughness and metallic of the groups, and of pixels without one.
    """

    keys: np.ndarray
    groups: int
    color: np.ndarray
    emission: np.ndarray
    pixels: np.ndarray
    triangle: np.ndarray
    materials: np.ndarray

    @property
    def entry(self) -> np.ndarray:
        """(C,) int64 cache entry of each cell."""
        return self.keys // (self.groups + 1)

    @property
    def group(self) -> np.ndarray:
        """(C,) int64 group of each cell, -1 for none."""
        return self.keys % (self.groups + 1) - 1

    @property
    def values(self) -> np.ndarray:
        """(C, 5) float32 base colour, roughness and metallic of the cells."""
        return np.column_stack([self.color, self.materials[self.group]])

    def find(self, entry: np.ndarray, group: np.ndarray) -> np.ndarray:
        """(N,) int64 cell of cache entries and groups (N,); -1 where no pixel saw the group in the entry."""
        wanted = entry.astype(np.int64) * (self.groups + 1) + group + 1
        place = np.minimum(np.searchsorted(self.keys, wanted), len(self.keys) - 1)
        return np.where(self.keys[place] == wanted, place, -1) if len(self.keys) else np.full(len(entry), -1)

    def by_entry(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The cells of each cache entry together.

        Returns:
            (E,) int64 entries, ascending, (E, 5) float32 mean values of their pixels, and (E,) the triangle
            of the cell with the most pixels.
        """
        order = np.lexsort((-self.pixels, self.entry))
        entries, first = np.unique(self.entry[order], return_index=True)
        place = np.searchsorted(entries, self.entry)
        count = np.bincount(place, self.pixels)
        sums = [np.bincount(place, self.pixels * column) for column in self.values.T]
        return (
            entries,
            np.stack(sums, axis=1).astype(np.float32) / count[:, None],
            self.triangle[order][first],
        )


def fit_cells(data: GroupedPixels, joint: float | None = None) -> tuple[CellEstimate, np.ndarray]:
    """The base colours of all cells, and how much each triangle looks like an emitter.

    Args:
        joint: fit an emission of each cell too, with this weight of its L1 norm (ablation).

    Returns:
        The estimate, and (T,) the share of each triangle's pixels that are brighter than a white surface.
    """
    views = range(len(data.observations.pixels.views))
    triangles = len(data.observations.parts.triangle_part)
    keys, triangle = _first_triangles(in_threads(partial(_cells_of_view, data), views))
    count, bright, sums = np.zeros(triangles), np.zeros(triangles), np.zeros((len(keys), 16))
    for seen in in_threads(partial(_moments_of_view, data), views):
        count += np.bincount(seen.triangle, seen.share, minlength=triangles)
        bright += np.bincount(seen.triangle, seen.share * seen.emits, minlength=triangles)
        sums[np.searchsorted(keys, seen.keys)] += seen.sums
    color, emission = (values.astype(np.float32) for values in _solve(sums, joint))
    materials = np.append(data.materials.mean, DIFFUSE, axis=0)
    cells = CellEstimate(keys, data.groups, color, emission, sums[:, 15], triangle, materials)
    return cells, bright / np.maximum(count, 1e-6)


@dataclass(frozen=True)
class _ViewMoments:
    """What the n pixels of a view add to the C cells in which they lie.

    Attributes:
        keys: (C,) int64, ascending.
        sums: (C, 16) weighted moments of :func:`_solve`, and the sum of the weights.
        triangle: (n,) int64 that each pixel sees. share: (n,) weight. emits: (n,) bool, brighter than white.
    """

    keys: np.ndarray
    sums: np.ndarray
    triangle: np.ndarray
    share: np.ndarray
    emits: np.ndarray


def _keyed_rows(data: GroupedPixels, view: int) -> tuple[np.ndarray, np.ndarray]:
    """(n,) pixels of a view that have a donor, and the keys of their cells; int64."""
    rows = rows_with_donor(data.observations, view)
    entry, group = (np.asarray(of[rows], np.int64) for of in (data.observations.entry, data.group))
    return rows, entry * (data.groups + 1) + group + 1


def _cells_of_view(data: GroupedPixels, view: int) -> tuple[np.ndarray, np.ndarray]:
    """(C,) ascending keys of the cells that a view sees, and (C,) the triangle of the first pixel in each."""
    rows, key = _keyed_rows(data, view)
    keys, first = np.unique(key, return_index=True)
    return keys, np.asarray(data.observations.pixels.triangle[rows[first]], np.int64)


def _first_triangles(views: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Ascending keys of all views, and for each the triangle of the first view that has it."""
    keys, triangle = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for key, on in views:
        keys.append(key)
        triangle.append(on)
        if sum(map(len, keys[1:])) > max(len(keys[0]), MERGED_KEYS):
            keys, triangle = ([array] for array in _merged(keys, triangle))
    return _merged(keys, triangle)


def _merged(keys: list[np.ndarray], triangle: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    merged, first = np.unique(np.concatenate(keys), return_index=True)
    return merged, np.concatenate(triangle)[first]


def _moments_of_view(data: GroupedPixels, view: int) -> _ViewMoments:
    pixels = data.observations.pixels
    rows, key = _keyed_rows(data, view)
    donor = data.observations.donor[rows]
    radiance, diffuse = (
        np.asarray(array[donor], np.float64) for array in (pixels.own, data.shadings.diffuse)
    )
    slope, offset = data.lines(donor, data.material_of(rows))
    share = np.asarray(pixels.weight[donor], np.float64)
    white = CLEAR_EMISSION * (np.maximum(diffuse, slope) + offset)
    emits = (radiance > white).all(axis=1) & (radiance.mean(axis=1) > LEAST_EMISSION)
    weight, rest = share[:, None] * residual_weight(radiance), radiance - offset
    moments = (weight * slope * rest, weight * slope**2, weight * slope, weight * rest, weight)
    keys, place = np.unique(key, return_inverse=True)
    columns = [*np.concatenate(moments, axis=1).T, share]
    sums = np.stack([np.bincount(place, column, minlength=len(keys)) for column in columns], axis=1)
    triangle = np.asarray(pixels.triangle[rows], np.int64)
    return _ViewMoments(keys, sums, triangle, share, emits)


def _solve(sums: np.ndarray, joint: float | None) -> tuple[np.ndarray, np.ndarray]:
    """(C, 3) base colours in [0, 1] and (C, 3) emission of cells by the moments of their pixels.

    The pixels' radiance is slope a + offset + L_e. Minimised is the sum over the pixels of the weighted
    squared residual plus `joint` |L_e|; without `joint`, L_e is zero.
    """
    by_rest, by_slope, slope, rest, weight = (sums[:, 3 * k : 3 * k + 3] for k in range(5))
    by_slope = np.maximum(by_slope, 1e-12)
    color = np.clip(by_rest / by_slope, 0.0, 1.0)
    if joint is None:
        return color, np.zeros_like(color)
    rest = rest - 0.5 * joint * sums[:, 15:]
    determinant = np.maximum(by_slope * weight - slope**2, 1e-6 * by_slope * weight)
    both = np.clip((weight * by_rest - slope * rest) / determinant, 0.0, 1.0)
    emission = (rest - slope * both) / np.maximum(weight, 1e-12)
    shines = emission > 0.0
    return np.where(shines, both, color), np.where(shines, emission, 0.0)


def followed_by_paths(cells: CellEstimate, errors: np.ndarray, limit: float) -> CellEstimate:
    """The estimate as the paths of stage 3 take it, which end in the cache at roughness above `limit`.

    A group that may be smoother, by the standard deviation of its posterior, counts as just below the limit:
    the cache holds the highlights of such a surface as they look from the photographs' directions.

    Args:
        errors: (groups,) standard deviation of the groups' roughness.
    """
    materials = cells.materials.copy()
    roughness = materials[:, 0]
    unsure = (roughness > limit) & (roughness - np.append(errors, 0.0) <= limit)
    roughness[unsure] = BELOW_LIMIT * limit
    return replace(cells, materials=materials)


def render_rows(cells: CellEstimate, data: GroupedPixels, rows: np.ndarray) -> np.ndarray:
    """(R, 3) float32 reflected radiance (paper Eq. 5) of the pixels `rows` (R,) with their own shadings.

    Pixels in cells without an estimate get that of a white surface.
    """
    slope, offset = data.lines(rows, data.material_of(rows))
    return (slope * colors_at(cells, data, rows, 1.0) + offset).astype(np.float32)


def colors_at(cells: CellEstimate, data: GroupedPixels, rows: np.ndarray, missing: float) -> np.ndarray:
    """(R, 3) float32 base colour of the cells of the pixels `rows` (R,), `missing` without a cell."""
    place = cells.find(data.observations.entry[rows], np.asarray(data.group[rows], np.int64))
    return np.where(place[:, None] >= 0, cells.color[place], np.float32(missing))


def triangle_emission(cells: CellEstimate, data: GroupedPixels) -> np.ndarray:
    """(T, 3) float32 mean emission of the pixels that see each triangle."""
    pixels, triangles = data.observations.pixels, len(data.observations.parts.triangle_part)
    sums, count = np.zeros((triangles, 3)), np.zeros(triangles)
    for view in range(len(pixels.views)):
        rows, key = _keyed_rows(data, view)
        on = np.asarray(pixels.triangle[rows])
        np.add.at(sums, on, cells.emission[np.searchsorted(cells.keys, key)])
        count += np.bincount(on, minlength=triangles)
    return (sums / np.maximum(count, 1.0)[:, None]).astype(np.float32)
