"""Points that are nearly on a mesh are moved onto it: point-to-plane ICP (Chen and Medioni 1992) with scale.

Errors are measured over the scale, in units of the points: shrunk onto a wall, they would fit best otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..conventions import transform_points
from ..robust import MAD_TO_DEVIATION
from ..run.errors import FiptError
from .turns import moved_about

MIN_POINTS = 50  # of a solve
STEPS = 30  # of Gauss-Newton
REACH = 0.05  # of the points' extent, from which points count less at first
NEAR = 0.02  # of the extent: points of another room lie within 5 % of some surface too often to tell
CLOSER = 0.8  # by which the distance from which points count less shrinks in each step
GROWTH = 0.2  # most logarithm of the scale that a step changes


class Nearest(Protocol):
    """What points are moved onto; `surface.Surface` is one."""

    def nearest(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


@dataclass(frozen=True, eq=False)
class Refined:
    """Where points belong on a mesh.

    Attributes:
        similarity: (4, 4) float64 from where the points are.
        error: median distance of the moved points from the mesh, in units of the mesh.
        inliers: share of the points within `NEAR` of the points' extent.
    """

    similarity: np.ndarray
    error: float
    inliers: float


def refine(points: np.ndarray, surface: Nearest) -> Refined:
    """Move points of a solve onto a mesh.

    Args:
        points: (N, 3) where they are now, nearly right; some may be far off.
        surface: what they belong on.

    Raises:
        FiptError: ``alignment-points`` for too few points.
    """
    if len(points) < MIN_POINTS:
        raise FiptError("alignment-points.refine", number_of_points=len(points), min_points=MIN_POINTS)
    low, high = np.percentile(points, [2.0, 98.0], axis=0)  # every solve has a few points far away
    extent = float(np.linalg.norm(high - low)) or 1.0
    similarity, moved = np.eye(4), np.asarray(points, np.float64)
    for step in range(STEPS):
        distance, normal = surface.nearest(moved)
        off = distance / extent
        # Tukey's weights, zero at twice the width; it shrinks to what most points are off by.
        width = max(REACH * CLOSER**step, MAD_TO_DEVIATION * float(np.median(off)), 1e-6)
        weight = np.maximum(1.0 - (off / (2.0 * width)) ** 2, 0.0) ** 2 + 1e-9
        middle = weight @ moved / weight.sum()
        arm = (moved - middle) / extent
        growth = (arm * normal).sum(axis=1) - off
        matrix = np.column_stack([np.cross(arm, normal), normal, growth])
        weighted = matrix.T * weight
        hessian = weighted @ matrix
        hessian += (1e-6 * np.trace(hessian) / 7.0 + 1e-12) * np.eye(7)
        change = np.linalg.solve(hessian, -(weighted @ off))
        scale = float(np.exp(np.clip(change[6], -GROWTH, GROWTH)))
        motion = moved_about(middle, change[:3], extent * change[3:6], scale)
        similarity, moved, extent = motion @ similarity, transform_points(motion, moved), scale * extent
    distance = surface.nearest(moved)[0]
    return Refined(similarity, float(np.median(distance)), float((distance < NEAR * extent).mean()))
