# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedos as unknowns of one group of points each, which are eliminated where light is solved for.

What is usual of them decides where nothing else does; that none is above white paint is physics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robust import student_weights, without_means

# Expected albedo and its standard deviation (of the logarithm): broad, as rooms are dark or light as a whole;
# the highest albedo, and its deviation; the deviation of a known albedo.
ALBEDO, ALBEDO_SPREAD, MAX_ALBEDO, MAX_SPREAD, KNOWN_SPREAD = 0.4, 1.0, 0.9, 0.1, 0.05
MIN_GROUP = 8  # points of one albedo
# Neighbouring points share textures and errors of the light: about this many count as one.
POINTS_PER_SAMPLE = 10.0


@dataclass(frozen=True, eq=False)
class AlbedoRows:
    """Residuals (R,) less the albedo of their group, their derivatives (R, K), and weights (R,); the points
    first, then the prior of the albedo of each group. And logarithms of the albedos (G,)."""

    residual: np.ndarray
    jacobian: np.ndarray
    weight: np.ndarray
    albedo: np.ndarray


def without_albedo(
    residual: np.ndarray, jacobian: np.ndarray, group: np.ndarray, known: np.ndarray, spread: float
) -> AlbedoRows:
    """Eliminate the logarithm of the albedo of each group.

    Args:
        residual, jacobian: as in `AlbedoRows`, of N points.
        known: (G,) logarithms of known albedos, else NaN.
    """
    size = len(known)
    weight = np.full(len(residual), 1.0 / (spread**2 * POINTS_PER_SAMPLE))
    albedo, samples = np.full(size, np.log(ALBEDO)), np.bincount(group, minlength=size) / POINTS_PER_SAMPLE
    mean = albedo
    for step in range(7):
        if step:  # about their own mean: a whole group above white is no outlier, its light is too low
            ratio = ((residual - mean[group]) / spread) ** 2
            weight = student_weights(ratio) / (spread**2 * POINTS_PER_SAMPLE)
        of_points, pull = (
            np.bincount(group, weight * each, size) for each in (np.ones(len(residual)), residual)
        )
        mean = pull / np.maximum(of_points, 1e-12)
        expected, precision = _expected_albedo(albedo, known, samples)
        albedo = (pull + precision * expected) / (of_points + precision)
    every, weight = np.concatenate([group, np.arange(size)]), np.concatenate([weight, precision])
    residual = without_means(np.concatenate([residual, expected]), every, weight)
    jacobian = np.concatenate([jacobian, np.zeros((size, jacobian.shape[1]))])
    return AlbedoRows(residual, without_means(jacobian, every, weight), weight, albedo)


def _expected_albedo(
    albedo: np.ndarray, known: np.ndarray, samples: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Prior mean of the logarithms of albedos (G,), and its precision.

    Usual albedos are a habit, therefore robust: red paint reflects hardly any blue.

    Args:
        known: (G,) those that are known, else NaN.
        samples: (G,) independent ones that the points of each group count as.
    """
    above = albedo > np.log(MAX_ALBEDO)
    usual = student_weights(((albedo - np.log(ALBEDO)) / ALBEDO_SPREAD) ** 2) / ALBEDO_SPREAD**2
    expected = np.log(np.where(above, MAX_ALBEDO, ALBEDO))
    precision = np.where(above, samples / MAX_SPREAD**2, usual)
    unknown = np.isnan(known)
    return np.where(unknown, expected, known), np.where(unknown, precision, samples / KNOWN_SPREAD**2)
