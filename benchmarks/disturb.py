"""A disturbed copy of a room's mesh, similar to a reconstruction: smooth noise, smooth normals, one object.

It replaces the paper's estimated geometry (Sec. 5.4, Table 4): `disturb_obj(source, target, sigma)`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

# Ratio of the bumps' width to their height; slopes are changed by about 6 degrees.
BUMP_WIDTH = 10.0
_WAVES = 64


def disturb_obj(source: Path, target: Path, sigma: float, seed: int = 0) -> None:
    """Write a disturbed copy of an OBJ file that contains only positions, smooth normals and triangles.

    Args:
        sigma: standard deviation of the displacement along each axis, in the file's units.
        seed: of the noise.
    """
    vertices, triangles = read_obj(source)
    vertices, triangles = disturb(vertices, triangles, sigma, seed)
    normals = smooth_normals(vertices, triangles)
    with target.open("w", encoding="utf-8") as file:
        file.write("o disturbed\n")
        np.savetxt(file, vertices, "v %.6f %.6f %.6f")
        np.savetxt(file, normals, "vn %.4f %.4f %.4f")
        np.savetxt(file, np.repeat(triangles + 1, 2, axis=1), "f %d//%d %d//%d %d//%d")


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) float64 positions and (T, 3) int64 triangles of an OBJ file; polygons become fans."""
    vertices: list[list[float]] = []
    triangles: list[list[int]] = []
    with path.open(encoding="utf-8") as file:
        for line in file:
            kind, _, rest = line.partition(" ")
            if kind == "v":
                vertices.append([float(word) for word in rest.split()[:3]])
            elif kind == "f":
                corners = [int(word.partition("/")[0]) for word in rest.split()]
                corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                triangles += [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]
    return np.array(vertices), np.array(triangles, np.int64).reshape(-1, 3)


def disturb(
    vertices: np.ndarray, triangles: np.ndarray, sigma: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Displace a mesh by a smooth random field, after subdividing its triangles below the size of the bumps.

    The field depends on the place alone, so that what touches stays together.

    Args:
        vertices: (V, 3).
        triangles: (T, 3).
        sigma: standard deviation along each axis; 0 gives the mesh back, welded.

    Returns:
        New vertices and triangles.
    """
    vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
    triangles = inverse.reshape(-1)[triangles]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    if sigma <= 0.0:
        return vertices, triangles
    width = BUMP_WIDTH * sigma
    vertices, triangles = subdivide(vertices, triangles, width)
    rng = np.random.default_rng(seed)
    wave = rng.normal(size=(3, _WAVES, 3)) / width
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, _WAVES))
    shift = [np.cos(vertices @ wave[axis].T + phase[axis]).sum(axis=1) for axis in range(3)]
    return vertices + sigma * np.sqrt(2.0 / _WAVES) * np.stack(shift, axis=1), triangles


def subdivide(vertices: np.ndarray, triangles: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Halve edges until none is longer; neighbours split a shared edge at the same point."""
    while True:
        corners = vertices[triangles]
        length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        split = length > longest
        if not split.any():
            return vertices, triangles
        edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
        unique, number = np.unique(edges[split], axis=0, return_inverse=True)
        middle = np.full(triangles.shape, -1)
        middle[split] = len(vertices) + number.reshape(-1)
        vertices = np.concatenate([vertices, vertices[unique].mean(axis=1)])
        # Rotate each triangle so that its first edge is split, and its last one only if all are.
        turn = np.where(split.all(axis=1), 0, (split & ~np.roll(split, 1, axis=1)).argmax(axis=1))
        order = (turn[:, None] + np.arange(3)) % 3
        (a, b, c), (ab, bc, ca) = (np.take_along_axis(x, order, axis=1).T for x in (triangles, middle))
        count = split.sum(axis=1)
        none, one, two, three = (count == k for k in range(4))
        pieces = [triangles[none]]
        for kept, faces in (
            (one, [(a, ab, c), (ab, b, c)]),
            (two, [(ab, b, bc), (a, ab, c), (ab, bc, c)]),
            (three, [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]),
        ):
            pieces += [np.stack(face, axis=1)[kept] for face in faces]
        triangles = np.concatenate(pieces)


def smooth_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals: area-weighted means of the triangles around each vertex."""
    corners = vertices[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], cross)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0.0, normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
