"""The closed-form estimate on all surfaces: one base colour for each cell, a cache entry and a group in it.

It serves the search for emitters and stage 3 in all rounds. Once roughness and metallic of the groups are
given, the rendering is linear in base colour (paper Eq. 5), so the pixels of a cell determine it by least
squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..light.baking import ShadingStore
from ..light.observations import Observations
from ..pixels.grouped import first_by_key, grouped_sums, place_of
from ..run.threads import in_threads
from .mixture import GroupMaterials
from .pixel_samples import residual_weight, rows_with_donor
from .projection import color_lines

# Roughness of groups that paths follow although they may be rough, in units of the limit; tables are rounded.
BELOW_LIMIT = 0.99


@dataclass(frozen=True)
class TrainingData:
    """The pixels of a run with their shadings and groups; per-pixel arrays may be memory-mapped.

    Attributes:
        observations: N pixels, and the P of them to train on.
        shadings: of all pixels.
        group: (N,) int part of each pixel, or the group in its place (:mod:`.groups`), negative for none.
        materials: closed-form estimate of the groups, sigma' and m' of l_p.
    """

    observations: Observations
    shadings: ShadingStore
    group: np.ndarray
    materials: GroupMaterials


@dataclass(frozen=True)
class CellEstimate:
    """Values of C cells, in ascending order of their keys.

    Attributes:
        keys: (C,) int64: cache entry times the number of groups plus one, plus the group plus one.
        color: (C, 3) float32 base colour.
        pixels: (C,) number of pixels, mixed ones by their weight.
        triangle: (C,) int64 a triangle that one of them sees.
        materials: (groups + 1, 2) roughness and metallic (:attr:`.GroupMaterials.of_pixels`).
    """

    keys: np.ndarray
    color: np.ndarray
    pixels: np.ndarray
    triangle: np.ndarray
    materials: np.ndarray

    @property
    def entry(self) -> np.ndarray:
        """(C,) int64 cache entry of each cell."""
        return self.keys // len(self.materials)

    @property
    def group(self) -> np.ndarray:
        """(C,) int64 group of each cell, -1 for none."""
        return self.keys % len(self.materials) - 1

    @property
    def values(self) -> np.ndarray:
        """(C, 5) float32 base colour, roughness and metallic of the cells."""
        return np.column_stack([self.color, self.materials[self.group]]).astype(np.float32)

    def of_pixels(self, data: TrainingData, rows: np.ndarray) -> np.ndarray:
        """(R,) int64 cell of the pixels `rows` (R,); -1 for those whose cell has no estimate."""
        return place_of(self.keys, _keys(data, rows))

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


def fit_cells(data: TrainingData) -> CellEstimate:
    """The base colours of all cells.

    Args:
        data: pixels, their shadings, and the roughness and metallic of their groups.
    """
    views = range(len(data.observations.pixels.views))
    keys, triangle = first_by_key(in_threads(partial(_cells_of_view, data), views))
    sums = np.zeros((len(keys), 7))
    for view_keys, view_sums in in_threads(partial(_moments_of_view, data), views):
        sums[np.searchsorted(keys, view_keys)] += view_sums
    # The pixels' radiance is slope a + offset: the least weighted squares of the residuals.
    color = np.clip(sums[:, :3] / np.maximum(sums[:, 3:6], 1e-12), 0.0, 1.0).astype(np.float32)
    return CellEstimate(keys, color, sums[:, 6], triangle, data.materials.of_pixels)


def _keys(data: TrainingData, rows: np.ndarray) -> np.ndarray:
    """(R,) int64 keys of the cells (:class:`CellEstimate`) of pixels with a donor."""
    entry, group = (np.asarray(array[rows], np.int64) for array in (data.observations.entry, data.group))
    return entry * (len(data.materials.mean) + 1) + group + 1


def _cells_of_view(data: TrainingData, view: int) -> tuple[np.ndarray, np.ndarray]:
    """(C,) ascending keys of the cells that a view sees, and (C,) the triangle of the first pixel in each."""
    rows = rows_with_donor(data.observations, view)
    keys, first = np.unique(_keys(data, rows), return_index=True)
    return keys, np.asarray(data.observations.pixels.triangle[rows[first]], np.int64)


def _moments_of_view(data: TrainingData, view: int) -> tuple[np.ndarray, np.ndarray]:
    """What a view adds to the C cells that it sees.

    Returns:
        (C,) int64 keys, ascending; (C, 7) weighted sums of slope times rest and of squared slopes, three
        channels each, and the pixels by their weight.
    """
    observations, pixels = data.observations, data.observations.pixels
    rows = rows_with_donor(observations, view)
    donor = observations.donor[rows]
    radiance = np.asarray(pixels.own[donor], np.float64)
    slope, offset = color_lines(data.shadings, donor, data.materials.of_pixels[data.group[rows]])
    share = np.asarray(pixels.weight[donor], np.float64)
    weight, rest = share[:, None] * residual_weight(radiance), radiance - offset
    moments = (weight * slope * rest, weight * slope**2)
    keys, place = np.unique(_keys(data, rows), return_inverse=True)
    return keys, grouped_sums(np.column_stack([*moments, share]), place)


def followed_by_paths(cells: CellEstimate, errors: np.ndarray, limit: float) -> CellEstimate:
    """The estimate as the paths of stage 3 take it, which end in the cache at roughness above `limit`.

    A group that may be smoother, by the standard deviation of its posterior, counts as just below the limit:
    the cache holds the highlights of such a surface as they look from the photographs' directions.

    Args:
        errors: (groups,) standard deviation of the groups' roughness.
    """
    roughness = cells.materials[:, 0]
    unsure = (roughness > limit) & (roughness - np.append(errors, 0.0) <= limit)
    followed = np.where(unsure, BELOW_LIMIT * limit, roughness)
    return replace(cells, materials=np.column_stack([followed, cells.materials[:, 1]]))


def white_rows(data: TrainingData, rows: np.ndarray) -> np.ndarray:
    """(R, 3) float32 most that a surface reflects with the gloss of its group, in the pixels `rows` (R,)."""
    slope, offset = color_lines(data.shadings, rows, data.materials.of_pixels[data.group[rows]])
    diffuse = np.asarray(data.shadings.diffuse[rows], np.float32)
    return np.asarray(np.maximum(diffuse, slope) + offset, np.float32)
