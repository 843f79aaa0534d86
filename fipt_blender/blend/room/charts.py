# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Unwraps scans by charts: pieces of a welded, noisy mesh that face one way, projected onto a plane each.

A scan's triangles are as small as texels and tilted by noise: unwrapped by the angles between them, nearly
every one would be a chart. Here a smoothed copy of the surface is cut and projected. Numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...bridge.step import Slices
from .islands import renumbered

# A mesh of at least so many triangles whose area is spread evenly over them is a scan: the mean area of a
# triangle, weighted by area, over the plain mean is about 2 for marching cubes, and hundreds for modelled
# rooms, whose walls are a few triangles.
LEAST_TRIANGLES = 20_000
MOST_UNEVEN = 50.0
_BORDER_WEIGHT = 0.15  # of a neighbour with the same direction, in cosines
_MERGE_ANGLE = np.cos(np.radians(25.0))  # directions closer than this become one
_STEEPEST = np.cos(np.radians(75.0))  # to which a triangle may face away from its chart
# Pieces of fewer triangles, or with more edges at their border for each triangle, are shared out.
SMALL = 48
_THIN = 0.25  # four squares of two triangles wide


@dataclass(frozen=True)
class Charts:
    """An unwrapped mesh.

    Attributes:
        uv: (T,3,2) f64 metres; each chart in a plane of its own.
        chart: (T,) i64, from 0 without gaps.
    """

    uv: np.ndarray
    chart: np.ndarray


@dataclass(frozen=True)
class _Surface:
    """The smoothed mesh.

    Attributes:
        corners: (T,3) vertex of each corner.
        points: (V,3) smoothed positions.
        beside: (T,3) triangle beyond each edge, -1 for none.
        normals: (T,3) unit normals, smoothed further.
        areas: (T,) m².
        edge: mean length of an edge, m.
        first: (T,) first triangle of the same polygon.
    """

    corners: np.ndarray
    points: np.ndarray
    beside: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    edge: float
    first: np.ndarray


def is_scan(areas: np.ndarray) -> bool:
    """Whether a mesh with triangles of these areas (T,) looks like a scan: many, and evenly sized."""
    total = float(areas.sum())
    if len(areas) < LEAST_TRIANGLES or total <= 0.0:
        return False
    return float((areas * areas).sum()) * len(areas) < MOST_UNEVEN * total * total


def chart_slices(
    vertices: np.ndarray, triangles: np.ndarray, polygon: np.ndarray, longest: float = np.inf
) -> Slices[Charts]:
    """Unwrap a welded mesh by charts, in slices. The result depends on nothing but the arguments.

    Args:
        vertices: (V,3) world, m.
        triangles: (T,3) vertex indices.
        polygon: (T,) ids; a polygon's triangles are neighbours in the list and stay in one chart.
        longest: charts that are longer are cut, m.
    """
    surface = yield from _smoothed(vertices, triangles, polygon)
    directions = main_directions(surface.normals, surface.areas)
    yield None
    label = np.argmax(surface.normals @ directions.T, axis=1)[surface.first]
    label = yield from _straighten(surface, label, directions)
    label = yield from _merge_small(surface, label, directions)
    chart = _pieces(surface, label)
    yield None
    uv, depth = _projected(surface, chart)
    yield None
    layer = _layers(uv, depth, chart, surface.edge)[surface.first]
    if layer.any():
        chart = _pieces(surface, _numbered(chart, layer))
        uv, _ = _projected(surface, chart)
    yield None
    chart = _cut(uv, chart, longest, surface.first)
    chart = _loosen_flipped(uv, chart, surface)
    yield None
    return Charts(_projected(surface, chart)[0], chart)


def neighbours(triangles: np.ndarray) -> np.ndarray:
    """(T,3) triangle beyond the edge from each corner to the next, -1 where there is none."""
    count = int(triangles.max(initial=-1)) + 1
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)]).reshape(2, -1).astype(np.int64)
    key = ends.min(axis=0) * count + ends.max(axis=0)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    beside = np.full(len(key), -1, np.int64)
    beside[order[same]] = order[same + 1] // 3
    beside[order[same + 1]] = order[same] // 3
    return beside.reshape(-1, 3)


