# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflective lamps: the emitted and the reflected part of their radiance.

The paper assumes black emitters (Sec. 4.4). A white shade or a screen reflects: over its pixels the radiance
depends linearly on the shading, L = L_e + a L_d + L_s, with slope a and intercept L_e. A fixture gets a base
colour only if the slope is significant. Baking does not depend on it, as the radiance that leaves the lamp is
the photographed one in either case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..optics.factorised import DIELECTRIC_REFLECTANCE
from ..robust import LEAST_VIEWS, deviation
from .emitters import Fixture

LEAST_PIXELS = 50  # of a lamp
# Standard errors by which a slope must exceed zero.
SURE = 4.0
# Least coefficient of determination (R squared): a shade that is bright in the middle does not fit a line.
EXPLAINED = 0.7
# Robust standard deviations beyond which pixels lose weight (Huber), and iterations of the reweighting.
OUTLIER = 2.0
ROUNDS = 10


@dataclass(frozen=True)
class LampPixels:
    """N pure pixels of emitting triangles.

    Attributes:
        triangle: (N,) int. front: (N,) bool. view: (N,) int.
        radiance: (N, 3) photographed. diffuse: (N, 3) L_d.
        specular: (N, 2, 3) L_s0 and L_s1 of the roughest level.
    """

    triangle: np.ndarray
    front: np.ndarray
    view: np.ndarray
    radiance: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray


def separate(fixtures: Sequence[Fixture], pixels: LampPixels) -> tuple[list[Fixture], np.ndarray]:
    """Fixtures with their emitted radiance, and (F, 3) the base colour of each: black where uncertain."""
    separated, colors = [], np.zeros((len(fixtures), 3))
    for index, fixture in enumerate(fixtures):
        on_fixture = np.isin(pixels.triangle, fixture.triangles)
        sides = ((True, fixture.radiance), (False, fixture.back_radiance))
        shining = [side for side, total in sides if np.any(total > 0.0)]
        lines = {side: _fit(pixels, np.flatnonzero(on_fixture & (pixels.front == side))) for side in shining}
        fitted = {side: line for side, line in lines.items() if line is not None}
        # Both sides have one material: if one of them may be black, the lamp is.
        if fitted and len(fitted) == len(lines):
            colors[index] = np.mean([color for color, _ in fitted.values()], axis=0)
            front, back = (fitted[side][1] if side in fitted else total for side, total in sides)
            fixture = replace(fixture, radiance=front, back_radiance=back)
        separated.append(fixture)
    return separated, colors


def _fit(pixels: LampPixels, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """(base colour (3,), L_e (3,)) fitted to the given pixels, or None if they may be black."""
    if len(rows) < LEAST_PIXELS or len(np.unique(pixels.view[rows])) < LEAST_VIEWS:
        return None
    view = np.unique(pixels.view[rows], return_inverse=True)[1]
    gloss = DIELECTRIC_REFLECTANCE * pixels.specular[rows, 0] + pixels.specular[rows, 1]
    grey = (pixels.radiance[rows] - gloss).mean(axis=1), pixels.diffuse[rows].mean(axis=1)
    weight, slope, error, explained = _robust_line(*grey, view)
    if not (slope > SURE * error and explained > EXPLAINED):
        return None
    y, x = pixels.radiance[rows] - gloss, pixels.diffuse[rows]
    middle_x, middle_y = (np.average(each, axis=0, weights=weight) for each in (x, y))
    spread = x - middle_x
    color = (weight[:, None] * spread * (y - middle_y)).sum(axis=0)
    color /= np.maximum((weight[:, None] * spread**2).sum(axis=0), 1e-12)
    color = np.clip(color, 0.0, 1.0)
    emitted = middle_y - color * middle_x
    return (color, emitted) if (emitted > 0.0).all() else None


def _robust_line(y: np.ndarray, x: np.ndarray, view: np.ndarray) -> tuple[np.ndarray, float, float, float]:
    """Line fit with Huber weights.

    Returns:
        Weights (N,), slope, its standard error (views as clusters) and the coefficient of determination.
    """
    weight = np.ones(len(y))
    for _ in range(ROUNDS):
        middle_x, middle_y = np.average(x, weights=weight), np.average(y, weights=weight)
        information = max(float((weight * (x - middle_x) ** 2).sum()), 1e-12)
        slope = float((weight * (x - middle_x) * (y - middle_y)).sum()) / information
        residual = y - middle_y - slope * (x - middle_x)
        scale = deviation(residual, max(1e-6 * abs(float(middle_y)), 1e-12))
        weight = np.minimum(1.0, OUTLIER * scale / np.maximum(np.abs(residual), 1e-12))
    score = np.bincount(view, weight * (x - middle_x) * residual)
    number = len(score)
    error = float(np.sqrt((score**2).sum() * number / max(number - 1, 1))) / information
    before = float((weight * (y - np.average(y, weights=weight)) ** 2).sum())
    explained = 1.0 - float((weight * residual**2).sum()) / max(before, 1e-12)
    return weight, slope, error, explained
