"""The input of stage 2: the pixels with their groups, and the materials of the groups."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..light.baking import ShadingStore
from ..light.cache import SIDES
from ..light.observations import Observations
from ..parts.labels import Parts, count_votes
from ..pixels.grouped import grouped_sums, numbered
from ..pixels.store import CELL_PIXELS, open_array
from ..run.stage_settings import MaterialSettings
from .closed_form import TrainingData, fit_cells
from .groups import (
    MAX_GROUPS,
    NO_GROUP,
    Units,
    group_units,
    join_cells,
    neighbours,
)
from .hints import SurfaceHints, values_of_hints
from .mixture import GroupMaterials, infer_materials
from .pixel_samples import PixelSamples, rows_with_donor, window_means

# Pixels from which roughness and metallic are estimated; more change only the time.
PROJECTION_PIXELS = 600_000
# Groups with fewer pure pixels use their mixed ones too.
FEW_PIXELS = 30
# About so many pixels of larger groups determine roughness and metallic; fewer if those of all groups would
# exceed `PROJECTION_PIXELS`.
GROUP_PIXELS = 50_000
# Steps of a Kronecker sequence along three axes and the sides: powers of the root of x^5 = x + 1.
KRONECKER = 1.1673039782614187 ** -np.arange(1.0, 5.0)
# Width, in voxels of the radiance cache, of the cells of constant base colour from which roughness and
# metallic are estimated: a voxel holds two or three pixels of the test rooms, too few to separate gloss from
# base colour.
WIDE_CELL = 2
# Step of the normals by which the pixels of a voxel are divided: the same light falls on those within one.
NORMAL_STEP = 0.2


def training_input(
    observations: Observations,
    shadings: ShadingStore,
    settings: MaterialSettings,
    hints: SurfaceHints,
) -> TrainingData:
    """The pixels with their shadings, groups and the materials of these.

    Args:
        hints: what the artist knows; the parts of the observations are divided by them.
        shadings: of all pixels.
    """
    group, places = observations.part, None
    groups = int(observations.parts.triangle_part.max(initial=-1)) + 1
    if observations.parts.kind != "part":
        group, places = _group_pixels(observations, shadings, hints)
        groups = places.shape[1]
    known = hints.known(groups_of_hints(hints, observations.parts, groups), groups)
    start = np.random.default_rng([settings.seed, 5]).random()
    wide_rows, wide_cell = _wide_rows(observations, group, groups, start)
    wide = _wide_samples(observations, shadings, group, wide_rows, wide_cell)
    light = _light_cells(observations, wide.rows)
    materials = infer_materials(wide, groups, light, settings, places, known)
    return TrainingData(observations, shadings, group, materials)


def groups_of_hints(hints: SurfaceHints, parts: Parts, groups: int) -> np.ndarray:
    """(H,) int group of each hint among so many, -1 for none: its part; else the hints' are the last ones."""
    if parts.kind == "part":
        return values_of_hints(hints, parts.triangle_part)
    return groups - len(hints.names) + np.arange(len(hints.names))


def hinted_units(units: Units, parts: Parts, hints: SurfaceHints, materials: GroupMaterials) -> Units:
    """Units divided by hints, with the values of those of which the hints know something.

    Args:
        units: without the hints on triangles of their own, where parts are not known.
        parts: divided by the hints.
        materials: of the groups.
    """
    triangle, single = units.triangle, units.single
    if parts.kind != "part":
        triangle = hints.split(triangle, len(single))
        single = np.append(single, np.ones(int(hints.own.sum()), bool))
    group = groups_of_hints(hints, parts, len(materials.mean))
    fixed = np.full((len(single), 2), np.nan, np.float32)
    unit = values_of_hints(hints, triangle)
    chosen = (unit >= 0) & (group >= 0) & hints.about_material & ~hints.left_alone
    fixed[unit[chosen]] = materials.mean[group[chosen]]
    return Units(triangle, single, fixed)


def material_units(data: TrainingData) -> Units:
    """Units of the mesh by the groups of :func:`training_input`."""
    pixels, parts = data.observations.pixels, data.observations.parts
    if parts.kind == "part":
        return Units(parts.triangle_part, np.ones(len(data.materials.mean), bool))
    views = [pixels.rows(view) for view in range(len(pixels.views))]
    ids = (data.group[rows] + 1 for rows in views)  # 0 stands for none
    votes = count_votes(ids, (np.asarray(pixels.triangle[rows]) for rows in views))
    votes = replace(votes, label=votes.label - 1)
    return group_units(parts, data.observations.surface, votes, data.materials.mean)