def components(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Connected components of a graph, numbered from 0 in the order of their first nodes.

    Args:
        count: number of nodes, N.
        first, second: (E,) the ends of each edge.

    Returns:
        (N,) i64.
    """
    root = np.arange(count)
    while len(first):
        low, high = np.minimum(root[first], root[second]), np.maximum(root[first], root[second])
        open_edges = np.flatnonzero(low != high)
        if not len(open_edges):
            break
        first, second = first[open_edges], second[open_edges]
        np.minimum.at(root, high[open_edges], low[open_edges])
        while True:
            further = root[root]
            if np.array_equal(further, root):
                break
            root = further
    return renumbered(root)


def main_directions(normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Directions (D,3) that the surface mostly faces: 26 even ones, moved to the means of what is nearest.

    Large planes thus get directions of their own; directions that meet become one.

    Args:
        normals: (T,3) unit.
        areas: (T,).
    """
    steps = np.array([-1.0, 0.0, 1.0])
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[np.abs(grid).sum(axis=1) > 0.0]
    directions = grid / np.linalg.norm(grid, axis=1, keepdims=True)
    # Means over small cells of directions stand for the triangles.
    cells = np.round((normals + 1.0) * 31.5).astype(np.int64) @ np.array([4096, 64, 1])
    _, cell = np.unique(cells, return_inverse=True)
    sums = np.stack([np.bincount(cell, areas * normals[:, axis]) for axis in range(3)], axis=1)
    for _ in range(10):
        nearest = np.argmax(sums @ directions.T, axis=1)
        moved = np.stack([np.bincount(nearest, sums[:, axis], len(directions)) for axis in range(3)], axis=1)
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        heavy = np.argsort(-length[:, 0], kind="stable")
        heavy = heavy[length[heavy, 0] > 1e-9 * areas.sum()]
        moved = moved[heavy] / length[heavy]
        kept: list[np.ndarray] = []
        for direction in moved:
            if all(direction @ other < _MERGE_ANGLE for other in kept):
                kept.append(direction)
        directions = np.array(kept).reshape(-1, 3) if kept else directions
    return directions


def _smoothed(vertices: np.ndarray, triangles: np.ndarray, polygon: np.ndarray) -> Slices[_Surface]:
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    corners = (np.cumsum(used) - 1)[triangles]
    points = vertices[used].astype(np.float64)
    edge = float(np.linalg.norm(points[corners] - points[np.roll(corners, -1, axis=1)], axis=2).mean())
    beside = neighbours(corners)
    yield None
    points = yield from _smooth_positions(points, corners, beside, edge)
    cross = np.cross(
        points[corners[:, 1]] - points[corners[:, 0]], points[corners[:, 2]] - points[corners[:, 0]]
    )
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    yield None
    normals = yield from _smooth_normals(cross, corners, len(points))
    starts = np.flatnonzero(np.concatenate([[True], polygon[1:] != polygon[:-1]]))
    first = np.repeat(starts, np.diff(np.append(starts, len(polygon))))
    return _Surface(corners, points, beside, normals, areas, edge, first)


def _smooth_positions(
    points: np.ndarray, corners: np.ndarray, beside: np.ndarray, edge: float
) -> Slices[np.ndarray]:
    """Vertices moved towards the means of their neighbours, by an edge's length at most; holes don't grow."""
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    degree = np.maximum(np.bincount(start, minlength=len(points)), 1)
    weight = np.full(len(points), 0.5)
    at_hole = beside < 0
    weight[corners[at_hole]] = weight[np.roll(corners, -1, axis=1)[at_hole]] = 0.0
    moved = points
    for _ in range(6):  # noise of a scan is independent from one triangle to the third next
        mean = [np.bincount(start, moved[end, axis], len(points)) / degree for axis in range(3)]
        moved = moved + weight[:, None] * (np.stack(mean, axis=1) - moved)
        yield None
    shift = moved - points
    length = np.linalg.norm(shift, axis=1, keepdims=True)
    return points + shift * np.minimum(edge / np.maximum(length, 1e-30), 1.0)


def _smooth_normals(cross: np.ndarray, corners: np.ndarray, count: int) -> Slices[np.ndarray]:
    """Unit normals (T,3), averaged over vertices and back to triangles a few times."""
    normals = cross
    for _ in range(6):
        sums = np.zeros((count, 3))
        for corner in range(3):
            for axis in range(3):
                sums[:, axis] += np.bincount(corners[:, corner], normals[:, axis], count)
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
        normals = sums[corners[:, 0]] + sums[corners[:, 1]] + sums[corners[:, 2]]
        yield None
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-20, normals / np.maximum(length, 1e-20), [0.0, 0.0, 1.0])


