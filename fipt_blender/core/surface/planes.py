"""The planes of a scan: regions of triangles that are flat but for the scan's noise.

Regions grow over patches, which average the noise, and are then extended triangle by triangle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from .adjacency import NONE, Mesh, face_vectors
from .patches import Moments, Planes, find_patches, triangle_moments

# Distances from a plane in units of the noise: of patches that belong to it (means of many triangles), and of
# triangles.
PATCH_REACH, TRIANGLE_REACH = 2.0, 3.5
# Cosines of the largest angle to a plane: of patches (10 degrees) and of triangles (45 degrees).
PATCH_COSINE, TRIANGLE_COSINE = 0.985, 0.7
# The flatness of a patch that starts or joins a plane, in units of the noise.
FLAT = 2.0
# Patches of a plane, at least.
MIN_PATCHES = 4
# A plane follows one that is larger by this factor, and that has the area of so many patches.
LARGER, GUIDE_PATCHES = 2.0, 20.0
# Width of patches, in edges of the mesh.
PATCH_EDGES = 5.0
# Rounds by which a plane grows over triangles beyond its patches.
TRIANGLE_ROUNDS = 12


@dataclass(frozen=True)
class PlaneRegions:
    """Planes and the triangles on them.

    Attributes:
        label: (T,) int64 plane of each triangle, NONE without one.
        planes: of the labels; normals on the triangles' side.
        parallel: (G, 3) normals for shading: those of the planes, or of larger planes that are as parallel
            to them as the scan can show.
    """

    label: np.ndarray
    planes: Planes
    parallel: np.ndarray


def find_planes(mesh: Mesh, normals: np.ndarray, size: float, noise: float) -> PlaneRegions:
    """The planes of a mesh.

    Args:
        normals: (T, 3) unit normals of the triangles, filtered.
        size: width of a patch, metres.
        noise: standard deviation of the distance from the true surface, metres.
    """
    areas = face_vectors(mesh.vertices, mesh.triangles)[1]
    moments = triangle_moments(mesh, areas)
    patch, count = find_patches(mesh, normals, size)
    patches = moments.grouped(patch, count)
    region = _grow(patches, _mean_normals(normals, areas, patch, count), _touching(mesh, patch, count), noise)
    label = np.where(region >= 0, region, NONE)[patch]
    found = int(region.max(initial=-1)) + 1
    for _ in range(2):
        planes = moments.grouped(label, found).planes().turned(_mean_normals(normals, areas, label, found))
        label = _on_plane(mesh, normals, label, planes, noise)
        label = _extended(mesh, normals, label, planes, noise)
    planes = moments.grouped(label, found).planes().turned(_mean_normals(normals, areas, label, found))
    area = moments.grouped(label, found).area
    return PlaneRegions(label, planes, parallel_normals(planes, area, size / PATCH_EDGES))


def parallel_normals(planes: Planes, area: np.ndarray, step: float) -> np.ndarray:
    """(G, 3) normals of planes, with those of larger planes where the tilt between them is not resolved.

    A scanner blurs steps: the panels of a door, which are parallel to its frame, become slopes. Furniture and
    walls have few directions, so that a tilt by less than one step of the mesh over the width of a plane is
    taken for such an error.

    Args:
        area: (G,) of the planes.
        step: metres, length of the mesh's edges.
    """
    result = planes.normal.copy()
    guide = GUIDE_PATCHES * (PATCH_EDGES * step) ** 2
    order = np.argsort(-area, kind="stable")
    resolved = np.cos(np.arctan(step / np.maximum(planes.width, step)))
    for rank, plane in enumerate(order):
        larger = order[:rank][area[order[:rank]] >= np.maximum(LARGER * area[plane], guide)]
        cosine = result[larger] @ planes.normal[plane]
        near = np.flatnonzero(np.abs(cosine) > resolved[plane])
        if len(near):
            result[plane] = np.sign(cosine[near[0]]) * result[larger[near[0]]]
    return result


def _mean_normals(normals: np.ndarray, areas: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) sums of normals times area; negative groups do not count."""
    known = group >= 0
    weighted = normals[known] * areas[known, None]
    return np.stack([np.bincount(group[known], column, count) for column in weighted.T], axis=1)


def _touching(mesh: Mesh, patch: np.ndarray, count: int) -> csr_array:
    """(count, count) sparse bool: patches that have an edge in common."""
    pairs = patch[mesh.dual_edges]
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
    graph = csr_array((np.ones(len(rows), bool), (rows, columns)), (count, count))
    graph.sum_duplicates()
    return graph


