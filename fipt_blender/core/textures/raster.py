"""Rasterisation of triangles in the plane of an image, with barycentric coordinates.

Numpy only: Blender's side uses it to judge UVs, the engine to bake. Texel (column i, row j) has its centre at
(i + 0.5, j + 0.5); row 0 is at v = 0, so that rows run upwards like V.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

# Candidate texels per chunk, which limits the memory of a chunk to about 0.5 GB.
CHUNK_TEXELS = 2_000_000
# Texels by which texels outside a triangle are near: one that is thinner than a texel is not lost.
REACH = 0.75
_SLACK = 0.01  # texels; more than any rounding error of the tests below


def covered_texels(
    corners: np.ndarray, width: int, height: int, reach: float = 0.0
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Texels whose centre lies inside a triangle, or within `reach` texels of it.

    Args:
        corners: (T,3,2) positions in texels.
        width, height: of the image in texels.
        reach: distance in texels up to which texels outside a triangle count; with 0.75 the result is
            conservative (a triangle thinner than a texel is never lost).

    Yields:
        Chunks of (texel (M,) i64 flat index row * width + column, triangle (M,) i64,
        barycentric (M,3) f32 of the nearest point of the triangle, distance (M,) f32 in texels).
        A texel is listed once for each triangle that covers it.
    """
    corners = np.asarray(corners, np.float64)
    # Centres exactly on the border of a triangle count as inside, hence the slack.
    lowest = np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])  # faster than along an axis
    highest = np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])
    low = np.ceil(lowest - 0.5 - reach - _SLACK).astype(np.int64)
    high = np.floor(highest - 0.5 + reach + _SLACK).astype(np.int64) + 1
    low = np.clip(low, 0, (width, height))
    high = np.clip(high, 0, (width, height))
    extent = np.maximum(high - low, 0)
    count = extent[:, 0] * extent[:, 1]
    for first, last in _chunks(count):
        yield from _cover(corners[first:last], low[first:last], extent[first:last], first, width, reach)


def _chunks(count: np.ndarray) -> Iterator[tuple[int, int]]:
    ends = np.cumsum(count)
    first = 0
    while first < len(count):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + CHUNK_TEXELS, side="right")), first + 1)
        yield first, last
        first = last


def _cover(
    corners: np.ndarray, low: np.ndarray, extent: np.ndarray, offset: int, width: int, reach: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    count = extent[:, 0] * extent[:, 1]
    if not count.any():
        return

    def spread(values: np.ndarray) -> np.ndarray:
        """Repeat values per triangle for the texels of its box; much faster than indexing."""
        return np.repeat(values, count)

    within = np.arange(count.sum()) - spread(np.cumsum(count) - count)
    columns = spread(extent[:, 0])
    row = within // columns
    column = within - row * columns + spread(low[:, 0])
    row += spread(low[:, 1])
    x, y = column + 0.5, row + 0.5

    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2)
    doubled_area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    sign = np.where(doubled_area < 0.0, -1.0, 1.0)
    # Signed distance of the texel from each edge's line times the edge's length, positive inside.
    keep = np.ones(len(within), bool)
    inside = spread(np.abs(doubled_area) > 1e-12)
    for corner in range(3):
        (start_x, start_y), (edge_x, edge_y) = corners[:, corner].T, sign * edges[:, corner].T
        area = spread(edge_x) * (y - spread(start_y)) - spread(edge_y) * (x - spread(start_x))
        keep &= area >= spread(-(reach + 1e-9) * lengths[:, corner] - 1e-12)
        inside &= area >= -1e-9
    keep &= inside | (reach > 0.0)
    kept = np.flatnonzero(keep)
    triangle, inside = spread(np.arange(len(corners)))[kept], inside[kept]
    point = np.stack([x[kept], y[kept]], axis=1)
    texel = (row * width + column)[kept]

    barycentric = np.empty((len(triangle), 3))
    distance = np.zeros(len(triangle))
    inner = np.flatnonzero(inside)
    barycentric[inner] = _barycentric(corners[triangle[inner]], point[inner], doubled_area[triangle[inner]])
    outer = np.flatnonzero(~inside)
    if len(outer):
        barycentric[outer], distance[outer] = _nearest_on_border(corners[triangle[outer]], point[outer])
        near = distance <= reach
        texel, triangle, barycentric, distance = (
            texel[near],
            triangle[near],
            barycentric[near],
            distance[near],
        )
    yield texel, triangle + offset, barycentric.astype(np.float32), distance.astype(np.float32)