def _straighten(surface: _Surface, label: np.ndarray, directions: np.ndarray) -> Slices[np.ndarray]:
    """Directions (T,) of triangles at borders, chosen anew by how they face and by their neighbours."""
    for _ in range(12):
        yield None
        around = np.where(surface.beside >= 0, label[surface.beside], label[:, None])
        border = np.flatnonzero((around != label[:, None]).any(axis=1))
        if not len(border):
            break
        around, own = around[border], label[border]
        best, chosen = np.full(len(border), -np.inf), own
        for candidate in (own, *around.T):
            fit = np.einsum("nc,nc->n", surface.normals[border], directions[candidate])
            fit += _BORDER_WEIGHT * (around == candidate[:, None]).sum(axis=1)
            fit[np.einsum("nc,nc->n", surface.normals[border], directions[candidate]) < _STEEPEST] -= 2.0
            better = fit > best + 1e-9
            best, chosen = np.where(better, fit, best), np.where(better, candidate, chosen)
        label = label.copy()
        label[border] = chosen
        label = label[surface.first]
        if np.array_equal(label[border], own):
            break
    return label


def _pieces(surface: _Surface, label: np.ndarray) -> np.ndarray:
    """Connected pieces (T,) of triangles with the same label."""
    triangle = np.repeat(np.arange(len(label)), 3)
    other = surface.beside.ravel()
    inner = (other > triangle) & (label[triangle] == label[other])
    joined = np.flatnonzero(surface.first != np.arange(len(label)))  # the triangles of a polygon
    first = np.concatenate([triangle[inner], joined])
    second = np.concatenate([other[inner], surface.first[joined]])
    return components(len(label), first, second)


def _merge_small(surface: _Surface, label: np.ndarray, directions: np.ndarray) -> Slices[np.ndarray]:
    """Triangles of small or thin pieces take the best of the directions of larger pieces beside theirs."""
    for _ in range(4):
        yield None
        piece = _pieces(surface, label)
        size = np.bincount(piece)
        triangle = np.repeat(np.arange(len(label)), 3)
        other = surface.beside.ravel()
        border = np.flatnonzero((other >= 0) & (piece[triangle] != piece[other]))
        triangle, other = triangle[border], other[border]
        small = (size < SMALL) | (np.bincount(piece[triangle], minlength=len(size)) > _THIN * size)
        pair = small[piece[triangle]] & (size[piece[other]] > size[piece[triangle]])
        row = renumbered(piece[triangle[pair]])
        offered = np.zeros((int(row.max(initial=-1)) + 1, len(directions)), bool)
        offered[row, label[other[pair]]] = True
        row_of = np.full(len(size), -1)
        row_of[piece[triangle[pair]]] = row
        inside = np.flatnonzero(row_of[piece] >= 0)
        if not len(inside):
            break
        facing = surface.normals[inside] @ directions.T
        facing[~offered[row_of[piece[inside]]]] = _STEEPEST
        best = facing.argmax(axis=1)
        found = facing[np.arange(len(inside)), best] > _STEEPEST
        label = label.copy()
        label[inside[found]] = best[found]
        label = label[surface.first]
    return label


