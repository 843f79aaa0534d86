# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vignetting from overlapping views: a point of the room looks darker where it lies nearer to a corner.

Needs numpy alone. The points are those of the camera solve; what reflects differently from view to view is
an outlier.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.pixels.grouped import grouped_sums
from ..core.robust import deviation, without_means

TERMS = 3  # r², r⁴, r⁶ of the logarithm of the share of light
LEAST_OBSERVATIONS = 300  # of points that at least two views see
LEAST_SIGNIFICANCE = 4.0  # standard errors by which the corner must be darker
LEAST_FALLOFF = 0.02  # of the light in the corner; less is not worth a correction
_OUTLIER = 4.685  # times the noise, beyond which Tukey's weights are zero (95 % efficient for normal noise)


@dataclass(frozen=True, eq=False)
class Observations:
    """Where and how bright views see solved points.

    Attributes:
        point: (N,) int number of the point.
        view: (N,) int number of the view.
        radius: (N,) distance from the image's center; 1 in the corner.
        log_radiance: (N,) natural logarithm.
    """

    point: np.ndarray
    view: np.ndarray
    radius: np.ndarray
    log_radiance: np.ndarray


@dataclass(frozen=True, eq=False)
class Falloff:
    """Vignetting of one lens.

    Attributes:
        coefficients: (TERMS,) of r², r⁴, … of the logarithm of the share of light.
        corner: share of light in the corner.
        corner_error: its standard error.
        noise: relative standard deviation of an observation.
    """

    coefficients: np.ndarray
    corner: float
    corner_error: float
    noise: float

    @property
    def certain(self) -> bool:
        """Whether the corner is darker, by more than its error and by more than nothing."""
        darker = 1.0 - self.corner
        return darker > LEAST_FALLOFF and darker > LEAST_SIGNIFICANCE * self.corner_error


def fit_falloff(observations: Observations) -> Falloff | None:
    """The vignetting that makes points equally bright in all views, which may differ by one factor each.

    The logarithm of an observation is that of the point's radiance, the view's factor and the share of
    light. The first is eliminated by subtracting means over each point; the others are fitted by least
    squares with Tukey's weights.

    Returns:
        None with too few observations of points that several views see.
    """
    shared = _shared(observations.point)
    if shared.sum() < LEAST_OBSERVATIONS:
        return None
    _, point = np.unique(observations.point[shared], return_inverse=True)
    _, view = np.unique(observations.view[shared], return_inverse=True)
    columns = np.zeros((len(point), TERMS + int(view.max()) + 1))
    columns[:, :TERMS] = powers(observations.radius[shared])
    columns[np.arange(len(point)), TERMS + view] = 1.0
    values = observations.log_radiance[shared]
    weights, residual = np.ones(len(point)), np.zeros(len(point))
    for _ in range(12):
        centered = without_means(columns, point, weights)
        target = without_means(values, point, weights)
        # A weak pull towards zero decides only where radii are not covered.
        normal = centered.T @ (weights[:, None] * centered) + 1e-3 * np.eye(columns.shape[1])
        solution = np.linalg.solve(normal, centered.T @ (weights * target))
        residual = target - centered @ solution
        sigma = deviation(residual, 1e-6)
        weights = np.clip(1.0 - (residual / (_OUTLIER * sigma)) ** 2, 0.0, None) ** 2
    coefficients = solution[:TERMS]
    # Errors of one view's or point's observations are alike, so that they count by points, not by pixels.
    scores = grouped_sums(centered * (weights * residual)[:, None], point)
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (scores.T @ scores) @ inverse
    log_error = float(np.sqrt(np.ones(TERMS) @ covariance[:TERMS, :TERMS] @ np.ones(TERMS)))
    corner = float(np.exp(coefficients.sum()))
    return Falloff(coefficients, corner, corner * log_error, sigma)


def light_share(coefficients: np.ndarray, width: int, height: int) -> np.ndarray:
    """The share of light (height, width) float32 in each pixel, 1 in the center, never more."""
    x = (np.arange(width) + 0.5 - 0.5 * width) ** 2
    y = (np.arange(height) + 0.5 - 0.5 * height) ** 2
    radius = np.sqrt((y[:, None] + x[None, :]) / (0.25 * (width**2 + height**2)))
    # The polynomial on a fine line, then interpolated: it costs little memory, and can be kept from rising.
    line = np.linspace(0.0, 1.0, 513)
    share = np.minimum.accumulate(np.exp(powers(line) @ coefficients).clip(max=1.0))
    return np.interp(radius, line, share).astype(np.float32)


def powers(radius: np.ndarray) -> np.ndarray:
    """(N, TERMS) even powers of radii (N,)."""
    return np.stack([radius ** (2 * power) for power in range(1, TERMS + 1)], axis=1)


def _shared(point: np.ndarray) -> np.ndarray:
    """(N,) whether an observation's point has others."""
    _, inverse, counts = np.unique(point, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse] > 1)
