# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From the solve's arbitrary frame to a room: Z up, metres, and the floor near zero.

Needs numpy alone. Poses are camera-to-world with OpenCV axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..core import conventions
from ..core.alignment.turns import rotation_between
from ..core.capture.upright import common_up
from ..core.run.errors import FiptError

FLOOR_PERCENTILE = 2.0  # of the heights of points; below the floor are only wrong points
_LEAST_ANGLE = np.radians(1.0)  # between rays; below, a position along them is not determined
_DROP = 3.0  # times the median distance from the rays: such rays are of something else
_PICK_SHARE = 0.08  # of the image's diagonal within which a solved point gives the depth of a picked pixel
_PICK_FORM = "Write them as VIEW X Y, separated by commas in one point and by a semicolon between the points."


@dataclass(frozen=True)
class Pick:
    """A position that the user has picked in a view, in pixels."""

    view: str
    x: float
    y: float


def room_frame(poses: np.ndarray, points: np.ndarray, meters_per_unit: float) -> np.ndarray:
    """The similarity (4, 4) from the solve's frame to the room's: Z up, metres, floor at zero.

    The origin is below the middle of the cameras.

    Args:
        poses: (V, 4, 4) in the solve's frame.
        points: (P, 3) solved points; may be empty.
        meters_per_unit: length of the solve's unit.
    """
    similarity = np.eye(4)
    similarity[:3, :3] = meters_per_unit * rotation_between(common_up(poses).up, np.array([0.0, 0.0, 1.0]))
    centers = conventions.transform_points(similarity, poses[:, :3, 3])
    heights = conventions.transform_points(similarity, points)[:, 2] if len(points) else centers[:, 2]
    floor = float(np.percentile(heights, FLOOR_PERCENTILE))
    similarity[:3, 3] = [-centers[:, 0].mean(), -centers[:, 1].mean(), -floor]
    return similarity


def nearest_to_rays(origins: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
    """The point (3,) nearest to most of some rays, without those that pass far from it.

    Args:
        origins: (N, 3).
        directions: (N, 3) of length 1.

    Returns:
        None where all rays are nearly parallel, or there is only one.
    """
    tried = combinations(range(min(len(origins), 24)), 2)  # 276 pairs of rays
    crossings = [_crossing(origins[list(pair)], directions[list(pair)]) for pair in tried]
    known = [point for point in crossings if point is not None]
    if not known:
        return None
    # Half of the rays may be of something else: the crossing of two that most others pass nearest to.
    start = min(known, key=lambda point: float(np.median(_distances(point, origins, directions))))
    distances = _distances(start, origins, directions)
    kept = distances <= _DROP * max(float(np.median(distances)), 1e-9)
    refined = _crossing(origins[kept], directions[kept])
    return start if refined is None else refined


def _crossing(origins: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
    """The point (3,) with the least sum of squared distances from rays, None where they are parallel."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    matrix = across.sum(axis=0)
    # The smallest eigenvalue is the sum of the squared sines of the angles to the common direction.
    if np.linalg.eigvalsh(matrix)[0] < len(origins) * np.sin(0.5 * _LEAST_ANGLE) ** 2:
        return None
    return np.asarray(np.linalg.solve(matrix, (across @ origins[:, :, None]).sum(axis=0)[:, 0]))


def _distances(point: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N,) distances of rays from a point."""
    return np.linalg.norm(np.cross(point - origins, directions), axis=1)


def depth_of_pick(pixel: np.ndarray, positions: np.ndarray, depths: np.ndarray, diagonal: float) -> float:
    """The depth at a picked pixel: the median of the nearest solved points'.

    Args:
        pixel: (2,) picked.
        positions: (P, 2) of the solved points in the view.
        depths: (P,) along the camera's Z axis.
        diagonal: of the image in pixels.

    Raises:
        ValueError: where no solved point is near.
    """
    distances = np.linalg.norm(positions - pixel, axis=1)
    near = np.argsort(distances)[:5]
    near = near[distances[near] <= _PICK_SHARE * diagonal]
    if not near.size:
        raise ValueError("no solved point is near it")
    return float(np.median(depths[near]))


def parse_picks(text: str) -> tuple[list[Pick], list[Pick]]:
    """Two points from a text such as ``"desk-1 812 440, desk-2 790 431; desk-1 102 455"``.

    Raises:
        FiptError: ``scale-picks``.
    """
    points = [
        [_pick(part) for part in point.split(",") if part.strip()]
        for point in text.split(";")
        if point.strip()
    ]
    if len(points) != 2 or not all(points):
        raise FiptError("scale-picks", f"The text '{text}' does not name two points.", _PICK_FORM)
    return points[0], points[1]


def _pick(text: str) -> Pick:
    words = text.strip().rsplit(maxsplit=2)
    try:
        pick = Pick(words[0], float(words[1]), float(words[2]))
    except (IndexError, ValueError):
        raise FiptError(
            "scale-picks", f"'{text.strip()}' is not a view and a position in it.", _PICK_FORM
        ) from None
    if not np.isfinite([pick.x, pick.y]).all():
        raise FiptError("scale-picks", f"'{text.strip()}' has no finite position.", _PICK_FORM)
    return pick


def parse_similarity(text: str) -> np.ndarray:
    """A similarity (4, 4) from 12 or 16 numbers, row by row, without reflection.

    Raises:
        FiptError: ``scale-matrix``.
    """
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        values = np.empty(0)
    if values.size in (12, 16) and np.isfinite(values).all():
        matrix = np.eye(4)
        matrix[:3] = values[:12].reshape(3, 4)
        linear = matrix[:3, :3]
        scale = np.cbrt(np.linalg.det(linear))
        even = scale > 0.0 and np.abs(linear.T @ linear / scale**2 - np.eye(3)).max() < 1e-3
        if even and (values.size == 12 or np.allclose(values[12:], [0.0, 0.0, 0.0, 1.0])):
            return matrix
    raise FiptError(
        "scale-matrix",
        "The transform from the cameras to the mesh is not a rotation, one scale and a translation.",
        "Give the 12 or 16 numbers of a 4 x 4 matrix, row by row, without reflection or shear.",
    )


def marker_edge(corners: np.ndarray) -> tuple[float, float]:
    """Edge length of a square from its four corners, and by how much its sides and diagonals disagree.

    Args:
        corners: (4, 3) in order around the square.

    Returns:
        The mean edge, and the standard deviation of the six estimates of it over the mean.
    """
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1) / np.sqrt(2.0)
    estimates = np.concatenate([sides, diagonals])
    mean = float(estimates.mean())
    return mean, float(estimates.std() / mean) if mean > 0.0 else float("inf")


def agreed_scale(scales: Sequence[float]) -> tuple[float, float]:
    """The median of several estimates, and their largest relative difference from it."""
    median = float(np.median(scales))
    return median, float(np.max(np.abs(np.asarray(scales) - median)) / median)
