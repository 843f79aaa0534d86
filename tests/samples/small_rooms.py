"""Small rooms made of quadrilaterals, and a statistical test of means."""

import json
from collections.abc import Sequence
from math import erfc, log, sqrt
from pathlib import Path

import numpy as np

from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.surface.adjacency import face_vectors
from fipt_blender.core.surface.room import Room

# Quadrilaterals of a box 4 x 4 x 3 m, fronts inwards: floor, ceiling, back (+y), left (-x), right, front.
BOX = [
    [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]],
    [[-2, -2, 3], [-2, 2, 3], [2, 2, 3], [2, -2, 3]],
    [[-2, 2, 0], [2, 2, 0], [2, 2, 3], [-2, 2, 3]],
    [[-2, -2, 0], [-2, 2, 0], [-2, 2, 3], [-2, -2, 3]],
    [[2, -2, 0], [2, -2, 3], [2, 2, 3], [2, 2, 0]],
    [[-2, -2, 0], [-2, -2, 3], [2, -2, 3], [2, -2, 0]],
]


def make_room(quads: list, objects: np.ndarray | None = None, **names) -> Room:
    """Quadrilaterals as two triangles each; quad i has triangles 2i and 2i + 1.

    Args:
        objects: object of each quadrilateral; by default every one is a separate object.
    """
    vertices = np.array(quads, np.float32).reshape(-1, 3)
    corners = np.arange(len(vertices), dtype=np.int32).reshape(-1, 4)
    triangles = corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return mesh_room(vertices, triangles, np.repeat(range(len(quads)) if objects is None else objects, 2), **names)


def mesh_room(vertices: np.ndarray, triangles: np.ndarray, objects: np.ndarray, **names) -> Room:
    """A room with flat normals."""
    normals = np.repeat(face_vectors(np.asarray(vertices, float), triangles)[0][:, None], 3, axis=1).astype(np.float32)
    objects = np.asarray(objects, np.int32)
    return Room(np.asarray(vertices, np.float32), np.asarray(triangles, np.int32), normals, objects, objects, **names)


def write_room(folder: Path, room: Room, **more: np.ndarray) -> None:
    """room.npz, with more or other arrays, and room.json as Blender writes them, of a room of quadrilaterals."""
    arrays = ("vertices", "triangles", "corner_normals", "triangle_object", "triangle_material")
    polygon = np.arange(len(room.triangles)) // 2
    np.savez(folder / "room.npz", **{**{n: getattr(room, n) for n in arrays}, "triangle_polygon": polygon, **more})
    objects = [f"object {index}" for index in range(int(room.triangle_object.max(initial=-1)) + 1)]
    materials = [f"material {index}" for index in range(int(room.triangle_material.max(initial=-1)) + 1)]
    names = {"objects": objects, "materials": materials, "parts": room.parts}
    (folder / "room.json").write_text(json.dumps(names))


def block(low: Sequence[float], high: Sequence[float]) -> list:
    """Six quadrilaterals of an upright block between two corners, fronts outwards."""
    (a, b, c), (d, e, f) = low, high
    bottom, top = ([[x, y, z] for x, y in ((a, b), (d, b), (d, e), (a, e))] for z in (c, f))
    sides = [[bottom[i], bottom[i - 3], top[i - 3], top[i]] for i in range(4)]
    return [bottom[::-1], top, *sides]


def bulb(centre: Sequence[float], radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an octahedron, fronts outwards."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32)
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    return corners * radius + np.array(centre, np.float32), np.array(faces, np.int32)


def room_with_bulb(radius: float, centre: tuple = (0.5, 0.3, 1.0), quads: list = BOX, **names) -> Room:
    """A room with an octahedron as its last object: in the box, triangles 12 to 19."""
    flat = make_room(quads)
    vertices, triangles = bulb(centre, radius)
    return mesh_room(
        np.concatenate([flat.vertices, vertices]),
        np.concatenate([flat.triangles, triangles + len(flat.vertices)]),
        np.concatenate([flat.triangle_object, np.full(8, len(quads))]),
        **names,
    )


def table(ids: list[int], front: list[float], back: tuple[float, ...] = (0.0, 0.0, 0.0)) -> EmitterTable:
    """Triangles of equal emission."""
    return EmitterTable(
        np.array(ids, np.int32),
        np.tile(np.array(front, np.float32), (len(ids), 1)),
        np.tile(np.array(back, np.float32), (len(ids), 1)),
    )


def area_lights(room: Room, emitters: EmitterTable) -> AreaLights:
    return AreaLights(room.vertices, room.triangles, emitters)


def agree(difference: np.ndarray, error: np.ndarray, level: float = 1e-3) -> None:
    """Fail where differences of many means are too large for their standard errors (two-sided z-test).

    The level holds for all differences together (Šidák's correction).
    """
    z = np.abs(difference) / np.maximum(error, 1e-12)
    p = erfc(float(z.max()) / sqrt(2.0))
    # 1 - (1 - level)^(1/n), without cancellation
    each = -np.expm1(log(1.0 - level) / z.size)
    assert p > each, f"largest |z| is {z.max():.2f} of {z.size} values (p = {p:.1e}, needs > {each:.1e})"


def surface_points(
    room: Room, each: int, rng: np.random.Generator, triangles: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3) points uniform on each triangle, (N, 3) their geometric normals, (N,) triangle."""
    ids = np.repeat(np.arange(len(room.triangles)) if triangles is None else triangles, each)
    u, v = rng.random((2, len(ids)))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    points = np.einsum("nc,ncd->nd", weights, room.vertices.astype(float)[room.triangles[ids]])
    return points, room.normals[ids], ids