def _barycentric(corners: np.ndarray, point: np.ndarray, doubled_area: np.ndarray) -> np.ndarray:
    weights = np.empty((len(point), 3))
    for corner in range(3):
        start = corners[:, (corner + 1) % 3]
        edge = corners[:, (corner + 2) % 3] - start
        to_point = point - start
        weights[:, corner] = (edge[:, 0] * to_point[:, 1] - edge[:, 1] * to_point[:, 0]) / doubled_area
    weights = np.clip(weights, 0.0, 1.0)
    return weights / weights.sum(axis=1, keepdims=True)


def _nearest_on_border(corners: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    best = np.full(len(point), np.inf)
    weights = np.zeros((len(point), 3))
    for corner in range(3):
        start, end = corners[:, corner], corners[:, (corner + 1) % 3]
        edge = end - start
        edge_x, edge_y = edge.T
        off_x, off_y = (point - start).T
        length2 = np.maximum(edge_x * edge_x + edge_y * edge_y, 1e-30)
        along = np.clip((off_x * edge_x + off_y * edge_y) / length2, 0.0, 1.0)
        away_x, away_y = (start + along[:, None] * edge - point).T
        distance = np.sqrt(away_x * away_x + away_y * away_y)
        closer = distance < best
        best = np.where(closer, distance, best)
        weights[closer] = 0.0
        weights[closer, corner] = 1.0 - along[closer]
        weights[closer, (corner + 1) % 3] = along[closer]
    return weights, best


def nearest_triangle_map(
    corners: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each texel near a triangle, the nearest triangle and the point on it.

    Args:
        corners: (T,3,2) positions in texels.
        width, height: of the image.

    Returns:
        texel (M,) i64 flat indices, sorted and unique; triangle (M,) i64; barycentric (M,3) f32.
        Ties go to the triangle with the lowest index, so that the result does not depend on chunking.
    """
    best_distance = np.full(width * height, np.inf, np.float32)
    best_triangle = np.full(width * height, -1, np.int64)
    best_weights = np.zeros((width * height, 3), np.float32)
    for texel, triangle, weights, distance in covered_texels(corners, width, height, REACH):
        closer = np.flatnonzero(distance < best_distance[texel])
        texel, distance = texel[closer], distance[closer]
        np.minimum.at(best_distance, texel, distance)
        # Triangles are in order: written backwards, the lowest of equally near ones stays.
        nearest = np.flatnonzero(distance == best_distance[texel])[::-1]
        best_triangle[texel[nearest]] = triangle[closer[nearest]]
        best_weights[texel[nearest]] = weights[closer[nearest]]
    texel = np.flatnonzero(best_triangle >= 0)
    return texel, best_triangle[texel], best_weights[texel]


def cover_count(corners: np.ndarray, width: int, height: int) -> np.ndarray:
    """Number of triangles that cover each texel's centre, (height, width) i32.

    Triangles are shrunk by a thousandth of a texel, so that a centre on a shared edge does not count twice.
    """
    corners = np.asarray(corners, np.float64)
    centre = corners.mean(axis=1, keepdims=True)
    offset = corners - centre
    size = np.linalg.norm(offset, axis=2, keepdims=True)
    shrunk = centre + offset * np.maximum(1.0 - 1e-3 / np.maximum(size, 1e-12), 0.0)
    count = np.zeros(width * height, np.int32)
    for texel, _, _, _ in covered_texels(shrunk, width, height):
        np.add.at(count, texel, 1)
    return count.reshape(height, width)
