"""UV islands as plain arrays: finding, measuring, rotating and cutting them."""

from __future__ import annotations

import numpy as np
from mathutils.geometry import box_fit_2d

# Islands that fill less of their bounding box than this are cut, unless the box is small anyway.
MIN_FILL = 0.4
MIN_SPLIT_TEXELS = 4096


def connected_triangles(corners: np.ndarray) -> np.ndarray:
    """Connected components of triangles that share corner ids.

    Args:
        corners: (T,3) integer ids.

    Returns:
        (T,) i32 component of each triangle, numbered from 0 in the order of their first triangles.
    """
    if not len(corners):
        return np.zeros(0, np.int32)
    _, ids = np.unique(corners, return_inverse=True)
    ids = ids.reshape(-1, 3)
    label = np.arange(ids.max() + 1)
    while True:
        lowest = label[ids].min(axis=1)
        lower = label.copy()
        for corner in range(3):
            np.minimum.at(lower, ids[:, corner], lowest)
            # A label is the id of a corner of the same component: labelling that one too doubles the reach.
            np.minimum.at(lower, label[ids[:, corner]], lowest)
        lower = lower[lower]
        if np.array_equal(lower, label):
            break
        label = lower
    _, first, component = np.unique(label[ids[:, 0]], return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[component]


def uv_islands(vertex_ids: np.ndarray, corner_uv: np.ndarray) -> np.ndarray:
    """Islands of triangles that share a vertex at the same UV position.

    Args:
        vertex_ids: (T,3) vertex indices.
        corner_uv: (T,3,2).

    Returns:
        (T,) i32 island of each triangle.
    """
    keys = np.empty((corner_uv.shape[0] * 3, 3), np.int64)
    keys[:, 0] = vertex_ids.ravel()
    keys[:, 1:] = np.round(corner_uv.reshape(-1, 2).astype(np.float64) * 1e6)
    order = np.lexsort(keys.T)
    differs = np.any(np.diff(keys[order], axis=0) != 0, axis=1)
    ids = np.empty(len(keys), np.int64)
    ids[order] = np.concatenate([[0], np.cumsum(differs)]) if len(keys) else 0
    return connected_triangles(ids.reshape(-1, 3))


def island_bounds(corner_uv: np.ndarray, island: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest corners and extents of islands, each (N,D) f64, of the triangles' corners (T,3,D)."""
    count = int(island.max()) + 1 if len(island) else 0
    low = np.full((count, corner_uv.shape[2]), np.inf)
    high = np.full((count, corner_uv.shape[2]), -np.inf)
    order, starts = _grouped(island)
    present = island[order[starts]]
    for axis in range(corner_uv.shape[2]):
        first, second, third = corner_uv[..., axis].T
        lowest = np.minimum(np.minimum(first, second), third)
        highest = np.maximum(np.maximum(first, second), third)
        if len(order):
            low[present, axis] = np.minimum.reduceat(lowest[order], starts)
            high[present, axis] = np.maximum.reduceat(highest[order], starts)
    return low, high - low


def _grouped(island: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Order (N,) that sorts by island, and where each island starts in it."""
    order = np.argsort(island, kind="stable")
    sorted_island = island[order]
    starts = np.flatnonzero(np.concatenate([[True], sorted_island[1:] != sorted_island[:-1]])[: len(order)])
    return order, starts


def rotate_islands(corner_uv: np.ndarray, island: np.ndarray) -> np.ndarray:
    """Rotate each island so that its bounding box is small and wider than high, (T,3,2) f64.

    Args:
        corner_uv: (T,3,2).
        island: (T,) of `uv_islands`.
    """
    low, extent = island_bounds(corner_uv, island)
    order, starts = _grouped(island)
    centered = corner_uv - (low + 0.5 * extent)[island][:, None]  # Blender computes in single precision
    angle = np.zeros(len(extent))
    for rows in np.split(order, starts[1:]) if len(order) else []:
        angle[island[rows[0]]] = box_fit_2d(centered[rows].reshape(-1, 2).tolist())
    rotated = _rotate(corner_uv, angle[island])
    # Rotate only where that gains something.
    useless = island_bounds(rotated, island)[1].prod(axis=1) > 0.98 * extent.prod(axis=1)
    rotated = np.where(useless[island][:, None, None], corner_uv, rotated)
    extent = island_bounds(rotated, island)[1]
    upright = extent[:, 1] > extent[:, 0]
    return _rotate(rotated, np.where(upright, 0.5 * np.pi, 0.0)[island])


def _rotate(corner_uv: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u, v = corner_uv[..., 0], corner_uv[..., 1]
    return np.stack([cosine * u - sine * v, sine * u + cosine * v], axis=-1)


def split_islands(corners: np.ndarray, island: np.ndarray, polygon: np.ndarray, longest: float) -> np.ndarray:
    """Cut islands that leave most of their bounding box empty (mouldings, rings, frames), or that are longer
    than an image, into pieces.

    Cuts run between polygons, halfway along the box's longer side. They are invisible, since the baked
    fields are functions of space.

    Args:
        corners: (T,3,2) texels.
        island: (T,).
        polygon: (T,) ids; a polygon's triangles stay together.
        longest: side of an image, texels.

    Returns:
        (T,) i64 islands, renumbered from 0.
    """
    area = triangle_areas(corners)
    polygon = renumbered(polygon)
    triangle_count = np.bincount(polygon)
    centre = np.stack(
        [np.bincount(polygon, corners[..., axis].mean(axis=1)) / triangle_count for axis in range(2)], axis=1
    )[polygon]
    island = island.astype(np.int64)
    for _ in range(8):
        low, extent = island_bounds(corners, island)
        box = extent.prod(axis=1)
        sparse = (box > MIN_SPLIT_TEXELS) & (np.bincount(island, area) < MIN_FILL * box)
        cut = sparse | (extent.max(axis=1, initial=0.0) > longest)
        if not cut.any():
            break
        axis = extent.argmax(axis=1)[island]
        centre_line = (low + 0.5 * extent)[island]
        beyond = np.take_along_axis(centre > centre_line, axis[:, None], axis=1)[:, 0]
        island = renumbered(island * 2 + (beyond & cut[island]))
    return island


def renumbered(ids: np.ndarray) -> np.ndarray:
    """The ids (N,), none of them negative, numbered from 0 without gaps in the same order, (N,) i64."""
    present = np.zeros(int(ids.max(initial=-1)) + 1, bool)
    present[ids] = True
    return (np.cumsum(present) - 1)[ids]


def triangle_areas(corners: np.ndarray) -> np.ndarray:
    """Areas of triangles in the plane or in space, (T,) f64 from (T,3,2) or (T,3,3)."""
    corners = corners.astype(np.float64)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if corners.shape[2] == 2:
        return 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return 0.5 * np.linalg.norm(np.cross(first, second), axis=1)
