"""Low-pass filtering along surfaces, within parts: a grid of cells in space, one a part (J. Chen et al. 2007,
"Real-time edge-aware image processing with the bilateral grid").

Values are spread to the eight nearest nodes of the grid and read back from them by trilinear weights, which
convolves them with a smooth kernel about two cells wide. It needs no charts: seams of an atlas do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_STRIDE = 1 << 15  # more than the nodes along an axis
_PARTS = 1 << 18  # more than the parts
_BLOCK = 1 << 20  # points at a time


@dataclass(frozen=True)
class SmoothingGrid:
    """Nodes of a grid on the surfaces where points are.

    Attributes:
        width: of a cell, metres.
        low: (3,) corner of the grid.
        cell: (N,) int32 cell of each point.
        nodes: (cells, 8) int32 its nodes.
        keys: (nodes,) int64 of the nodes, ascending; the same in grids of one width and corner.
    """

    width: float
    low: np.ndarray
    cell: np.ndarray
    nodes: np.ndarray
    keys: np.ndarray

    @classmethod
    def around(
        cls,
        position: np.ndarray,
        part: np.ndarray,
        triangle: np.ndarray,
        width: float,
        low: np.ndarray | None = None,
    ) -> SmoothingGrid:
        """The grid for points.

        Args:
            position: (N, 3) metres.
            part: (T,) int part of each triangle, from -1.
            triangle: (N,) int triangle of each point.
            width: of a cell, metres.
            low: (3,) corner of the grid, below all points; None for one below these points.
        """
        if low is None:
            low = position.min(axis=0).astype(np.float64) - width
        blocks = _blocks(len(position))

        def keys_of(block: slice) -> np.ndarray:
            place = np.floor((position[block] - low) / width).astype(np.int64)
            return _key(place, part[triangle[block]])

        keys = np.unique(np.concatenate([np.unique(keys_of(block)) for block in blocks]))
        cell = np.empty(len(position), np.int32)
        for block in blocks:
            cell[block] = np.searchsorted(keys, keys_of(block))
        steps = (_CORNERS[:, 0] * _STRIDE + _CORNERS[:, 1]) * _STRIDE + _CORNERS[:, 2]
        node_keys, nodes = np.unique(keys[:, None] + steps, return_inverse=True)
        return cls(width, low, cell, nodes.reshape(len(keys), 8).astype(np.int32), node_keys)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """(nodes, 3) positions, metres, and (nodes,) int parts of the nodes."""
        rest, z = np.divmod(self.keys, _STRIDE)
        rest, y = np.divmod(rest, _STRIDE)
        part, x = np.divmod(rest, _STRIDE)
        return self.low + self.width * np.stack([x, y, z], axis=1), part - 1

    def weights(self, position: np.ndarray) -> np.ndarray:
        """(n, 8) float32 trilinear weights of points at the nodes of their cells."""
        inside = (position - self.low) / self.width
        inside = (inside - np.floor(inside)).astype(np.float32)[:, None]
        return np.where(_CORNERS == 1, inside, 1.0 - inside).prod(axis=2)

    def spread(
        self, rows: np.ndarray, position: np.ndarray, weight: np.ndarray, values: np.ndarray
    ) -> np.ndarray:
        """(nodes, C + 1) sums of the weighted values (n, C) at the nodes, then of the weights.

        Args:
            rows: (n,) which of the grid's points they are.
            position: (n, 3) metres.
            weight: (n,) at least 0.
        """
        sums = np.zeros((len(self.keys), values.shape[1] + 1))
        for block in _blocks(len(rows)):
            nodes, share = self.nodes[self.cell[rows[block]]], self.weights(position[block])
            share = share * weight[block, None]
            for corner in range(8):
                for channel in range(values.shape[1]):
                    spread = share[:, corner] * values[block, channel]
                    sums[:, channel] += np.bincount(nodes[:, corner], spread, len(self.keys))
                sums[:, -1] += np.bincount(nodes[:, corner], share[:, corner], len(self.keys))
        return sums

    def read(self, rows: np.ndarray, position: np.ndarray, sums: np.ndarray) -> np.ndarray:
        """(n, C) float32 sums (nodes, C) between the nodes; points as in :meth:`spread`."""
        result = np.zeros((len(rows), sums.shape[1]), np.float32)
        for block in _blocks(len(rows)):
            nodes, share = self.nodes[self.cell[rows[block]]], self.weights(position[block])
            for corner in range(8):
                result[block] += share[:, corner, None] * sums[nodes[:, corner]]
        return result

    def smooth(
        self, rows: np.ndarray, position: np.ndarray, weight: np.ndarray, values: np.ndarray
    ) -> np.ndarray:
        """(n, C) float32 weighted local means of values (n, C) at the same points, 0 where no weight is near.

        Sums are read, then divided: a node with little weight near it counts little.
        """
        read = self.read(rows, position, self.spread(rows, position, weight, values))
        return read[:, :-1] / np.maximum(read[:, -1:], 1e-30)


def _blocks(count: int) -> list[slice]:
    return [slice(first, first + _BLOCK) for first in range(0, count, _BLOCK)]


def _key(place: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(n,) int64 key of cells (n, 3) of parts (n,)."""
    number = (part.astype(np.int64) + 1) % _PARTS  # so that keys fit into 64 bits
    return ((number * _STRIDE + place[:, 0]) * _STRIDE + place[:, 1]) * _STRIDE + place[:, 2]
