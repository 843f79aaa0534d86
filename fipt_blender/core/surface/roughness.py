# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How rough a mesh is against its own smooth fit: the noise of a scan, and 0 for modelled meshes."""

from __future__ import annotations

import numpy as np
from scipy.sparse import identity

from .adjacency import Mesh

# A vertex is smooth if the mean of the unit normals around it is longer than this; at others the fit would
# measure a crease.
_SMOOTH = 0.8
# Vertices that are drawn; more would change the median by less than one percent.
_SAMPLE = 40_000


def bumps(
    mesh: Mesh, normals: np.ndarray, areas: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Deviation of vertices, drawn by area, from a smooth fit of their surroundings.

    The fit is the umbrella operator applied twice: constant curvature leaves no deviation, and neither does
    any sliding of vertices within the surface.

    Args:
        normals: (T, 3) unit normals. areas: (T,).

    Returns:
        (N,) float64 standard deviation in metres of a noise that would make the vertex's deviation, 0 at
        creases, and (N,) mean length of the edges at the vertex; empty for a mesh without area.
    """
    weighted = mesh.around @ (normals * areas[:, None])
    area = mesh.around @ areas
    if not area.sum() > 0.0:
        return np.zeros(0), np.zeros(0)
    drawn = np.sort(rng.choice(len(area), _SAMPLE, p=area / area.sum()))
    umbrella = mesh.ring - identity(len(area), format="csr")
    twice = umbrella[drawn] @ umbrella
    norm = np.sqrt(twice.power(2).sum(axis=1))
    length = np.linalg.norm(weighted[drawn], axis=1)
    normal = weighted[drawn] / np.maximum(length, 1e-30)[:, None]
    deviation = np.abs(((twice @ mesh.vertices) * normal).sum(axis=1)) / np.maximum(norm, 1e-12)
    deviation[length < _SMOOTH * area[drawn]] = 0.0
    first, second = mesh.vertices[mesh.triangles], mesh.vertices[np.roll(mesh.triangles, -1, axis=1)]
    edges = np.linalg.norm(first - second, axis=2).mean(axis=1)
    return deviation, (mesh.around @ (edges * areas))[drawn] / area[drawn]
