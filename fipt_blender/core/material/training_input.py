# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The input of stage 2: the pixels to train on, and the closed-form estimate at a sample of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..light.baking import ShadingStore
from ..light.cache import SIDES
from ..light.observations import Observations
from ..optics.factorised import color_line
from ..run.settings import Settings
from ..scene.grouped import grouped_sums, numbered, summed_by_key
from ..scene.labels import Parts
from ..scene.pixels import PixelStore, open_array
from .groups import (
    LEAST_PIXELS,
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
from .mixture import infer_materials
from .pixel_samples import RADIANCE_FLOOR, PixelSamples, read_samples, rows_with_donor, window_means
from .projection import InitialEstimate, project
from .training import TrainingData

# Pixels of which base colours are estimated; more change only the time.
PROJECTION_PIXELS = 600_000
# Groups with fewer pure pixels use their mixed ones too.
FEW_PIXELS = 30
# About so many pixels of larger groups determine roughness and metallic; fewer if those of all groups would
# exceed `PROJECTION_PIXELS`.
GROUP_PIXELS = 50_000
# Steps of a Kronecker sequence along three axes and the sides: powers of the root of x^5 = x + 1.
KRONECKER = 1.1673039782614187 ** -np.arange(1.0, 5.0)
# Width, in voxels of the radiance cache, of the cells of constant base colour from which roughness and
# metallic are estimated: a voxel holds two or three pixels of the test rooms, too few to tell gloss from base
# colour.
WIDE_CELL = 2
# Step of the normals by which the pixels of a voxel are divided: the same light falls on those within one.
NORMAL_STEP = 0.2


def training_input(
    observations: Observations,
    pieces: np.ndarray | None,
    shadings: ShadingStore,
    levels: np.ndarray,
    normalise: Callable[[np.ndarray], np.ndarray],
    settings: Settings,
    hints: SurfaceHints | None = None,
) -> tuple[TrainingData, InitialEstimate]:
    """The data to train on, and the closed-form estimate at a sample of its pixels.

    Args:
        pieces: (T,) int connected piece of each triangle; None where parts are known.
        hints: what the artist knows; the parts of the observations are divided by them.
        shadings: of all pixels at the roughness `levels` (K,).
        normalise: maps world positions to the unit cube.
    """
    pixels = observations.pixels
    rows = _sample_rows(pixels, observations.donor, np.random.default_rng([settings.seed, 2]))
    group, color = observations.part, np.zeros((0, 3))
    groups = int(observations.parts.triangle_part.max(initial=-1)) + 1
    if pieces is not None:
        color = _diffuse_colors(observations, shadings)
        group, groups = _assign_groups(observations, pieces, color, None if hints is None else hints.triangle)
    known = None
    if hints is not None:
        groups += 0 if pieces is None else len(hints.names)
        known = hints.known(groups_of_hints(hints, observations.parts, groups), groups)
    start = np.random.default_rng([settings.seed, 5]).random()
    wide_rows, wide_cell = _wide_rows(observations, group, groups, start)
    wide = _wide_samples(observations, shadings, levels, group, wide_rows, wide_cell)
    alike = None
    if pieces is not None:
        label, seen_color = observations.part[wide.rows], color[observations.entry[wide.rows]]
        alike = _similarity(wide.group, groups, label, seen_color)
    materials = infer_materials(wide, groups, _light_cells(observations, wide.rows), settings, alike, known)
    roughness, metallic = materials.mean.T
    cell = np.asarray(observations.entry[rows], np.int64)
    samples = read_samples(pixels, shadings, levels, rows, cell, group[rows])
    estimate = project(samples, roughness, metallic, known_parts=pieces is None)
    data = TrainingData(
        pool=observations.pool,
        donor=observations.donor,
        position=pixels.position,
        radiance=pixels.own,
        label=observations.part,
        group=group,
        diffuse=shadings.diffuse,
        specular=shadings.specular,
        levels=levels,
        semantic=observations.parts.kind == "semantic",
        group_roughness=roughness,
        group_metallic=metallic,
        group_errors=materials.error,
        normalise=normalise,
    )
    return data, estimate


def groups_of_hints(hints: SurfaceHints, parts: Parts, groups: int) -> np.ndarray:
    """(H,) int group of each hint among so many, -1 for none: its part; else the hints' are the last ones."""
    if parts.kind == "part":
        return values_of_hints(hints, parts.triangle_part)
    return groups - len(hints.names) + np.arange(len(hints.names))


def hinted_units(
    units: Units, parts: Parts, hints: SurfaceHints, roughness: np.ndarray, metallic: np.ndarray
) -> Units:
    """Units divided by hints, with the values of those of which the hints know something.

    Args:
        units: without the hints on triangles of their own, where parts are not known.
        parts: divided by the hints.
        roughness, metallic: (G,) of the groups.
    """
    triangle, single = units.triangle, units.single
    if parts.kind != "part":
        triangle = hints.split(triangle, len(single))
        single = np.append(single, np.ones(int(hints.own.sum()), bool))
    group = groups_of_hints(hints, parts, len(roughness))
    fixed = np.full((len(single), 2), np.nan, np.float32)
    unit = values_of_hints(hints, triangle)
    chosen = (unit >= 0) & (group >= 0) & hints.about_material & ~hints.left_alone
    fixed[unit[chosen], 0], fixed[unit[chosen], 1] = roughness[group[chosen]], metallic[group[chosen]]
    return Units(triangle, single, fixed)


def material_units(observations: Observations, pieces: np.ndarray | None, data: TrainingData) -> Units:
    """Units of the mesh by the groups of :func:`training_input`; `pieces` as there."""
    if pieces is None:
        return part_units(observations.parts)
    pixels, groups = observations.pixels, len(data.group_roughness)

    def views() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for view in range(len(pixels.views)):
            rows = rows_with_donor(pixels, data.donor, view)
            key = pixels.triangle[rows] * np.int64(groups + 1) + data.group[rows] + 1
            yield key, np.ones(len(key))

    keys, count = summed_by_key(views())
    triangle, group = np.divmod(keys, groups + 1)
    return piece_units(
        observations.parts, pieces, triangle, group - 1, count, data.group_roughness, data.group_metallic
    )


def _sample_rows(pixels: PixelStore, donor: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(M,) int64 pixels that are their own donor: all, or a random sample of about PROJECTION_PIXELS."""
    views = range(len(pixels.views))
    share = PROJECTION_PIXELS / max(sum(len(_own_donors(pixels, donor, view)) for view in views), 1)
    found = (_own_donors(pixels, donor, view) for view in views)
    return np.concatenate([rows if share >= 1.0 else rows[rng.random(len(rows)) < share] for rows in found])


def _own_donors(pixels: PixelStore, donor: np.ndarray, view: int) -> np.ndarray:
    """(n,) int64 pixels of a view that are their own donor."""
    rows = pixels.rows(view)
    return np.flatnonzero(donor[rows] == np.arange(rows.start, rows.stop)) + rows.start


def _diffuse_colors(observations: Observations, shadings: ShadingStore) -> np.ndarray:
    """(M * 6, 3) least-squares base colour of each cache entry from all its pixels, taken as diffuse."""
    pixels, entries = observations.pixels, len(observations.grid.voxels) * SIDES
    top, bottom = np.zeros((entries, 3)), np.zeros((entries, 3))
    for view in range(len(pixels.views)):
        rows = rows_with_donor(pixels, observations.donor, view)
        radiance, diffuse, roughest = (
            np.asarray(array, np.float32)
            for array in (pixels.own[rows], shadings.diffuse[rows], shadings.specular[rows, -1])
        )
        slope, offset = color_line(diffuse, roughest[:, 0], roughest[:, 1], 0.0)
        weight = slope * pixels.weight[rows, None] / (radiance + RADIANCE_FLOOR) ** 2
        used, place = np.unique(observations.entry[rows], return_inverse=True)
        for total, values in ((top, weight * (radiance - offset)), (bottom, weight * slope)):
            total[used] += grouped_sums(values, place)
    return np.clip(top / np.maximum(bottom, 1e-12), 0.0, 1.0)


def _assign_groups(
    observations: Observations, pieces: np.ndarray, color: np.ndarray, hint: np.ndarray | None
) -> tuple[np.ndarray, int]:
    """(N,) int32 group of each pixel with a donor, NO_GROUP for the others; memory-mapped. And their number.

    Only the combinations of label, piece and colour are counted, which are few, not the pixels. The pixels of
    a hint are a group of their own, numbered after the others.

    Args:
        color: (M * 6, 3) base colour of each cache entry.
        hint: (T,) int hint of each triangle, negative for none; None without hints.
    """
    pixels = observations.pixels
    of_triangle = np.full(len(pieces), NO_HINT) if hint is None else hint
    classes, class_of_entry = np.unique(color_class(color), return_inverse=True)
    shape = (
        int(observations.parts.triangle_part.max(initial=-1)) + 2,
        int(pieces.max(initial=0)) + 1,
        len(classes),
    )

    def combinations(view: int) -> tuple[np.ndarray, np.ndarray]:
        """Pixels of a view with a donor and no hint, and a key for the label, piece and colour of each."""
        rows = rows_with_donor(pixels, observations.donor, view)
        rows = rows[of_triangle[pixels.triangle[rows]] < 0]
        columns = (
            observations.part[rows] + 1,
            pieces[pixels.triangle[rows]],
            class_of_entry[observations.entry[rows]],
        )
        return rows, np.ravel_multi_index(columns, shape)

    every = (combinations(view)[1] for view in range(len(pixels.views)))
    keys, count = summed_by_key((key, np.ones(len(key))) for key in every)
    label_of_key, piece, color_of_key = np.unravel_index(keys, shape)
    least = max(LEAST_PIXELS, int(count.sum()) // MOST_GROUPS)
    group_of_key = material_groups(label_of_key, piece, color_of_key, count, least)
    groups = int(group_of_key.max(initial=NO_GROUP)) + 1
    group = open_array(observations.folder / "group.npy", (len(pixels),), np.int32, create=True)
    for view in range(len(pixels.views)):
        of_view = np.full(pixels.views[view].height * pixels.views[view].width, NO_GROUP, np.int32)
        rows, key = combinations(view)
        of_view[rows - pixels.ranges[view]] = group_of_key[np.searchsorted(keys, key)]
        if hint is not None:
            rows = rows_with_donor(pixels, observations.donor, view)
            rows = rows[hint[pixels.triangle[rows]] >= 0]
            of_view[rows - pixels.ranges[view]] = groups + hint[pixels.triangle[rows]]
        group[pixels.rows(view)] = of_view
    return group, groups


def _similarity(group: np.ndarray, groups: int, label: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(G, G) similarity of the groups of pixels (M,) with classes (M,) and base colours (M, 3)."""
    count = np.maximum(np.bincount(group, minlength=groups), 1)
    label_of_group = np.zeros(len(count), np.int64)
    label_of_group[group] = label
    return similarity(label_of_group, grouped_sums(color, group, groups) / count[:, None])


def _wide_rows(
    observations: Observations, group: np.ndarray, groups: int, start: float
) -> tuple[np.ndarray, np.ndarray]:
    """(M,) int64 pixels that tell roughness and metallic, and (M,) int64 their wide cells from 0.

    These are the pixels with a group that are their own donor, pure ones where there are enough. Of groups of
    more than about `GROUP_PIXELS`, complete cells are drawn.

    Args:
        group: (N,) int of all pixels, of `groups`, negative for none.
        start: in [0, 1), a random number for :func:`drawn`.
    """
    pixels, donor = observations.pixels, observations.donor
    views = range(len(pixels.views))

    def known(view: int) -> np.ndarray:
        rows = _own_donors(pixels, donor, view)
        return rows[group[rows] >= 0]

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
