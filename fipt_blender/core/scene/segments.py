# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Segments of a scan, which is one connected piece: planes, and smooth pieces between creases.

Where no masks exist they take the place of the connected pieces of a modelled room.
"""

from __future__ import annotations

import numpy as np

from .adjacency import Adjacency, averaged_normals
from .components import graph_components

# A segment has at least so many median triangles' area.
LEAST_SIZE = 100.0
MOST_PLANES = 64
# Triangles lie in a plane if their centers are within so many median edges of it, and the angle of their
# averaged normal is less than that of this cosine.
FLATNESS = 1.0
ALONG = 0.85
# Half the opening angle (cosine) within which normals count for one direction, and cells of the directions
# along each edge of a cube's face.
SAME_DIRECTION = 0.97
DIRECTIONS = 12
# Angle (radians) between averaged normals at which smooth pieces end.
CREASE = 0.3
RINGS = 3


def scan_segments(adjacency: Adjacency, centers: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """(T,) int64 segment of each triangle, numbered from 0.

    Args:
        centers: (T, 3) metres.
        cross: (T, 3) normals with the areas as lengths.
    """
    area = np.linalg.norm(cross, axis=1)
    normals = averaged_normals(adjacency, cross, RINGS)
    least = LEAST_SIZE * float(np.median(area))
    segment = _planes(adjacency, centers, normals, area, least)
    one, other = adjacency.pairs.T
    smooth = (normals[one] * normals[other]).sum(axis=1) > np.cos(CREASE)
    joined = (segment[one] == segment[other]) & ((segment[one] >= 0) | smooth)
    component = graph_components(adjacency.pairs[joined], adjacency.count)
    return absorb_small(component, adjacency, area, least)


def _planes(
    adjacency: Adjacency, centers: np.ndarray, normals: np.ndarray, area: np.ndarray, least: float
) -> np.ndarray:
    """(T,) int64 plane of each triangle, -1 outside of planes; the largest planes come first."""
    tolerance = FLATNESS * float(np.median(adjacency.length))
    direction = _direction_cells(normals)
    plane = np.full(len(area), -1, np.int64)
    open_area = area.copy()  # zero where a plane was found, or none can be
    for number in range(MOST_PLANES):
        sums = np.bincount(direction, open_area)
        if not sums.max(initial=0.0) > least:
            break
        cell = int(sums.argmax())
        in_cell = (direction == cell) & (open_area > 0.0)
        inside = _fit_plane(in_cell, centers, normals, open_area, tolerance)
        kept = _large_components(adjacency, inside & (plane < 0), area, least)
        if kept.any():
            plane[kept] = number
            open_area[kept] = 0.0
        else:
            open_area[in_cell] = 0.0
    return plane


def _fit_plane(
    seed: np.ndarray, centers: np.ndarray, normals: np.ndarray, weight: np.ndarray, tolerance: float
) -> np.ndarray:
    """(T,) bool, triangles of the largest plane among those whose normals agree with the seed's.

    Args:
        seed: (T,) bool, triangles of about one direction.
        weight: (T,) area that counts.
    """
    axis = weight[seed] @ normals[seed]
    axis /= max(float(np.linalg.norm(axis)), 1e-30)
    inside = np.zeros(len(seed), bool)
    for _ in range(3):
        near = np.flatnonzero((normals @ axis > SAME_DIRECTION) & (weight > 0.0))
        if not len(near):
            return inside
        height = centers[near] @ axis
        bins = np.floor((height - height.min()) / tolerance).astype(np.int64)
        window = np.convolve(np.bincount(bins, weight[near]), [1.0, 1.0], "same")
        first = max(int(window.argmax()) - 1, 0)
        chosen = near[(bins >= first) & (bins <= first + 1)]
        middle = np.average(centers[chosen], axis=0, weights=weight[chosen])
        spread = (centers[chosen] - middle) * np.sqrt(weight[chosen])[:, None]
        fitted = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        axis = fitted if fitted @ axis > 0.0 else -fitted
        inside = (np.abs((centers - middle) @ axis) < tolerance) & (normals @ axis > ALONG) & (weight > 0.0)
    return inside


def _direction_cells(normals: np.ndarray) -> np.ndarray:
    """(T,) int64 cell of each unit normal on the faces of a cube."""
    axis = np.abs(normals).argmax(axis=1)
    rows = np.arange(len(normals))
    major = normals[rows, axis]
    face = 2 * axis + (major < 0.0)
    size = np.maximum(np.abs(major), 1e-30)
    u, v = (normals[rows, (axis + step) % 3] / size for step in (1, 2))
    # Cells are centred on the axes, along which most walls lie.
    a, b = (np.round((each + 1.0) / 2.0 * DIRECTIONS).astype(np.int64) for each in (u, v))
    return (face * (DIRECTIONS + 1) + a) * (DIRECTIONS + 1) + b


def _large_components(adjacency: Adjacency, inside: np.ndarray, area: np.ndarray, least: float) -> np.ndarray:
    """(T,) bool, the triangles of those marked whose connected component has the least area."""
    rows = np.flatnonzero(inside)
    place = np.full(len(inside), -1, np.int64)
    place[rows] = np.arange(len(rows))
    pairs = place[adjacency.pairs]
    component = graph_components(pairs[(pairs >= 0).all(axis=1)], len(rows))
    large = np.zeros(len(inside), bool)
    large[rows] = (np.bincount(component, area[rows]) >= least)[component] if len(rows) else False
    return large


def absorb_small(component: np.ndarray, adjacency: Adjacency, area: np.ndarray, least: float) -> np.ndarray:
    """(T,) int64 components from 0, of which small ones have joined the neighbor with the longest border.

    Args:
        component: (T,) int64 from 0. area: (T,). least: area of a component that stays.
    """
    while True:
        count = int(component.max(initial=-1)) + 1
        size = np.bincount(component, area, minlength=count)
        pairs = component[adjacency.pairs]
        border = pairs[:, 0] != pairs[:, 1]
        # Each border counts for both sides: from the smaller component into the larger one.
        one, other = pairs[border].T
        low = np.where((size[one] < size[other]) | ((size[one] == size[other]) & (one < other)), one, other)
        high = one + other - low
        wanted = size[low] < least
        if not wanted.any():
            return component
        keys, place = np.unique(low[wanted] * count + high[wanted], return_inverse=True)
        length = np.bincount(place, adjacency.length[border][wanted])
        order = np.argsort(length, kind="stable")
        joins = np.arange(count)
        joins[keys[order] // count] = keys[order] % count
        component = graph_components(np.stack([np.arange(count), joins], axis=1), count)[component]
