# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The resolution at which light is solved, and what an estimation at it costs. Standard library only."""

from __future__ import annotations

import math
from collections.abc import Sequence

# Fewer pixels than these show too little of a room for one view to be of use: then fewer views are taken.
LEAST_PIXELS = 10_000


def light_size(sizes: Sequence[tuple[int, int]], light_pixels: float) -> list[tuple[int, int]]:
    """Width and height of each view at the resolution of light.

    All views get the same largest number of pixels; those that have fewer keep their size. Where the budget
    suffices, all do.

    Args:
        sizes: width and height of each view in pixels.
        light_pixels: the budget, millions of pixels of all views together.
    """
    areas = [width * height for width, height in sizes]
    most = _even_share(areas, light_pixels * 1e6)
    result = []
    for (width, height), area in zip(sizes, areas, strict=True):
        factor = math.sqrt(most / area) if area > most else 1.0
        result.append((max(1, int(width * factor)), max(1, int(height * factor))))
    return result


def light_views_count(sizes: Sequence[tuple[int, int]], light_pixels: float) -> int:
    """How many of the views the budget can serve with `LEAST_PIXELS` each, or all pixels of smaller ones.

    Args:
        sizes, light_pixels: as of :func:`light_size`.
    """
    least = sum(min(width * height, LEAST_PIXELS) for width, height in sizes)
    if least <= light_pixels * 1e6:
        return len(sizes)
    return max(1, int(len(sizes) * light_pixels * 1e6 / least))


def _even_share(areas: Sequence[int], budget: float) -> float:
    """The limit of areas at which their sum is the budget; infinite where the sum is below."""
    if sum(areas) <= budget:
        return math.inf
    left, count = budget, len(areas)
    for area in sorted(areas):
        if area * count >= left:
            break
        left, count = left - area, count - 1
    return left / count
