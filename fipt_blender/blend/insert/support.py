"""Free spots of a room where an inserted object can stand.

Pure geometry on a ray-casting function, independent of the room's absolute size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..capture.view_geometry import ViewGeometry
from ..room.rays import Cast

_UP = np.array([0.0, 0.0, 1.0])
_DOWN = -_UP
_AROUND = [np.array([np.cos(a), np.sin(a), 0.0]) for a in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)]


@dataclass(frozen=True)
class Support:
    """A spot where a ball can stand: its contact point (3,) and the ball's radius, in metres."""

    point: np.ndarray
    radius: float


def find_support(cast: Cast, view: ViewGeometry, share: float = 0.18) -> Support | None:
    """A level, free spot where a ball can stand, near the lower middle of the image.

    Args:
        cast: ray casting into the room.
        view: the camera, which must see the whole ball.
        share: diameter of the ball as a share of the image's height.

    Returns:
        The best spot, or None where there is none.
    """
    best: tuple[float, Support] | None = None
    for row in np.linspace(0.3, 0.9, 13):
        for column in np.linspace(0.15, 0.85, 17):
            distance = float(np.hypot(column - 0.5, row - 0.65))
            if best is not None and distance >= best[0]:
                continue
            origin, direction = view.ray(column * view.width, row * view.height)
            hit = cast(origin, direction)
            if hit is None or abs(float(hit[1][2])) < 0.98 or direction[2] >= 0.0:
                continue
            depth = float(np.linalg.norm(hit[0] - origin))
            radius = 0.5 * share * depth * view.height / view.fy
            if _is_free(cast, origin, hit[0], radius):
                best = (distance, Support(hit[0], radius))
    return None if best is None else best[1]


def _is_free(cast: Cast, eye: np.ndarray, point: np.ndarray, radius: float) -> bool:
    """Whether a ball on a point has room around it, level ground below it, and is fully visible."""
    center = point + radius * _UP
    if not _clear(cast, center, _UP, 1.5 * radius):
        return False
    for outwards in _AROUND:
        if not _clear(cast, center, outwards, 1.3 * radius):
            return False
        below = cast(center + 1.1 * radius * outwards, _DOWN)
        if below is None or abs(float(below[0][2] - point[2])) > 0.05 * radius:
            return False
    side = np.cross(center - eye, _UP)
    side /= max(float(np.linalg.norm(side)), 1e-12)
    for offset in (0.0 * _UP, _UP, side, -side):
        sight = center + 0.9 * radius * offset - eye
        distance = np.linalg.norm(sight)
        if not _clear(cast, eye, sight / distance, float(distance) - 0.01 * radius):
            return False
    return True


def _clear(cast: Cast, origin: np.ndarray, direction: np.ndarray, distance: float) -> bool:
    """Whether a ray hits nothing within a distance."""
    hit = cast(origin, direction)
    return hit is None or float(np.linalg.norm(hit[0] - origin)) > distance


def choose_view(cast: Cast, views: Sequence[tuple[str, ViewGeometry]]) -> tuple[str, Support | None]:
    """The first view with a spot for an inserted object, else for a smaller one; else the first view.

    Args:
        cast: ray casting into the room.
        views: names and cameras in order of preference; at least one.
    """
    for share in (0.18, 0.1):
        for name, view in views:
            support = find_support(cast, view, share)
            if support is not None:
                return name, support
    return views[0][0], None
