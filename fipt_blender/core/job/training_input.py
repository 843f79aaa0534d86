# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What stage 2 starts from: the pixels to train on, and the closed-form guess at some of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..light.cache import SIDES
from ..light.observations import Observations
from ..light.views import ShadingStore
from ..material.gloss import part_materials
from ..material.groups import (
    LEAST_PIXELS,
    MOST_GROUPS,
    NO_GROUP,
    Units,
    color_class,
    kinship,
    material_groups,
    numbered,
    part_units,
    piece_units,
)
from ..material.projection import DARK, Guess, line, project, window_means
from ..material.training import TrainingData
from ..scene.labels import Parts
from ..scene.pixels import PixelStore, open_array

# Pixels that the closed-form start looks at; more change nothing but its time.
PROJECTION_PIXELS = 600_000
# Parts with fewer pixels that see nothing else are judged by their mixed ones too.
FEW_PIXELS = 30
# Of larger parts about so many tell roughness and metallic.
PART_PIXELS = 20_000
# Width of the cells of even base colour by which roughness and metallic are told, in voxels of the radiance
# cache: those hold two or three pixels of the test rooms, too few to tell gloss from base colour.
WIDE_CELL = 2
# Pixels of a voxel whose normals lie in one cube of this edge get the same light.
SLOPE = 0.2


def training_input(
    pixels: PixelStore,
    seen: Observations,
    parts: Parts,
    pieces: np.ndarray | None,
    shadings: ShadingStore,
    levels: np.ndarray,
    normalise: Callable[[np.ndarray], np.ndarray],
    seed: int,
) -> tuple[TrainingData, Guess, np.ndarray]:
    """What training draws from, with the closed-form guess at some of its pixels and those pixels' rows.

    Args:
        pieces: (T,) int connected piece of each triangle; None where parts are known.
        shadings: of all pixels at the roughness `levels`.
        normalise: world positions to the unit cube.
    """
    rows = _own_rows(pixels, seen.donor, np.random.default_rng([seed, 2]))
    widths = np.array([each.width for each in pixels.views])
    arrays = (pixels.radiance, shadings.diffuse, shadings.specular)
    radiance, diffuse, specular = (np.asarray(array[rows], np.float32) for array in arrays)
    cell = np.asarray(seen.entry[rows], np.int64)
    whole = pieces is None
    group, color = seen.part, np.zeros((0, 3))
    if pieces is not None:
        color = _flat_colors(pixels, seen, shadings)
        group = _groups(pixels, seen, pieces, color)
    pure = np.asarray(pixels.pure)
    of = rows[_clean_rows(pure[rows], group[rows])]
    wide = _wide_cells(pixels, seen, of)
    some = _some_of_each(group[of], wide, np.random.default_rng([seed, 5]))
    of, wide = of[some], wide[some]
    means = window_means(arrays, of, pure, group, pixels.ranges, widths)
    spots, views = _spots(pixels, seen, of), pixels.view_of(of)
    kin = None if whole else _kinship(group[of], seen.part[of], color[seen.entry[of]])
    roughness, metallic = part_materials(
        means[0], means[1], means[2], levels, wide, spots, group[of], views, kin
    )
    guess = project(radiance, diffuse, specular, levels, cell, group[rows], roughness, metallic, whole)
    # Parts that none of these rows saw are diffuse.
    missing = max(int(group.max(initial=-1)) + 1 - len(roughness), 0)
    data = TrainingData(
        pool=seen.pool,
        donor=seen.donor,
        position=pixels.position,
        radiance=pixels.radiance,
        label=seen.part,
        group=group,
        diffuse=shadings.diffuse,
        specular=shadings.specular,
        levels=levels,
        semantic=parts.kind == "semantic",
        group_roughness=np.pad(roughness, (0, missing), constant_values=1.0),
        group_metallic=np.pad(metallic, (0, missing)),
        normalise=normalise,
    )
    return data, guess, rows


def material_units(pixels: PixelStore, parts: Parts, pieces: np.ndarray | None, data: TrainingData) -> Units:
    """What of the mesh is of one material; arguments as in :func:`training_input`, and what that returns."""
    if pieces is None:
        return part_units(parts)
    groups = len(data.group_roughness)
    known, number = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for index in range(len(pixels.views)):
        used = _used_rows(pixels, data.donor, index)
        kind = pixels.triangle[used] * np.int64(groups + 1) + data.group[used] + 1
        known, number = _counted(known, number, kind)
    triangle, group = np.divmod(known, groups + 1)
    return piece_units(parts, pieces, triangle, group - 1, number, data.group_roughness, data.group_metallic)


def _counted(known: np.ndarray, number: np.ndarray, more: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K,) values, rising, and how often each was found, with more of them (n,) counted in."""
    values, counts = np.unique(more, return_counts=True)
    known, place = np.unique(np.concatenate([known, values]), return_inverse=True)
    return known, np.bincount(place, np.concatenate([number, counts])).astype(np.int64)


def _own_rows(pixels: PixelStore, donor: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(M,) int64 pixels that stand for themselves: all, or about PROJECTION_PIXELS of them."""

    def own(index: int) -> np.ndarray:
        rows = pixels.rows(index)
        return np.flatnonzero(donor[rows] == np.arange(rows.start, rows.stop)) + rows.start

    views = range(len(pixels.views))
    share = PROJECTION_PIXELS / max(sum(len(own(index)) for index in views), 1)
    found = [rows if share >= 1.0 else rows[rng.random(len(rows)) < share] for rows in map(own, views)]
    return np.concatenate(found)


