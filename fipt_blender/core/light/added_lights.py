"""Rooms with lights that their mesh lacks: for relighting, and for lamps that were inferred."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..optics.lights import EmitterTable
from ..surface.room import Room

# A cube of width 2 around the origin, whose triangles face outwards.
_CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_CUBE_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_HALVES = np.array([[0, 1, 2], [0, 2, 3]])  # of a quadrilateral: its triangles


def add_light(
    room: Room, vertices: np.ndarray, triangles: np.ndarray, radiance: np.ndarray
) -> tuple[Room, EmitterTable]:
    """Add a one-sided emitter to a room, for relighting.

    Args:
        vertices: (n, 3) metres, world. triangles: (m, 3) into them; fronts emit.
        radiance: (3,).

    Returns:
        The new room, whose last m triangles are the light, and a table of the light alone.
    """
    triangles = np.asarray(triangles, np.int32)
    vertices = np.asarray(vertices, np.float32)
    corners = vertices.astype(np.float64)[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    count = len(triangles)
    ids = np.arange(len(room.triangles), len(room.triangles) + count, dtype=np.int32)
    extended = replace(
        room,
        vertices=np.concatenate([room.vertices, vertices]),
        triangles=np.concatenate([room.triangles, triangles + np.int32(len(room.vertices))]),
        corner_normals=np.concatenate(
            [room.corner_normals, np.repeat(normal[:, None], 3, axis=1).astype(np.float32)]
        ),
        triangle_object=np.concatenate([room.triangle_object, np.full(count, -1, np.int32)]),
        triangle_material=np.concatenate([room.triangle_material, np.full(count, -1, np.int32)]),
    )
    front = np.tile(np.asarray(radiance, np.float32), (count, 1))
    return extended, EmitterTable(ids, front, np.zeros_like(front))


def add_lamp(
    room: Room,
    position: np.ndarray,
    radius: float,
    radiance: np.ndarray,
    facing: Sequence[float] | None = None,
) -> tuple[Room, EmitterTable]:
    """Add a cube that casts about the light of a ball of this radius (metres), or a square for a disc.

    Args:
        facing: (3,) unit vector to which a disc shines; None: a ball.
    """
    if facing is None:
        corners = position + radius * float(np.sqrt(np.pi / 6.0)) * _CUBE
        return add_light(room, corners, _CUBE_SIDES[:, _HALVES].reshape(-1, 3), radiance)
    normal = np.asarray(facing, np.float64)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first *= 0.5 * np.sqrt(np.pi) * radius / np.linalg.norm(first)
    second = np.cross(normal, first)
    corners = np.asarray(position) + np.array(
        [-first - second, first - second, first + second, second - first]
    )
    return add_light(room, corners, _HALVES, radiance)