def _grow(patches: Moments, facing: np.ndarray, touching: csr_array, noise: float) -> np.ndarray:
    """(P,) int64 plane of each patch, NONE without one.

    Args:
        facing: (P, 3) mean normal of each patch, of any length.
        touching: (P, P) neighbours.
    """
    own = patches.planes().turned(facing)
    flat = own.deviation < FLAT * noise
    region = np.full(len(flat), NONE, np.int64)
    number = 0
    for seed in _seeds(own, patches.area, flat, touching, noise):
        if region[seed] != NONE:
            continue
        members = _region_of(seed, patches, own, flat & (region == NONE), touching, noise)
        if len(members) >= MIN_PATCHES:
            region[members] = number
            number += 1
    return region


def _seeds(
    own: Planes, area: np.ndarray, flat: np.ndarray, touching: csr_array, noise: float
) -> Iterator[int]:
    """Patches to start planes at: those with most area around them on their own plane come first."""
    rows = np.repeat(np.arange(len(area)), np.diff(touching.indptr))
    columns = touching.indices
    near = np.abs(own.distance(rows, own.centre[columns])) < PATCH_REACH * noise
    near &= np.einsum("nc,nc->n", own.normal[rows], own.normal[columns]) > PATCH_COSINE
    near &= flat[rows] & flat[columns]
    around = np.bincount(rows[near], area[columns[near]], len(area))
    order = np.argsort(-(around + area), kind="stable")
    yield from (int(seed) for seed in order if flat[seed] and around[seed] > 0.0)


def _region_of(
    seed: int, patches: Moments, own: Planes, free: np.ndarray, touching: csr_array, noise: float
) -> np.ndarray:
    """(K,) patches of the plane that grows from one patch.

    Args:
        free: (P,) bool, patches that may join.
    """
    inside = np.zeros(len(free), bool)
    inside[seed] = True
    members = front = np.array([seed])
    normal, centre = own.normal[seed], own.centre[seed]
    while len(front):
        candidates = np.unique(np.concatenate([_row(touching, patch) for patch in front]))
        candidates = candidates[free[candidates] & ~inside[candidates]]
        near = np.abs((own.centre[candidates] - centre) @ normal) < PATCH_REACH * noise
        front = candidates[near & (own.normal[candidates] @ normal > PATCH_COSINE)]
        inside[front] = True
        members = np.concatenate([members, front])
        plane = patches.total(members).planes()
        normal, centre = plane.normal[0] * np.sign(plane.normal[0] @ normal), plane.centre[0]
    return members


def _row(graph: csr_array, row: int) -> np.ndarray:
    return graph.indices[graph.indptr[row] : graph.indptr[row + 1]]


def _fits(
    mesh: Mesh, normals: np.ndarray, triangle: np.ndarray, plane: np.ndarray, planes: Planes, noise: float
) -> np.ndarray:
    """(N,) bool, whether the triangles (N,) lie on the planes of index (N,) and face their side."""
    fits = np.einsum("nc,nc->n", normals[triangle], planes.normal[plane]) > TRIANGLE_COSINE
    for corner in range(3):
        points = mesh.vertices[mesh.triangles[triangle, corner]]
        fits &= np.abs(planes.distance(plane, points)) < TRIANGLE_REACH * noise
    return fits


def _on_plane(mesh: Mesh, normals: np.ndarray, label: np.ndarray, planes: Planes, noise: float) -> np.ndarray:
    """The labels without those triangles that do not lie on their plane."""
    triangle = np.flatnonzero(label != NONE)
    fits = _fits(mesh, normals, triangle, label[triangle], planes, noise)
    result = label.copy()
    result[triangle[~fits]] = NONE
    return result


def _extended(mesh: Mesh, normals: np.ndarray, label: np.ndarray, planes: Planes, noise: float) -> np.ndarray:
    """The labels, with triangles beside each plane that lie on it as well."""
    label = label.copy()
    for _ in range(TRIANGLE_ROUNDS):
        open_ones = np.flatnonzero(label == NONE)
        near = mesh.neighbours[open_ones]
        offered = np.where(near == NONE, NONE, label[near])
        grown = False
        for side in range(3):
            some = np.flatnonzero((offered[:, side] != NONE) & (label[open_ones] == NONE))
            fits = _fits(mesh, normals, open_ones[some], offered[some, side], planes, noise)
            label[open_ones[some[fits]]] = offered[some[fits], side]
            grown |= bool(fits.any())
        if not grown:
            break
    return label
