# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a new light and an inserted object can go in a room, found by casting rays into its mesh.

Pure geometry on a ray-casting function; nothing depends on the room's absolute size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

# (origin (3,), unit direction (3,)) -> (point (3,), normal (3,)) of the first surface, or None.
Cast = Callable[[np.ndarray, np.ndarray], "tuple[np.ndarray, np.ndarray] | None"]

_UP = np.array([0.0, 0.0, 1.0])
_DOWN = -_UP
_AROUND = [np.array([np.cos(a), np.sin(a), 0.0]) for a in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)]


@dataclass(frozen=True)
class LightPlace:
    """A horizontal square that faces down: its centre (3,) and side, in metres."""

    center: np.ndarray
    size: float


@dataclass(frozen=True)
class Support:
    """A spot on which a ball can stand: its contact point (3,) and the ball's radius, in metres."""

    point: np.ndarray
    radius: float


@dataclass(frozen=True)
class ViewGeometry:
    """A pinhole camera: camera-to-world (4,4) with OpenCV axes, intrinsics in pixels."""

    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def ray(self, u: float, v: float) -> tuple[np.ndarray, np.ndarray]:
        """Origin and unit direction through the pixel position (u, v)."""
        pixel = np.array([(u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0])
        direction = self.camera_to_world[:3, :3] @ pixel
        return self.camera_to_world[:3, 3], direction / np.linalg.norm(direction)


def find_light_place(cast: Cast, low: np.ndarray, high: np.ndarray, eye_height: float) -> LightPlace:
    """A place for an area light below the ceiling, as near to the room's middle as what hangs there allows.

    Args:
        cast: the room.
        low, high: the room's bounds (3,).
        eye_height: z from which the ceiling is looked for; that of the cameras lies inside the room.
    """
    extent = high - low
    size = 0.2 * float(min(extent[0], extent[1]))
    margin = 0.03 * float(extent[2])
    middle = 0.5 * (low + high)
    best: tuple[float, float] | None = None
    place = np.array([middle[0], middle[1], high[2] - margin])
    for dx in np.linspace(-0.2, 0.2, 5):
        for dy in np.linspace(-0.2, 0.2, 5):
            x, y = middle[0] + dx * extent[0], middle[1] + dy * extent[1]
            ceiling = _lowest_above(cast, x, y, eye_height, 0.5 * size, high[2])
            # A lamp that hangs a tenth of the room's height down outweighs the way to the room's corner.
            rank = (ceiling / float(extent[2]) - 0.2 * float(np.hypot(dx, dy)), -float(np.hypot(dx, dy)))
            if best is None or rank > best:
                best, place = rank, np.array([x, y, ceiling - margin])
    return LightPlace(place, size)


def _lowest_above(cast: Cast, x: float, y: float, z: float, half: float, highest: float) -> float:
    heights = []
    for sx in (-half, 0.0, half):
        for sy in (-half, 0.0, half):
            hit = cast(np.array([x + sx, y + sy, z]), _UP)
            heights.append(highest if hit is None else float(hit[0][2]))
    return min(heights)


def find_support(
    cast: Cast, view: ViewGeometry, share: float = 0.18, columns: int = 17, rows: int = 13
) -> Support | None:
    """A level, free spot in the view on which a ball can stand, near the lower middle of the picture.

    Args:
        cast: the room.
        view: the camera from which the ball must be seen whole.
        share: diameter of the ball as a share of the picture's height.
        columns, rows: how finely the picture is searched.

    Returns:
        The best spot, or None where the view shows none.
    """
    best: tuple[float, Support] | None = None
    for row in np.linspace(0.3, 0.9, rows):
        for column in np.linspace(0.15, 0.85, columns):
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
    center = point + radius * _UP
    if not _clear(cast, center, _UP, 1.5 * radius):
        return False
    for around in _AROUND:
        if not _clear(cast, center, around, 1.3 * radius):
            return False
        below = cast(center + 1.1 * radius * around, _DOWN)
        if below is None or abs(float(below[0][2] - point[2])) > 0.05 * radius:
            return False
    side = np.cross(center - eye, _UP)
    side /= max(float(np.linalg.norm(side)), 1e-12)
    for offset in (0.0 * _UP, _UP, side, -side):
        way = center + 0.9 * radius * offset - eye
        if not _clear(cast, eye, way / np.linalg.norm(way), float(np.linalg.norm(way)) - 0.01 * radius):
            return False
    return True


def _clear(cast: Cast, origin: np.ndarray, direction: np.ndarray, distance: float) -> bool:
    hit = cast(origin, direction)
    return hit is None or float(np.linalg.norm(hit[0] - origin)) > distance


def room_light_power(median_radiance: float, low: np.ndarray, high: np.ndarray) -> float:
    """Watts of a light that makes a room about as bright as its photographs.

    A room of albedo 1/2 and radiosity πL absorbs as much as it sends out: Φ = A π L, with A the area of its
    bounds.

    Args:
        median_radiance: of the photographs.
        low, high: the room's bounds (3,).
    """
    x, y, z = (float(value) for value in high - low)
    return 2.0 * (x * y + y * z + z * x) * float(np.pi) * median_radiance


def choose_view(cast: Cast, views: Sequence[tuple[str, ViewGeometry]]) -> tuple[str, Support | None]:
    """The first view with a spot for the inserted object, smaller objects second; else the first view.

    Args:
        cast: the room.
        views: names and cameras, the preferred ones first; at least one.
    """
    for share in (0.18, 0.1):
        for name, view in views:
            support = find_support(cast, view, share)
            if support is not None:
                return name, support
    return views[0][0], None
