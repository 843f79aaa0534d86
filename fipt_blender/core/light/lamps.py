# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitters of an estimation after a training: the emitting triangles, and their fixtures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..run.settings import Settings
from ..scene.pixels import PixelStore
from ..scene.room import Room
from .baking import ShadingStore
from .emitters import EmitterPixels, Fixture, find_emitters, group_fixtures
from .evidence import brighter_than_white, find_emission
from .joint import joint_fixtures

Mask = Callable[[np.ndarray], np.ndarray]


def find_lamps(
    room: Room,
    pixels: PixelStore,
    shadings: ShadingStore,
    mask: Mask,
    estimate: Callable[[np.ndarray], np.ndarray],
    constant: np.ndarray,
    settings: Settings,
    index: int,
) -> np.ndarray:
    """(T,) bool, triangles that emit.

    Args:
        mask: (N, 3) world positions to the emission network's (N,) alpha.
        estimate: (R,) pixels to their (R, 3) reflected radiance L_r of the estimate.
        constant: (T,) bool, triangles that emit in any case.
        index: of the training.
    """
    marked = find_emitters(
        room,
        mask,
        settings.emitter_threshold,
        settings.emitter_samples,
        _generator(settings, index),
        candidates=brighter_than_white(pixels, shadings, len(room.triangles)),
    )
    return find_emission(room, pixels, shadings, marked, constant, estimate)


def make_fixtures(
    room: Room, pixels: PixelStore, emitting: np.ndarray, mask: Mask, settings: Settings, index: int
) -> list[Fixture]:
    """Fixtures of the emitting triangles ((T,) bool), or of the jointly optimised emission.

    Args:
        mask: as in :func:`find_lamps`; to (N, 3) radiance if emission is optimised jointly.
        index: of the training.
    """
    if settings.emission == "joint":
        samples = settings.emitter_threshold, settings.emitter_samples
        return joint_fixtures(room, mask, *samples, _generator(settings, index))
    return group_fixtures(room, emitting, EmitterPixels.of(pixels))


def _generator(settings: Settings, index: int) -> np.random.Generator:
    return np.random.default_rng([settings.seed, 3, index])
