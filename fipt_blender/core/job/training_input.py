# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What stage 2 starts from: the pixels to train on, and the closed-form guess at some of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..light.observations import Observations
from ..light.views import ShadingStore
from ..material.groups import LEAST_PIXELS, NO_GROUP, color_class, material_groups
from ..material.projection import Guess, part_materials, project, window_means
from ..material.training import TrainingData
from ..scene.labels import Parts
from ..scene.pixels import PixelStore

# Pixels that the closed-form start looks at; more change nothing but its time.
PROJECTION_PIXELS = 600_000
# Parts with fewer pixels that see nothing else are judged by their mixed ones too.
FEW_PIXELS = 30


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
    donors = seen.donor
    pool_rows = np.flatnonzero(donors >= 0)
    rows = pool_rows[donors[pool_rows] == pool_rows]
    if len(rows) > PROJECTION_PIXELS:
        rng = np.random.default_rng([seed, 2])
        rows = np.sort(rng.choice(rows, PROJECTION_PIXELS, replace=False))
    view = pixels.view_of(np.arange(len(pixels)))
    widths = np.array([each.width for each in pixels.views])
    arrays = (pixels.radiance, shadings.diffuse, shadings.specular)
    radiance, diffuse, specular = (np.asarray(array[rows], np.float32) for array in arrays)
    cell = np.asarray(seen.entry[rows], np.int64)
    whole = pieces is None
    group = seen.part
    if pieces is not None:
        unknown = np.full(len(rows), -1, np.int32)
        nothing = np.zeros(0, np.float32)
        flat = project(radiance, diffuse, specular, levels, cell, unknown, nothing, nothing, whole)
        group = _groups(pixels, seen, pieces, pool_rows, cell, flat.base_color)
    pure = np.asarray(pixels.pure)
    clean = _clean_rows(pure[rows], group[rows])
    of = rows[clean]
    means = window_means(arrays, of, widths[view[of]], pure, group, view)
    roughness, metallic = part_materials(
        means[0], means[1], means[2], levels, cell[clean], group[of], view[of]
    )
    guess = project(radiance, diffuse, specular, levels, cell, group[rows], roughness, metallic, whole)
    # Parts that none of these rows saw are diffuse.
    missing = max(int(group.max(initial=-1)) + 1 - len(roughness), 0)
    data = TrainingData(
        pool=pool_rows,
        donor=donors,
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


def _groups(
    pixels: PixelStore,
    seen: Observations,
    pieces: np.ndarray,
    pool: np.ndarray,
    cell: np.ndarray,
    color: np.ndarray,
) -> np.ndarray:
    """(N,) int32 group of each pixel that stands for its part, NO_GROUP outside the `pool`.

    Args:
        cell: (M,) int cache entry of some pixels, color: (M, 3) diffuse base colour there.
    """
    size = int(max(cell.max(initial=0), seen.entry[pool].max(initial=0))) + 1
    count = np.maximum(np.bincount(cell, minlength=size), 1)
    sums = [np.bincount(cell, column, minlength=size) / count for column in color.T]
    of_cell = color_class(np.stack(sums, axis=1))
    group = np.full(len(pixels), NO_GROUP, np.int32)
    piece = pieces[pixels.triangle[pool]]
    group[pool] = material_groups(np.asarray(seen.part[pool]), piece, of_cell[seen.entry[pool]], LEAST_PIXELS)
    return group


def _clean_rows(pure: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(M,) bool, pixels that see one surface, and all pixels of parts that have hardly any of these.

    Args:
        pure: (M,) bool; part: (M,) int, negative without.
    """
    known = part >= 0
    count = np.bincount(part[known & pure], minlength=int(part.max(initial=0)) + 1)
    return known & (pure | (count[np.maximum(part, 0)] < FEW_PIXELS))
