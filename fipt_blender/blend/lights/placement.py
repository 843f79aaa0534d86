"""A place for a new light below a room's ceiling, and its power; pure geometry on a ray-casting function."""

from __future__ import annotations

import numpy as np

from ..room.rays import Cast

_UP = np.array([0.0, 0.0, 1.0])


def find_light_place(
    cast: Cast, low: np.ndarray, high: np.ndarray, eye_height: float
) -> tuple[np.ndarray, float]:
    """A place for an area light below the ceiling, as near the middle of the room as hanging lamps allow.

    Returns the centre (3,) and the side in metres of a horizontal square that faces down.

    Args:
        cast: ray casting into the room.
        low, high: the room's bounds (3,).
        eye_height: z inside the room from which to look for the ceiling, such as that of the cameras.
    """
    extent = high - low
    size = 0.2 * float(min(extent[0], extent[1]))
    margin = 0.03 * float(extent[2])
    center = 0.5 * (low + high)
    best: tuple[float, float] | None = None
    place = np.array([center[0], center[1], high[2] - margin])
    for dx in np.linspace(-0.2, 0.2, 5):
        for dy in np.linspace(-0.2, 0.2, 5):
            x, y = center[0] + dx * extent[0], center[1] + dy * extent[1]
            ceiling = _lowest_above(cast, x, y, eye_height, 0.5 * size, high[2])
            # A ceiling lower by a tenth of the room's height weighs more than the distance to a corner.
            rank = (ceiling / float(extent[2]) - 0.2 * float(np.hypot(dx, dy)), -float(np.hypot(dx, dy)))
            if best is None or rank > best:
                best, place = rank, np.array([x, y, ceiling - margin])
    return place, size


def _lowest_above(cast: Cast, x: float, y: float, z: float, half: float, highest: float) -> float:
    """The lowest z above a square of half side `half`; `highest` where a ray meets nothing."""
    heights = []
    for sx in (-half, 0.0, half):
        for sy in (-half, 0.0, half):
            hit = cast(np.array([x + sx, y + sy, z]), _UP)
            heights.append(highest if hit is None else float(hit[0][2]))
    return min(heights)


def room_light_power(median_radiance: float, low: np.ndarray, high: np.ndarray) -> float:
    """Watts of a light that makes a room about as bright as in its photographs.

    A room of albedo 1/2 whose surfaces, of area A, have radiosity πL absorbs the power Φ = A π L. A is taken
    from the room's bounds.

    Args:
        median_radiance: L, the median of the photographs, W/(m² sr).
        low, high: the room's bounds (3,).
    """
    x, y, z = (float(value) for value in high - low)
    return 2.0 * (x * y + y * z + z * x) * float(np.pi) * median_radiance
