# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form estimate on all surfaces: one base colour for each cell, a cache entry and a group in it.

It serves the search for emitters and stage 3 in all rounds. Once roughness and metallic of the groups are
given, the rendering is linear in base colour (paper Eq. 5), so the pixels of a cell determine it by least
squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..light.observations import Observations
from ..optics.factorised import color_line
from ..run.threads import in_threads
from ..scene.grouped import first_by_key, grouped_sums
from .pixel_samples import residual_weight, rows_with_donor
from .projection import specular_at
from .training import TrainingData

# Photographed radiance above this multiple of what a white surface would reflect is emission.
CLEAR_EMISSION = 1.5
# Share of a triangle's pixels that must be brighter than any reflection for the triangle to be marked.
MARKED_SHARE = 0.5
# Emission is not looked for in pixels darker than the capture's median.
LEAST_EMISSION = 1.0
# Roughness of groups that paths follow although they may be rough, in units of the limit; tables are rounded.
BELOW_LIMIT = 0.99


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
        roughness, metallic: (groups + 1,) of the groups; the last is of pixels without a group.
    """

    keys: np.ndarray
    groups: int
    color: np.ndarray
    emission: np.ndarray
    pixels: np.ndarray
    triangle: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray

    @property
    def entry(self) -> np.ndarray:
        """(C,) int64 cache entry of each cell."""
        return self.keys // (self.groups + 1)

    @property
    def values(self) -> np.ndarray:
        """(C, 5) float32 base colour, roughness and metallic of the cells."""
        group = self.keys % (self.groups + 1) - 1
        return np.column_stack([self.color, self.roughness[group], self.metallic[group]]).astype(np.float32)

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
        sums = grouped_sums(self.pixels[:, None] * self.values, place)
        return entries, sums.astype(np.float32) / count[:, None], self.triangle[order][first]


def fit_cells(
    observations: Observations, data: TrainingData, joint: float | None = None
) -> tuple[CellEstimate, np.ndarray]:
    """The base colours of all cells, and how much each triangle looks like an emitter.

    Args:
        data: pixels, their shadings, and the roughness and metallic of their groups.
        joint: fit an emission of each cell too, with this weight of its L1 norm (ablation).

    Returns:
        The estimate, and (T,) the share of each triangle's pixels that are brighter than a white surface.
    """
    groups = len(data.group_roughness)
    roughness, metallic = np.append(data.group_roughness, 1.0), np.append(data.group_metallic, 0.0)
    views = range(len(observations.pixels.views))
    triangles = len(observations.parts.triangle_part)
    keys, triangle = first_by_key(in_threads(partial(_cells_of_view, observations, data), views))
    count, bright, sums = np.zeros(triangles), np.zeros(triangles), np.zeros((len(keys), 16))
    for seen in in_threads(partial(_moments_of_view, observations, data, roughness, metallic), views):
        count += np.bincount(seen.triangle, seen.share, minlength=triangles)
        bright += np.bincount(seen.triangle, seen.share * seen.emits, minlength=triangles)
        sums[np.searchsorted(keys, seen.keys)] += seen.sums
    color, emission = _solve(sums, joint)
    cells = CellEstimate(
        keys,
        groups,
        color.astype(np.float32),
        emission.astype(np.float32),
        sums[:, 15],
        triangle,
        roughness,
        metallic,
    )
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


def _keyed_rows(
    observations: Observations, data: TrainingData, view: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) pixels of a view that have a donor, their groups, and the keys of their cells; int64."""
    rows = rows_with_donor(observations.pixels, data.donor, view)
    group = np.asarray(data.group[rows], np.int64)
    key = np.asarray(observations.entry[rows], np.int64) * (len(data.group_roughness) + 1) + group + 1
    return rows, group, key


def _cells_of_view(
    observations: Observations, data: TrainingData, view: int
) -> tuple[np.ndarray, np.ndarray]:
    """(C,) ascending keys of the cells that a view sees, and (C,) the triangle of the first pixel in each."""
    rows, _, key = _keyed_rows(observations, data, view)
    keys, first = np.unique(key, return_index=True)
    return keys, np.asarray(observations.pixels.triangle[rows[first]], np.int64)


def _moments_of_view(
    observations: Observations, data: TrainingData, roughness: np.ndarray, metallic: np.ndarray, view: int
) -> _ViewMoments:
    """The moments of one view; roughness and metallic (groups + 1,)."""
    rows, group, key = _keyed_rows(observations, data, view)
    donor = data.donor[rows]
    radiance, diffuse = (np.asarray(array[donor], np.float64) for array in (data.radiance, data.diffuse))
    s0, s1 = specular_at(data.specular, donor, data.levels, roughness[group])
    slope, offset = color_line(diffuse, s0, s1, metallic[group][:, None])
    share = np.asarray(observations.pixels.weight[donor], np.float64)
    white = CLEAR_EMISSION * (np.maximum(diffuse, slope) + offset)
    emits = (radiance > white).all(axis=1) & (radiance.mean(axis=1) > LEAST_EMISSION)
    weight, rest = share[:, None] * residual_weight(radiance), radiance - offset
    moments = (weight * slope * rest, weight * slope**2, weight * slope, weight * rest, weight)
    keys, place = np.unique(key, return_inverse=True)
    sums = grouped_sums(np.column_stack([*moments, share]), place)
    triangle = np.asarray(observations.pixels.triangle[rows], np.int64)
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
    lowest = cells.roughness - np.append(errors, 0.0)
    unsure = (cells.roughness > limit) & (lowest <= limit)
    return replace(cells, roughness=np.where(unsure, BELOW_LIMIT * limit, cells.roughness))


def render_rows(
    cells: CellEstimate, observations: Observations, data: TrainingData, rows: np.ndarray
) -> np.ndarray:
    """(R, 3) float32 reflected radiance (paper Eq. 5) of the pixels `rows` (R,) with their own shadings.

    Pixels in cells without an estimate get that of a white surface.
    """
    group = np.asarray(data.group[rows], np.int64)
    place = cells.find(observations.entry[rows], group)
    color = np.where(place[:, None] >= 0, cells.color[place], 1.0)
    s0, s1 = specular_at(data.specular, rows, data.levels, cells.roughness[group])
    diffuse = np.asarray(data.diffuse[rows], np.float32)
    slope, offset = color_line(diffuse, s0, s1, cells.metallic[group][:, None])
    return (slope * color + offset).astype(np.float32)


def triangle_emission(cells: CellEstimate, observations: Observations, data: TrainingData) -> np.ndarray:
    """(T, 3) float32 mean emission of the pixels that see each triangle."""
    pixels, triangles = observations.pixels, len(observations.parts.triangle_part)
    sums, count = np.zeros((triangles, 3)), np.zeros(triangles)
    for view in range(len(pixels.views)):
        rows, group, _ = _keyed_rows(observations, data, view)
        emission = cells.emission[cells.find(observations.entry[rows], group)]
        on = np.asarray(pixels.triangle[rows])
        np.add.at(sums, on, emission)
        count += np.bincount(on, minlength=triangles)
    return (sums / np.maximum(count, 1.0)[:, None]).astype(np.float32)
