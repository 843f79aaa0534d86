"""Robust least squares: weights by residuals, nuisances that are eliminated, and steps until they settle.

A nuisance is an unknown of one group of rows, such as the radiance of a surface point that several views see,
or the albedo of a part. It is eliminated where each row is taken less the weighted mean of its group. Needs
numpy alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Standard deviation of a normal distribution by its median absolute deviation.
MAD_TO_DEVIATION = 1.4826
# Views that must see a place: of two, neither can outvote the error of the other.
LEAST_VIEWS = 3
# Degrees of freedom of Student's t-distribution, to which highlights and wrong geometry are outliers.
DEGREES = 3.0


def deviation(residual: np.ndarray, least: float = 0.0) -> float:
    """Standard deviation of residuals of any shape by their median, at least `least`."""
    return max(MAD_TO_DEVIATION * float(np.median(np.abs(residual))), least)


def student_weights(ratio: np.ndarray) -> np.ndarray:
    """Weights of squared residuals over their variance, by Student's t-distribution."""
    return (DEGREES + 1.0) / (DEGREES + ratio)


def without_means(values: np.ndarray, group: np.ndarray, weight: np.ndarray, count: int = 0) -> np.ndarray:
    """Values (N,) or (N, C) less the weighted mean of their group, column by column.

    Args:
        group: (N,) int from 0. weight: (N,). count: least number of groups.
    """
    total = np.maximum(np.bincount(group, weight, count), 1e-12)
    columns = np.atleast_2d(values.T)
    means = [(np.bincount(group, weight * column, count) / total)[group] for column in columns]
    return np.asarray(values - (means[0] if values.ndim == 1 else np.stack(means, axis=1)))


@dataclass(frozen=True, eq=False)
class Solution:
    """What Gauss-Newton has found.

    Attributes:
        x: (P,) unknowns.
        normal: (P, P) matrix of the last step: the inverse of their covariance.
        spread: standard deviation of a row.
    """

    x: np.ndarray
    normal: np.ndarray
    spread: float

    @property
    def deviation(self) -> np.ndarray:
        """(P,) standard errors."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.normal))))


def gauss_newton(
    system: Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray, float]],
    start: np.ndarray,
    spread: float,
    *,
    most_steps: int,
    longest: float,
    settled: float,
) -> Solution:
    """Gauss-Newton with steps of limited length.

    Args:
        system: the unknowns (P,) and the spread of the step before to the normal matrix (P, P), the right
            side (P,) and the spread.
        start: (P,) unknowns. spread: to begin with.
        most_steps: their number at most.
        longest: by which an unknown changes in a step.
        settled: change of all unknowns below which no more steps are taken.
    """
    x, normal = start, np.eye(len(start))
    for _ in range(most_steps):
        normal, right, spread = system(x, spread)
        step = np.clip(np.linalg.solve(normal, right), -longest, longest)
        x = x + step
        if np.abs(step).max() < settled:
            break
    return Solution(x, normal, spread)
