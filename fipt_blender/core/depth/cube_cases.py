# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The triangles of marching cubes (Lorensen and Cline 1987) for each of the 256 sign patterns of a cell.

They are derived, not tabulated: on each face of the cell, crossings are joined around runs of corners behind
the surface. As neighbours join those of their common face in the same way, the surface has no gaps.
"""

from __future__ import annotations

from functools import cache

import numpy as np

# Corner c of a cell is at (c & 1, c >> 1 & 1, c >> 2 & 1). Edges: axis and lower corner.
EDGES = [(axis, corner) for axis in range(3) for corner in range(8) if not corner >> axis & 1]
_EDGE_NUMBER = {
    frozenset((corner, corner | 1 << axis)): number for number, (axis, corner) in enumerate(EDGES)
}


def _faces() -> list[list[int]]:
    """The corners of each face of a cell, counter-clockwise seen from outside."""
    faces = []
    for axis in range(3):
        first, second = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        around = [0, first, first | second, second]
        faces.append([corner | 1 << axis for corner in around])
        faces.append(around[::-1])
    return faces


def _loops(case: int) -> list[list[int]]:
    """Closed loops of crossed edges of a pattern; bit c of `case`: corner c is behind the surface."""
    following: dict[int, int] = {}
    for face in _faces():
        behind = [bool(case >> corner & 1) for corner in face]
        for start in range(4):
            if behind[start] or not behind[(start + 1) % 4]:
                continue
            entry = _EDGE_NUMBER[frozenset((face[start], face[(start + 1) % 4]))]
            place = (start + 1) % 4
            while behind[(place + 1) % 4]:
                place = (place + 1) % 4
            leaving = _EDGE_NUMBER[frozenset((face[place], face[(place + 1) % 4]))]
            following[entry] = leaving
    loops = []
    while following:
        edge = next(iter(following))
        loop = []
        while edge in following:
            loop.append(edge)
            edge = following.pop(edge)
        loops.append(loop)
    return loops


@cache
def triangle_table() -> tuple[np.ndarray, np.ndarray]:
    """Number of triangles (256,) and their edges (256, T, 3) int64 of each pattern, filled up with zeros.

    Triangles are counter-clockwise seen from in front of the surface.
    """
    cases = []
    for case in range(256):
        fans = [[loop[0], loop[i], loop[i + 1]] for loop in _loops(case) for i in range(1, len(loop) - 1)]
        cases.append(fans)
    most = max(len(fans) for fans in cases)
    table = np.zeros((256, most, 3), np.int64)
    for case, fans in enumerate(cases):
        table[case, : len(fans)] = np.array(fans, np.int64).reshape(-1, 3)
    return np.array([len(fans) for fans in cases]), table