def _flat_colors(pixels: PixelStore, seen: Observations, shadings: ShadingStore) -> np.ndarray:
    """(M * 6, 3) base colour of each cache entry by all its pixels, taken as diffuse."""
    entries = len(seen.grid.voxels) * SIDES
    top, bottom = np.zeros((entries, 3)), np.zeros((entries, 3))
    for index in range(len(pixels.views)):
        used = _used_rows(pixels, seen.donor, index)
        radiance, diffuse, roughest = (
            np.asarray(array, np.float32)
            for array in (pixels.radiance[used], shadings.diffuse[used], shadings.specular[used, -1])
        )
        slope, offset = line(diffuse, roughest, 0.0)
        weight = slope / (radiance + DARK) ** 2
        found, place = np.unique(seen.entry[used], return_inverse=True)
        for total, values in ((top, weight * (radiance - offset)), (bottom, weight * slope)):
            total[found] += np.stack([np.bincount(place, column) for column in values.T], axis=1)
    return np.clip(top / np.maximum(bottom, 1e-12), 0.0, 1.0)


def _used_rows(pixels: PixelStore, donor: np.ndarray, index: int) -> np.ndarray:
    """(n,) int64 pixels of a view that some pixel stands for."""
    rows = pixels.rows(index)
    return np.flatnonzero(donor[rows] >= 0) + rows.start


def _groups(pixels: PixelStore, seen: Observations, pieces: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(N,) int32 group of each pixel that stands for its part, NO_GROUP for those that none stands for.

    Memory-mapped; what is counted are kinds of pixels, which are few.

    Args:
        color: (M * 6, 3) base colour of each cache entry.
    """
    classes, of_cell = np.unique(color_class(color), return_inverse=True)
    shape = (int(seen.parts.triangle_part.max(initial=-1)) + 2, int(pieces.max(initial=0)) + 1, len(classes))

    def kinds(index: int) -> tuple[np.ndarray, np.ndarray]:
        """Pixels of a view that some pixel stands for, and a number for label, piece and colour of each."""
        used = _used_rows(pixels, seen.donor, index)
        columns = (seen.part[used] + 1, pieces[pixels.triangle[used]], of_cell[seen.entry[used]])
        return used, np.ravel_multi_index(columns, shape)

    known, number = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for index in range(len(pixels.views)):
        known, number = _counted(known, number, kinds(index)[1])
    label, piece, color_of = np.unravel_index(known, shape)
    least = max(LEAST_PIXELS, int(number.sum()) // MOST_GROUPS)
    of_kind = material_groups(label, piece, color_of, number, least)
    group = open_array(seen.folder / "group.npy", (len(pixels),), np.int32, create=True)
    for index in range(len(pixels.views)):
        own = np.full(pixels.views[index].height * pixels.views[index].width, NO_GROUP, np.int32)
        used, kind = kinds(index)
        own[used - pixels.ranges[index]] = of_kind[np.searchsorted(known, kind)]
        group[pixels.rows(index)] = own
    return group


def _kinship(group: np.ndarray, label: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(G, G) kinship of the groups of some pixels (M,), with their classes (M,) and base colours (M, 3)."""
    count = np.maximum(np.bincount(group), 1)
    label_of = np.zeros(len(count), np.int64)
    label_of[group] = label
    return kinship(label_of, np.stack([np.bincount(group, column) / count for column in color.T], axis=1))


def _wide_cells(pixels: PixelStore, seen: Observations, rows: np.ndarray) -> np.ndarray:
    """(M,) int64 from 0, a cube of `WIDE_CELL` voxels and the side of it that each pixel sees."""
    edge = WIDE_CELL * float(seen.grid.size.max())
    cube = np.floor((pixels.position[rows] - seen.grid.low) / edge).astype(np.int64)
    return numbered([*cube.T, np.asarray(seen.entry[rows], np.int64) % SIDES])


def _spots(pixels: PixelStore, seen: Observations, rows: np.ndarray) -> np.ndarray:
    """(M,) int64 from 0, a voxel's side and the slope that each pixel sees."""
    slope = np.round(pixels.normal[rows] / SLOPE).astype(np.int64)
    return numbered([*slope.T, np.asarray(seen.entry[rows], np.int64)])


def _some_of_each(part: np.ndarray, cell: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(M,) bool, all pixels of parts that have up to `PART_PIXELS`, of others those of enough whole cells."""
    share = PART_PIXELS / np.maximum(np.bincount(part), 1)
    drawn = rng.random(int(cell.max(initial=-1)) + 1)
    return drawn[cell] < share[part]


def _clean_rows(pure: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(M,) bool, pixels that see one surface, and all pixels of parts that have hardly any of these.

    Args:
        pure: (M,) bool; part: (M,) int, negative without.
    """
    known = part >= 0
    count = np.bincount(part[known & pure], minlength=int(part.max(initial=0)) + 1)
    return known & (pure | (count[np.maximum(part, 0)] < FEW_PIXELS))
