# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that also reflect: what of their radiance is the room's light.

The paper takes emitters as black (Sec. 4.4). A white shade or a screen is not: over its pixels radiance
follows the light that falls there, L = L_e + a L_d + L_s, a line with slope a and intercept L_e. Only where
the slope is beyond doubt does a fixture get a base colour. While shadings are baked nothing changes, since
what a lamp sends is what the photographs show, whatever its origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .emitters import Fixture

LEAST_PIXELS = 50
LEAST_VIEWS = 3
# Standard errors by which a slope must be above nothing.
SURE = 4.0
# Share of the spread of radiance that the line must explain: a shade that is bright in the middle is no line.
EXPLAINED = 0.7
# Standard deviations (robust) from which pixels lose weight, and rounds in which that is found.
OUTLIER = 2.0
ROUNDS = 10
DIELECTRIC = 0.04


@dataclass(frozen=True)
class LampPixels:
    """N pixels that see emitting triangles alone.

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
    """Fixtures with what they emit alone, and (F, 3) the base colour of each: black where it is uncertain."""
    separated, colors = [], np.zeros((len(fixtures), 3))
    for index, fixture in enumerate(fixtures):
        mine = np.isin(pixels.triangle, fixture.triangles)
        sides = ((True, fixture.radiance), (False, fixture.back_radiance))
        shining = [side for side, total in sides if np.any(total > 0.0)]
        lines = {side: _fit(pixels, np.flatnonzero(mine & (pixels.front == side))) for side in shining}
        found = {side: line for side, line in lines.items() if line is not None}
        # One material for both sides: where one of them may be black, the lamp is.
        if found and len(found) == len(lines):
            colors[index] = np.mean([color for color, _ in found.values()], axis=0)
            front, back = (found[side][1] if side in found else total for side, total in sides)
            fixture = replace(fixture, radiance=front, back_radiance=back)
        separated.append(fixture)
    return separated, colors


def _fit(pixels: LampPixels, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """(base colour (3,), L_e (3,)) of the pixels given, or None where they may be black."""
    if len(rows) < LEAST_PIXELS or len(np.unique(pixels.view[rows])) < LEAST_VIEWS:
        return None
    view = np.unique(pixels.view[rows], return_inverse=True)[1]
    gloss = DIELECTRIC * pixels.specular[rows, 0] + pixels.specular[rows, 1]
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
    """Huber's line: (weights (N,), slope, its standard error by views, share of the spread explained)."""
    weight = np.ones(len(y))
    for _ in range(ROUNDS):
        middle_x, middle_y = np.average(x, weights=weight), np.average(y, weights=weight)
        information = max(float((weight * (x - middle_x) ** 2).sum()), 1e-12)
        slope = float((weight * (x - middle_x) * (y - middle_y)).sum()) / information
        residual = y - middle_y - slope * (x - middle_x)
        scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-6 * abs(float(middle_y)), 1e-12)
        weight = np.minimum(1.0, OUTLIER * scale / np.maximum(np.abs(residual), 1e-12))
    score = np.bincount(view, weight * (x - middle_x) * residual)
    number = len(score)
    error = float(np.sqrt((score**2).sum() * number / max(number - 1, 1))) / information
    before = float((weight * (y - np.average(y, weights=weight)) ** 2).sum())
    explained = 1.0 - float((weight * residual**2).sum()) / max(before, 1e-12)
    return weight, slope, error, explained
