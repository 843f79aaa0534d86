# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Upright prisms over a footprint of cells, as meshes of triangles of about a cell.

They stand for things that a scanner did not see.
"""

from __future__ import annotations

import numpy as np

from ..surface.adjacency import without_unused

# Rounds that take the steps of the cells out of a footprint's border.
_ROUNDS = 6


def prism(
    inside: np.ndarray, corner: np.ndarray, cell: float, layers: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The closed surface of a prism.

    Args:
        inside: (X, Y) bool, cells of the footprint.
        corner: (3,) lowest corner of cell (0, 0), metres.
        cell: edge of a cell, and height of a layer, metres.
        layers: its height in layers, at least 1.

    Returns:
        vertices (V, 3) float32, triangles (T, 3) int32 with fronts outwards, and corner normals (T, 3, 3).
    """
    places = np.argwhere(inside)[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]]
    used, index = np.unique(places.reshape(-1, 2), axis=0, return_inverse=True)
    cells = index.reshape(-1, 4)
    border = _border(cells)
    outline = _smoothed(used.astype(np.float64), border)
    flat = cells[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    count = len(used)
    levels = np.repeat(np.arange(layers + 1), count)[:, None]
    vertices = corner + cell * np.concatenate([np.tile(outline, (layers + 1, 1)), levels], axis=1)
    low = (np.arange(layers)[:, None, None] * count + border).reshape(-1, 2)
    quads = np.concatenate([low, low[:, ::-1] + count], axis=1)
    walls = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    outward = _outward(outline, border)
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(flat), 3, 3))
    triangles = np.concatenate([flat[:, ::-1], flat + layers * count, walls])
    normals = np.concatenate([-up, up, outward[walls % count]])
    used, triangles = without_unused(triangles)
    return vertices[used].astype(np.float32), triangles, normals.astype(np.float32)


def _border(cells: np.ndarray) -> np.ndarray:
    """(E, 2) directed edges of cells (N, 4), counter-clockwise, that only one cell has."""
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    size = int(edges.max()) + 1
    return edges[~np.isin(edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0])]


def _smoothed(places: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Places (V, 2) with those of the border (E, 2) between their neighbours along it."""
    on = np.bincount(border.reshape(-1), minlength=len(places))[:, None]
    for _ in range(_ROUNDS):
        total = np.zeros_like(places)
        np.add.at(total, border[:, 0], places[border[:, 1]])
        np.add.at(total, border[:, 1], places[border[:, 0]])
        places = np.where(on > 0, 0.5 * places + 0.5 * total / np.maximum(on, 1), places)
    return places


def _outward(places: np.ndarray, border: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals of the walls over the border, zero off it."""
    along = places[border[:, 1]] - places[border[:, 0]]
    normal = np.zeros((len(places), 3))
    for end in (0, 1):
        np.add.at(normal, border[:, end], np.stack([along[:, 1], -along[:, 0], 0.0 * along[:, 0]], axis=1))
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))
