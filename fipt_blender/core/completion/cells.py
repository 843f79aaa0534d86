# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces in rows of about square cells, of which any can be meshed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..surface.adjacency import without_unused


@dataclass(frozen=True, eq=False)
class CellSurface:
    """A surface by the corners of its cells. Seen from its front, columns run to the left of rising rows.

    Attributes:
        places: (R + 1, S + 1, 3) metres.
        normals: (R + 1, S + 1, 3) unit normals of its front.
        step: edge of a cell, metres.
        around: whether its last corners are the first ones again.
    """

    places: np.ndarray
    normals: np.ndarray
    step: float
    around: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.places.shape[0] - 1, self.places.shape[1] - 1

    def near(self, points: np.ndarray, distance: float) -> np.ndarray:
        """(N,) bool, whether points (N, 3) are about so many metres from the surface or closer."""
        reach = float(np.hypot(distance, self.step / np.sqrt(2.0)))
        away, _ = cKDTree(self.places.reshape(-1, 3)).query(points, distance_upper_bound=reach)
        return np.isfinite(away)

    def cells(self, down: float = 0.0, across: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Places (R, S, 3) in the cells and unit normals (R, S, 3) of their fronts.

        Args:
            down, across: where, in cells from their middles.
        """
        v, u = 0.5 + down, 0.5 + across
        places, normals = (
            (1.0 - v) * ((1.0 - u) * each[:-1, :-1] + u * each[:-1, 1:])
            + v * ((1.0 - u) * each[1:, :-1] + u * each[1:, 1:])
            for each in (self.places, self.normals)
        )
        return places, normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)

    def surface(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The mesh of some cells (R, S) bool.

        Returns:
            vertices (V, 3) float32, triangles (T, 3) int32, and corner normals (T, 3, 3) float32.
        """
        columns = self.shape[1] + (not self.around)
        row, column = np.nonzero(chosen)
        corners = [(row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)]
        index = np.stack([down * columns + across % columns for down, across in corners], axis=1)
        used, triangles = without_unused(index[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
        places, normals = (each[:, :columns].reshape(-1, 3)[used] for each in (self.places, self.normals))
        return places.astype(np.float32), triangles, normals[triangles].astype(np.float32)
