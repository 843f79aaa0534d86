# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which photographs are compared with each other: all pairs of few, near ones and a coarse net of many.

Standard library only.
"""

from __future__ import annotations

from itertools import combinations

MOST_EXHAUSTIVE = 100  # photographs: 4,950 pairs, half an hour on one core


def image_pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of photographs in the order in which they were taken.

    Up to `MOST_EXHAUSTIVE` photographs, these are all pairs. Beyond, each photograph is compared with the
    next ones, with those at distances of powers of two, and a coarse net with itself, so that a walk around
    a room that ends where it began is closed.

    Args:
        count: number of photographs.

    Returns:
        Sorted pairs (first, second) with first < second, without repetition.
    """
    if count <= MOST_EXHAUSTIVE:
        return list(combinations(range(count), 2))
    steps = set(range(1, 11))  # each is compared with the next ten
    steps |= {2**power for power in range(count.bit_length()) if 2**power < count // 2}
    near = {(first, first + step) for step in steps for first in range(count - step)}
    # Every eighth is compared with all others of that net, which closes loops.
    return sorted(near | set(combinations(range(0, count, 8), 2)))
