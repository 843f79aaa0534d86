"""Segments of a scan, which is one connected piece: its planes, and smooth pieces between creases.

Where no masks exist they take the place of the connected pieces of a modelled room.
"""

from __future__ import annotations

import numpy as np

from ..pixels.grouped import pairs_of, strongest
from ..surface.adjacency import Mesh
from ..surface.scan import averaged_normals
from .components import graph_components

# Least area of a segment, in areas of the median triangle.
LEAST_SIZE = 100.0
# Angle (radians) between normals at which smooth pieces end, and rings over which normals are averaged.
CREASE = 0.3
RINGS = 3


def scan_segments(mesh: Mesh, cross: np.ndarray, plane: np.ndarray | None) -> np.ndarray:
    """(T,) int64 segment of each triangle, numbered from 0.

    Args:
        cross: (T, 3) normals with the areas as lengths.
        plane: (T,) int plane of each triangle, negative without; None where planes are unknown.
    """
    area = np.linalg.norm(cross, axis=1)
    normals = averaged_normals(mesh, cross, RINGS)
    segment = np.full(len(cross), -1) if plane is None else plane
    one, other = mesh.dual_edges.T
    smooth = (normals[one] * normals[other]).sum(axis=1) > np.cos(CREASE)
    joined = (segment[one] == segment[other]) & ((segment[one] >= 0) | smooth)
    component = graph_components(mesh.dual_edges[joined], len(mesh.triangles))
    return absorb_small(component, mesh, area, LEAST_SIZE * float(np.median(area)))


def absorb_small(component: np.ndarray, mesh: Mesh, area: np.ndarray, least: float) -> np.ndarray:
    """(T,) int64 components from 0, of which small ones have joined the neighbor with the longest border.

    Args:
        component: (T,) int64 from 0. area: (T,). least: area of a component that stays.
    """
    while True:
        count = int(component.max(initial=-1)) + 1
        size = np.bincount(component, area, minlength=count)
        pairs = component[mesh.dual_edges]
        border = pairs[:, 0] != pairs[:, 1]
        # Each border counts for both sides: from the smaller component into the larger one.
        one, other = pairs[border].T
        low = np.where((size[one] < size[other]) | ((size[one] == size[other]) & (one < other)), one, other)
        high = one + other - low
        wanted = size[low] < least
        if not wanted.any():
            return component
        small, large, place = pairs_of(low[wanted], high[wanted])
        length = np.bincount(place, mesh.dual_lengths[border][wanted])
        joined = strongest(small, large, length, count, "high")
        joins = np.flatnonzero(joined >= 0)
        component = graph_components(np.stack([joins, joined[joins]], axis=1), count)[component]
