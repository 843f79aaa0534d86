# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels of triangles that no pixel saw: those of their neighbours."""

from __future__ import annotations

import numpy as np

NO_PART = -1  # in place of a part


def spread_labels(labels: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Give triangles without a label the highest label of their neighbours, ring by ring.

    Args:
        labels: (T,) int, negative for none.
        triangles: (T, 3) welded vertex indices; triangles that share a vertex are neighbours.

    Returns:
        (T,) int64, negative where no triangle of the connected piece has a label.
    """
    labels = labels.astype(np.int64).copy()
    # The triangles around each vertex, concatenated over the vertices.
    around = np.argsort(triangles, axis=None, kind="stable") // 3
    count = np.bincount(triangles.reshape(-1))
    first = np.cumsum(count) - count
    vertex_label = np.full(len(count), NO_PART, np.int64)
    ring = np.flatnonzero(labels >= 0)
    while len(ring):
        corners = triangles[ring].reshape(-1)
        np.maximum.at(vertex_label, corners, np.repeat(labels[ring], 3))
        touched = np.unique(corners)
        # Rows of `around`: count[touched] of them, starting at first[touched].
        ends = np.cumsum(count[touched])
        rows = np.arange(ends[-1]) + np.repeat(first[touched] + count[touched] - ends, count[touched])
        neighbours = around[rows]
        ring = np.unique(neighbours[labels[neighbours] < 0])
        labels[ring] = vertex_label[triangles[ring]].max(axis=1)
    return labels