def _projected(surface: _Surface, chart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners on the planes of their charts, (T,3,2), and heights of the triangles above these, (T,)."""
    count = int(chart.max(initial=-1)) + 1
    weighted = surface.normals * np.maximum(surface.areas, 1e-30)[:, None]
    sums = np.stack([np.bincount(chart, weighted[:, axis], count) for axis in range(3)], axis=1)
    normal = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
    # A horizontal first axis keeps walls upright.
    first = np.stack([-normal[:, 1], normal[:, 0], np.zeros(count)], axis=1)
    flat = np.linalg.norm(first, axis=1) < 1e-3
    first[flat] = [1.0, 0.0, 0.0]
    first -= normal * np.einsum("nc,nc->n", first, normal)[:, None]
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(normal, first)
    uv = np.empty((len(chart), 3, 2))
    depth = np.zeros(len(chart))
    for corner in range(3):
        point = surface.points[surface.corners[:, corner]]
        uv[:, corner, 0] = np.einsum("nc,nc->n", point, first[chart])
        uv[:, corner, 1] = np.einsum("nc,nc->n", point, second[chart])
        depth += np.einsum("nc,nc->n", point, normal[chart]) / 3.0
    return uv, depth


def _layers(uv: np.ndarray, depth: np.ndarray, chart: np.ndarray, edge: float) -> np.ndarray:
    """Sheet (T,) of a chart on which each triangle lies, from 0: sheets above each other must be cut apart.

    Within squares of two edges' length, a gap in height of five edges' lengths separates two sheets; a single
    sheet that is 75 degrees steep has none.
    """
    square = np.floor(uv.mean(axis=1) / (2.0 * edge)).astype(np.int64)
    square -= square.min(axis=0)
    key = (chart * (square[:, 0].max() + 1) + square[:, 0]) * (square[:, 1].max() + 1) + square[:, 1]
    order = np.lexsort((depth, key))
    same = key[order[1:]] == key[order[:-1]]
    gap = np.concatenate([[0], np.cumsum(same & (np.diff(depth[order]) > 5.0 * edge))])
    start = np.concatenate([[True], ~same])
    layer = np.empty(len(chart), np.int64)
    layer[order] = gap - gap[start][np.cumsum(start) - 1]
    return layer


def _cut(uv: np.ndarray, chart: np.ndarray, longest: float, first: np.ndarray) -> np.ndarray:
    """Cut charts that are longer than `longest` into even pieces."""
    if not np.isfinite(longest):
        return chart
    count = int(chart.max(initial=-1)) + 1
    centre = uv.mean(axis=1)[first]
    for axis in range(2):
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(low, chart, centre[:, axis])
        np.maximum.at(high, chart, centre[:, axis])
        parts = np.maximum(np.ceil((high - low) / longest), 1.0)
        width = np.maximum((high - low) / parts, 1e-30)
        place = np.minimum((centre[:, axis] - low[chart]) // width[chart], parts[chart] - 1.0)
        chart = _numbered(chart, place.astype(np.int64))
        count = int(chart.max(initial=-1)) + 1
    return chart


def _loosen_flipped(uv: np.ndarray, chart: np.ndarray, surface: _Surface) -> np.ndarray:
    """Polygons that lie face down in their chart, or nearly on edge, become charts of their own."""
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    flipped = area < 0.02 * surface.areas
    loose = np.zeros(len(chart), bool)
    loose[surface.first[flipped]] = True
    loose = loose[surface.first]
    return _numbered(chart, np.where(loose, surface.first + 1, 0))


def _numbered(chart: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Charts numbered anew, a number for each pair of chart and part."""
    if not part.any():
        return chart
    return np.unique(chart * (int(part.max()) + 1) + part, return_inverse=True)[1]
