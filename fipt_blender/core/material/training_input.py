# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The input of stage 2: the pixels with their groups, and the materials of the groups."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..light.baking import ShadingStore
from ..light.cache import SIDES
from ..light.observations import Observations
from ..parts.labels import Parts
from ..pixels.grouped import grouped_means, numbered, summed_by_key
from ..pixels.store import open_array
from ..run.stage_settings import MaterialSettings
from .closed_form import TrainingData, fit_cells
from .groups import (
    MOST_GROUPS,
    NO_GROUP,
    Units,
    color_class,
    material_groups,
    part_units,
    piece_units,
    similarity,
)
from .hints import NO_HINT, SurfaceHints, values_of_hints
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
    pieces: np.ndarray | None,
    shadings: ShadingStore,
    levels: np.ndarray,
    settings: MaterialSettings,
    hints: SurfaceHints | None = None,
) -> TrainingData:
    """The pixels with their shadings, groups and the materials of these.

    Args:
        pieces: (T,) int connected piece of each triangle; None where parts are known.
        hints: what the artist knows; the parts of the observations are divided by them.
        shadings: of all pixels at the roughness `levels` (K,).
    """
    group, color = observations.part, np.zeros((0, 3))
    groups = int(observations.parts.triangle_part.max(initial=-1)) + 1
    if pieces is not None:
        color = _diffuse_colors(observations, shadings, levels)
        group, groups = _assign_groups(observations, pieces, color, hints)
    known = None
    if hints is not None:
        known = hints.known(groups_of_hints(hints, observations.parts, groups), groups)
    start = np.random.default_rng([settings.seed, 5]).random()
    wide_rows, wide_cell = _wide_rows(observations, group, groups, start)
    wide = _wide_samples(observations, shadings, levels, group, wide_rows, wide_cell)
    alike = None
    if pieces is not None:
        label, seen_color = observations.part[wide.rows], color[observations.entry[wide.rows]]
        alike = _similarity(wide.group, groups, label, seen_color)
    light = _light_cells(observations, wide.rows)
    materials = infer_materials(wide, groups, light, settings, alike, known)
    return TrainingData(observations, shadings, levels, group, materials)


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


def material_units(pieces: np.ndarray | None, data: TrainingData, scan: bool) -> Units:
    """Units of the mesh by the groups of :func:`training_input`; `pieces` as there.

    Pieces of a scan are not divided: the pixels of what it lacks spoil its triangles.
    """
    observations, groups = data.observations, len(data.materials.mean)
    if pieces is None:
        return part_units(observations.parts)

    def views() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for view in range(len(observations.pixels.views)):
            rows = rows_with_donor(observations, view)
            key = observations.pixels.triangle[rows] * np.int64(groups + 1) + data.group[rows] + 1
            yield key, np.ones(len(key))

    keys, count = summed_by_key(views())
    triangle, group = np.divmod(keys, groups + 1)
    materials = data.materials.of_pixels
    return piece_units(observations.parts, pieces, triangle, group - 1, count, materials, divided=not scan)


def _diffuse_colors(observations: Observations, shadings: ShadingStore, levels: np.ndarray) -> np.ndarray:
    """(M * 6, 3) base colour of each cache entry from all its pixels, taken as diffuse; 0 without any."""
    none = np.zeros((0, 2), np.float32)
    group = np.broadcast_to(np.int32(NO_GROUP), len(observations.pixels))
    data = TrainingData(observations, shadings, levels, group, GroupMaterials(none, none))
    cells = fit_cells(data)
    color = np.zeros((len(observations.grid.voxels) * SIDES, 3), np.float32)
    color[cells.entry] = cells.color
    return color


def _assign_groups(
    observations: Observations, pieces: np.ndarray, color: np.ndarray, hints: SurfaceHints | None
) -> tuple[np.ndarray, int]:
    """(N,) int32 group of each pixel with a donor, NO_GROUP for the others; memory-mapped. And their number.

    Only the combinations of label, piece and colour are counted, which are few, not the pixels. The pixels of
    a hint are a group of their own, numbered after the others.

    Args:
        color: (M * 6, 3) base colour of each cache entry.
    """
    pixels = observations.pixels
    hint = np.full(len(pieces), NO_HINT) if hints is None else hints.triangle
    classes, class_of_entry = np.unique(color_class(color), return_inverse=True)
    shape = (
        int(observations.parts.triangle_part.max(initial=-1)) + 2,
        int(pieces.max(initial=0)) + 1,
        len(classes),
    )

    def combinations(view: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels of a view with a donor: those of hints, the others, and label, piece, colour as a key."""
        rows = rows_with_donor(observations, view)
        hinted = hint[pixels.triangle[rows]] >= 0
        rows, of_hints = rows[~hinted], rows[hinted]
        columns = (
            observations.part[rows] + 1,
            pieces[pixels.triangle[rows]],
            class_of_entry[observations.entry[rows]],
        )
        return of_hints, rows, np.ravel_multi_index(columns, shape)

    every = (combinations(view)[2] for view in range(len(pixels.views)))
    keys, count = summed_by_key((key, np.ones(len(key))) for key in every)
    label_of_key, piece, color_of_key = np.unravel_index(keys, shape)
    least = max(FEW_PIXELS, int(count.sum()) // MOST_GROUPS)
    group_of_key = material_groups(label_of_key, piece, color_of_key, count, least)
    groups = int(group_of_key.max(initial=NO_GROUP)) + 1
    group = open_array(observations.folder / "group.npy", (len(pixels),), np.int32, create=True)
    for view in range(len(pixels.views)):
        of_hints, rows, key = combinations(view)
        group[pixels.rows(view)] = NO_GROUP
        group[rows] = group_of_key[np.searchsorted(keys, key)]
        group[of_hints] = groups + hint[pixels.triangle[of_hints]]
    return group, groups + (0 if hints is None else len(hints.names))


def _similarity(group: np.ndarray, groups: int, label: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(G, G) similarity of the groups of pixels (M,) with classes (M,) and base colours (M, 3)."""
    means = np.nan_to_num(grouped_means(color, group, groups))
    label_of_group = np.zeros(len(means), np.int64)
    label_of_group[group] = label
    return similarity(label_of_group, means)


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
    share = most_of_each(usable) / np.maximum(usable, 1)
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
    levels: np.ndarray,
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
    return PixelSamples(rows, radiance, diffuse, specular, levels, cell, group[rows], view, weight)


def most_of_each(count: np.ndarray) -> float:
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
