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
    vertex_label = np.full(int(triangles.max(initial=-1)) + 1, NO_PART, np.int64)
    ring, left = np.flatnonzero(labels >= 0), np.flatnonzero(labels < 0)
    while len(ring):
        np.maximum.at(vertex_label, triangles[ring].reshape(-1), np.repeat(labels[ring], 3))
        found = vertex_label[triangles[left]].max(axis=1)
        ring = left[found >= 0]
        labels[ring] = found[found >= 0]
        left = left[found < 0]
    return labels
