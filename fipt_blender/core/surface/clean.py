"""The cleaned copy of a scan: the same triangles with noise taken out, planes made planar, smooth normals.

A mesh that is not rough everywhere, as modelled ones never are, is left as it is.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import identity

from ..robust import MAD_TO_DEVIATION
from ..run.run_files import Geometry
from .adjacency import NONE, Mesh, face_vectors, make_mesh
from .normals import corner_normals, filter_normals, follow_normals
from .patches import find_patches, triangle_moments
from .planes import PATCH_EDGES, PlaneRegions, find_planes

# A scan is rough everywhere: this share of its area ...
_ROUGH_SHARE = 0.75
# ... deviates from a smooth fit by more than this share of its edges. The flattest quarter of the area
# reaches 0.010 in a scan with voxels of 2 cm, and 0.001 in modelled rooms.
_ROUGHNESS = 0.004
# A scan has at least so many triangles.
_MIN_TRIANGLES = 2000
# Angles between neighbouring triangles that count as noise, as a multiple of their median.
_NOISE_ANGLES = 2.5
# Rounds of the filter before the planes are known; a few, because noise is averaged over patches then.
_FIRST_ROUNDS, _ROUNDS = 10, 20
# Distance that a vertex may move, in units of the noise.
_REACH = 6.0
# Cosine of the largest angle over which shading normals are interpolated (30 degrees).
_CREASE = 0.866
# Weight of a vertex's own place against planes that meet at it.
_PLACE_WEIGHT = 1e-3
# A vertex is smooth if the mean of the unit normals around it is longer than this; at others the fit would
# measure a crease.
_SMOOTH = 0.8
# Vertices that are drawn; more would change the median by less than one percent.
_SAMPLE = 40_000


def noise_level(mesh: Mesh, normals: np.ndarray, areas: np.ndarray) -> tuple[float, float]:
    """Noise of a mesh and the width of patches on it, in metres; the noise is 0 for a mesh that is no scan.

    The noise is the flatness of the median patch: most surfaces of a room are flat at the size of a patch.

    Args:
        normals: (T, 3) unit normals. areas: (T,).
    """
    if len(areas) < _MIN_TRIANGLES:
        return 0.0, 0.0
    deviation, edge = bumps(mesh, normals, areas, np.random.default_rng(0))
    if not len(edge) or not np.quantile(deviation / edge, 1.0 - _ROUGH_SHARE) > _ROUGHNESS:
        return 0.0, 0.0
    size = PATCH_EDGES * float(np.median(edge))
    patch, count = find_patches(mesh, normals, size)
    patches = triangle_moments(mesh, areas).grouped(patch, count)
    flatness = patches.planes().deviation
    order = np.argsort(flatness)
    half = np.searchsorted(np.cumsum(patches.area[order]), 0.5 * patches.area.sum())
    return max(float(flatness[order][half]), MAD_TO_DEVIATION * float(np.median(deviation))), size


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


def clean_mesh(vertices: np.ndarray, triangles: np.ndarray) -> Geometry | None:
    """The cleaned copy of a scan, None for a mesh that is no scan.

    Args:
        vertices: (V, 3) float32, metres.
        triangles: (T, 3) int.
    """
    mesh, welded = make_mesh(vertices, triangles)
    normals, areas = face_vectors(mesh.vertices, mesh.triangles)
    noise, size = noise_level(mesh, normals, areas)
    if noise <= 0.0:
        return None
    deviation = _NOISE_ANGLES * typical_angle(mesh, normals, areas)
    smooth = filter_normals(normals, areas, mesh.neighbours, deviation, _FIRST_ROUNDS)
    regions = find_planes(mesh, smooth, size, noise)
    flat = regions.label != NONE
    smooth[flat] = regions.parallel[regions.label[flat]]
    smooth = filter_normals(smooth, areas, mesh.neighbours, deviation, _ROUNDS, held=flat)
    planar, on_plane = flattened(mesh, regions, _REACH * noise)
    moved = Mesh(follow_normals(planar, smooth, _REACH * noise, on_plane), mesh.triangles)
    return Geometry(
        moved.vertices[welded].astype(np.float32),
        corner_normals(moved, smooth, _CREASE),
        regions.label.astype(np.int32),
        noise,
    )


def typical_angle(mesh: Mesh, normals: np.ndarray, areas: np.ndarray) -> float:
    """Median angle in radians between triangles that share an edge, weighted by their area."""
    pairs = mesh.dual_edges
    cosine = np.einsum("ec,ec->e", normals[pairs[:, 0]], normals[pairs[:, 1]])
    weight = areas[pairs].min(axis=1)
    order = np.argsort(-cosine)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(np.arccos(np.clip(cosine[order][half], -1.0, 1.0)))


def flattened(mesh: Mesh, regions: PlaneRegions, reach: float) -> tuple[Mesh, np.ndarray]:
    """The mesh with the vertices of planes on them, on their intersection where several meet.

    Args:
        reach: metres by which a vertex may move.

    Returns:
        the mesh, and (V,) bool, vertices on a plane.
    """
    triangle = np.flatnonzero(regions.label != NONE)
    count = len(regions.planes.normal)
    key = mesh.triangles[triangle] * max(count, 1) + regions.label[triangle][:, None]
    vertex, plane = np.divmod(np.unique(key), max(count, 1))
    normal = regions.planes.normal[plane]
    pull = -regions.planes.distance(plane, mesh.vertices[vertex])[:, None] * normal
    used, first = np.unique(vertex, return_index=True)
    if not len(used):
        return mesh, np.zeros(len(mesh.vertices), bool)
    matrix = np.add.reduceat(normal[:, :, None] * normal[:, None, :], first)
    wanted = np.add.reduceat(pull, first)
    shift = np.linalg.solve(matrix + _PLACE_WEIGHT * np.eye(3), wanted[:, :, None])[:, :, 0]
    length = np.linalg.norm(shift, axis=1, keepdims=True)
    vertices = mesh.vertices.copy()
    vertices[used] += shift * np.minimum(1.0, reach / np.maximum(length, 1e-20))
    on_plane = np.zeros(len(vertices), bool)
    on_plane[used] = True
    return Mesh(vertices, mesh.triangles), on_plane
