# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms as a scanner leaves them: one welded mesh of small triangles, with noise."""

import numpy as np

from fipt_blender.core.surface.adjacency import weld
from fipt_blender.core.surface.room import Room
from samples.small_rooms import BOX, mesh_room


def scanned_box(cells: int = 30, noise: float = 0.005, seed: int = 0) -> tuple[Room, np.ndarray]:
    """The box of small_rooms in one piece, each side a grid of cells, and (T,) the side of each triangle.

    Args:
        cells: along each edge; a side has twice their square as triangles.
        noise: standard deviation of the vertices' positions, metres.
    """
    grid = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=-1).reshape(-1, 4)
    u, v = np.meshgrid(*2 * [np.linspace(0.0, 1.0, cells + 1)], indexing="ij")
    sides = []
    for corners in np.array(BOX, float):
        across, up = corners[1] - corners[0], corners[3] - corners[0]
        sides.append(corners[0] + u.ravel()[:, None] * across + v.ravel()[:, None] * up)
    points = np.concatenate(sides)
    triangles = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    every = np.concatenate([triangles + side * len(u.ravel()) for side in range(6)])
    welded = weld(points.astype(np.float32))
    vertices = np.zeros((int(welded.max()) + 1, 3))
    vertices[welded] = points
    vertices += np.random.default_rng(seed).normal(0.0, noise, vertices.shape)
    room = mesh_room(vertices, welded[every], np.zeros(len(every)), parts="masks")
    return room, np.repeat(np.arange(6), len(triangles))
