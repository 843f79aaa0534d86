# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What stage 2 starts from: the pixels to train on, and the closed-form guess at some of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..light.observations import Observations
from ..light.views import ShadingStore
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
    shadings: ShadingStore,
    levels: np.ndarray,
    normalise: Callable[[np.ndarray], np.ndarray],
    seed: int,
) -> tuple[TrainingData, Guess, np.ndarray]:
    """What training draws from, with the closed-form guess at some of its pixels and those pixels' rows.

    Args:
        shadings: of all pixels at the roughness `levels`.
        normalise: world positions to the unit cube.
    """
    part, donors = seen.part, seen.donor
    pool_rows = np.flatnonzero(donors >= 0)
    rows = pool_rows[donors[pool_rows] == pool_rows]
    if len(rows) > PROJECTION_PIXELS:
        rng = np.random.default_rng([seed, 2])
        rows = np.sort(rng.choice(rows, PROJECTION_PIXELS, replace=False))
    view = pixels.view_of(np.arange(len(pixels)))
    widths = np.array([each.width for each in pixels.views])
    arrays = (pixels.radiance, shadings.diffuse, shadings.specular)
    cell = np.asarray(seen.entry[rows], np.int64)
    # A semantic class holds several materials: no single pair would fit it.
    known = part[rows] if parts.kind == "part" else np.full(len(rows), -1, np.int32)
    roughness = metallic = np.zeros(0, np.float32)
    if parts.kind == "part":
        pure = np.asarray(pixels.pure)
        clean = _clean_rows(pure[rows], known)
        of = rows[clean]
        radiance, diffuse, specular = window_means(arrays, of, widths[view[of]], pure, part, view)
        roughness, metallic = part_materials(
            radiance, diffuse, specular, levels, cell[clean], known[clean], view[of]
        )
    radiance, diffuse, specular = (np.asarray(array[rows], np.float32) for array in arrays)
    guess = project(radiance, diffuse, specular, levels, cell, known, roughness, metallic)
    # Parts that none of these rows saw are diffuse.
    unseen = max(int(part.max(initial=-1)) + 1 - len(guess.part_roughness), 0)
    data = TrainingData(
        pool=pool_rows,
        donor=donors,
        position=pixels.position,
        radiance=pixels.radiance,
        part=part,
        diffuse=shadings.diffuse,
        specular=shadings.specular,
        levels=levels,
        part_kind=parts.kind,
        part_roughness=np.pad(guess.part_roughness, (0, unseen), constant_values=1.0),
        part_metallic=np.pad(guess.part_metallic, (0, unseen)),
        normalise=normalise,
    )
    return data, guess, rows


def _clean_rows(pure: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(M,) bool, pixels that see one surface, and all pixels of parts that have hardly any of these.

    Args:
        pure: (M,) bool; part: (M,) int, negative without.
    """
    known = part >= 0
    count = np.bincount(part[known & pure], minlength=int(part.max(initial=0)) + 1)
    return known & (pure | (count[np.maximum(part, 0)] < FEW_PIXELS))
