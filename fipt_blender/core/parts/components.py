"""Connected components of graphs and of triangle meshes."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def graph_components(pairs: np.ndarray, count: int) -> np.ndarray:
    """Connected components of an undirected graph.

    Args:
        pairs: (E, 2) int nodes that an edge connects; repeated edges and loops do no harm.
        count: number of nodes.

    Returns:
        (count,) int64 component of each node, numbered from 0 in the order of their lowest nodes.
    """
    if not count:
        return np.zeros(0, np.int64)
    edges = np.ones(len(pairs), bool)
    graph = coo_array((edges, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def component_means(
    areas: np.ndarray, component: np.ndarray, values: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """(T,) mean of the known values of each triangle's component by area, 0 where none is known.

    Args:
        areas: (T,) square metres. component: (T,) int from 0.
        values: (T,) any where they are not known. known: (T,) bool.
    """
    total = np.bincount(component, areas * known)
    mean = np.bincount(component, areas * np.where(known, values, 0)) / np.maximum(total, 1e-30)
    return np.asarray(mean[component])


def mesh_components(corners: np.ndarray) -> np.ndarray:
    """Connected components of a triangle mesh.

    Args:
        corners: (T, 3) int welded vertex indices; triangles that share a vertex are connected.

    Returns:
        (T,) int64 component of each triangle, numbered from 0 in the order of their lowest vertices.
    """
    edges = np.concatenate([corners[:, :2], corners[:, 1:]])
    component = graph_components(edges, int(corners.max(initial=-1)) + 1)[corners[:, 0]]
    return np.unique(component, return_inverse=True)[1].reshape(-1)