def _group_pixels(
    observations: Observations, shadings: ShadingStore, hints: SurfaceHints
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int32 group of each pixel with a donor, NO_GROUP for the others; memory-mapped.

    And (2, groups) the places of :func:`.infer_materials`.

    Base colours of cells are those of their pixels, taken as diffuse. Of more than `MAX_GROUPS` regions the
    smallest are no groups. The pixels of a hint are a group of their own, numbered after the others.
    """
    pixels, label = observations.pixels, observations.parts.triangle_part
    # One more row, at -1, for pixels that miss the mesh.
    surface = np.append(observations.surface, np.int32(NO_GROUP))
    group = open_array(observations.folder / "group.npy", (len(pixels),), np.int32, create=True)
    views = [pixels.rows(view) for view in range(len(pixels.views))]
    for rows in views:
        group[rows] = surface[np.maximum(pixels.triangle[rows], -1)]
    diffuse = np.tile(np.array([1.0, 0.0], np.float32), (int(surface.max()) + 1, 1))
    data = TrainingData(observations, shadings, group, GroupMaterials(diffuse, np.zeros_like(diffuse)))
    cells, grid = fit_cells(data), observations.grid
    voxel = np.stack(np.unravel_index(grid.voxels[cells.entry // SIDES], (grid.resolution,) * 3), axis=1)
    cube = voxel // np.ceil(CELL_PIXELS * observations.footprint / grid.size).astype(np.int64)
    wide = numbered([cells.group, *cube.T, cells.entry % SIDES])
    count = np.bincount(wide, cells.pixels)
    color = grouped_sums(cells.pixels[:, None] * cells.color, wide) / count[:, None]
    first = np.unique(wide, return_index=True)[1]
    region = join_cells(color, count, neighbours(cells.group[first], cube[first]))
    size = np.bincount(region, count)
    kept = np.argsort(-size, kind="stable")[:MAX_GROUPS]
    number = np.full(len(size) + 1, NO_GROUP, np.int32)
    number[kept] = np.arange(len(kept), dtype=np.int32)
    of_cell = np.append(number[region[wide]], np.int32(NO_GROUP))
    for view, rows in enumerate(views):
        known = rows_with_donor(observations, view)
        found = of_cell[cells.of_pixels(data, known)]
        hinted = hints.triangle[pixels.triangle[known]]
        group[rows] = NO_GROUP
        group[known] = np.where(hinted >= 0, len(kept) + hinted, found)
    class_of_surface = np.zeros(len(diffuse), np.int64)
    class_of_surface[observations.surface] = label
    of_region = cells.group[first][np.unique(region, return_index=True)[1][kept]]
    places = np.stack([class_of_surface[of_region], of_region])
    own = len(diffuse) + np.arange(len(hints.names))  # each hint is a surface of its own
    return group, np.append(places, [values_of_hints(hints, label), own], axis=1)


def _wide_rows(
    observations: Observations, group: np.ndarray, groups: int, start: float
) -> tuple[np.ndarray, np.ndarray]:
    """(M,) int64 pixels that determine roughness and metallic, and (M,) int64 their wide cells from 0.

    These are the pixels with a group that are their own donor, pure ones where there are enough. Of groups of
    more than about `GROUP_PIXELS`, complete cells are drawn.

    Args:
        group: (N,) int of all pixels, of `groups`, negative for none.
        start: in [0, 1), a random number for :func:`drawn`.
    """
    pixels = observations.pixels
    views = range(len(pixels.views))

    def known(view: int) -> np.ndarray:
        rows = rows_with_donor(observations, view)
        return rows[(observations.donor[rows] == rows) & (group[rows] >= 0)]

    count = np.zeros((2, groups), np.int64)
    for rows in map(known, views):
        for total, some in zip(count, (rows, rows[np.asarray(pixels.pure[rows])]), strict=True):
            total += np.bincount(group[some], minlength=groups)
    few = count[1] < FEW_PIXELS
    usable = np.where(few, count[0], count[1])
    share = max_of_each(usable) / np.maximum(usable, 1)
    edge = WIDE_CELL * float(observations.grid.size.max())
    found = []
    for rows in map(known, views):
        rows = rows[np.asarray(pixels.pure[rows]) | few[group[rows]]]
        cube = np.floor((pixels.position[rows] - observations.grid.low) / edge).astype(np.int64)
        cell = np.column_stack([cube, np.asarray(observations.entry[rows], np.int64) % SIDES])
        kept = drawn(cell, start) < share[group[rows]]
        found.append(np.column_stack([rows, cell])[kept])
    rows, *cells = np.concatenate(found).T
    return rows, numbered(cells)


def _wide_samples(
    observations: Observations,
    shadings: ShadingStore,
    group: np.ndarray,
    rows: np.ndarray,
    cell: np.ndarray,
) -> PixelSamples:
    """The pixels `rows` (M,) in the wide cells `cell` (M,), as means over small windows; `group`: (N,)."""
    pixels = observations.pixels
    arrays = (pixels.own, shadings.diffuse, shadings.specular)
    widths = np.array([view.width for view in pixels.views])
    pure = np.asarray(pixels.pure)
    radiance, diffuse, specular = window_means(arrays, rows, pure, group, pixels.ranges, widths)
    view, weight = pixels.view_of(rows), np.asarray(pixels.weight[rows])
    columns = radiance, diffuse, specular, shadings.levels, cell, group[rows], view, weight
    return PixelSamples(rows, *columns)


def max_of_each(count: np.ndarray) -> float:
    """The number of pixels up to which each group is used, of which it has so many (G,).

    It is the largest up to `GROUP_PIXELS` with which all together use at most `PROJECTION_PIXELS`.
    """
    ascending = np.sort(count)
    before = np.cumsum(ascending) - ascending
    limits = (PROJECTION_PIXELS - before) / np.arange(len(count), 0, -1)
    exceeded = ascending > limits
    return float(min(GROUP_PIXELS, limits[exceeded][0])) if exceeded.any() else float(GROUP_PIXELS)


def drawn(cell: np.ndarray, start: float) -> np.ndarray:
    """(N,) numbers in [0, 1), one for each cell (N, D) of int coordinates, spread evenly over any region.

    Steps along the axes are those of a Kronecker sequence, whose points fill the unit interval evenly. Random
    numbers would fill it by chance, and the estimate would depend on the seed.

    Args:
        start: the number of the cell at the origin.
    """
    return (start + cell @ KRONECKER[: cell.shape[1]]) % 1.0


def _light_cells(observations: Observations, rows: np.ndarray) -> np.ndarray:
    """(M,) int64 from 0, the cache entry and the slope that each pixel sees: the same light falls on one."""
    slope = np.round(observations.pixels.normal[rows] / NORMAL_STEP).astype(np.int64)
    return numbered([*slope.T, np.asarray(observations.entry[rows], np.int64)])
