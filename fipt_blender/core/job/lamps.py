# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The lamps of an estimation: which triangles emit after a training, and the fixtures that they make."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..light.emitters import Fixture, find_emitters, group_fixtures
from ..light.evidence import find_emission, outshining
from ..light.joint import joint_fixtures
from ..light.views import ShadingStore
from ..scene.pixels import PixelStore
from ..scene.room import Room
from .settings import Settings

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
        among=outshining(pixels, shadings, len(room.triangles)),
    )
    return find_emission(room, pixels, shadings, marked, constant, estimate)


def make_fixtures(
    room: Room, pixels: PixelStore, emitting: np.ndarray, mask: Mask, settings: Settings, index: int
) -> list[Fixture]:
    """The fixtures of emitting triangles ((T,) bool), or those of emission that was fitted jointly.

    Args:
        mask: as of :func:`find_lamps`; (N, 3) radiance where emission is fitted jointly.
        index: of the training.
    """
    if settings.emission == "joint":
        samples = settings.emitter_threshold, settings.emitter_samples
        return joint_fixtures(room, mask, *samples, _generator(settings, index))
    return group_fixtures(room, emitting, pixels.triangle, pixels.front, pixels.pure, pixels.radiance)


def _generator(settings: Settings, index: int) -> np.random.Generator:
    return np.random.default_rng([settings.seed, 3, index])
