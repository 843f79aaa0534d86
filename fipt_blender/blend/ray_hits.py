"""The surfaces of a scene that a ray passes through, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import bpy
from mathutils import Matrix, Vector


class Hit(NamedTuple):
    """Where a ray hits a surface.

    Attributes:
        position, normal: in the world; the normal is that of the face, whichever side is hit.
        behind: whether the face is hit from behind.
        face: polygon of the evaluated mesh.
        object: the evaluated object.
        matrix: of the object or instance, to the world.
    """

    position: Vector
    normal: Vector
    behind: bool
    face: int
    object: bpy.types.Object
    matrix: Matrix


def hits(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    origin: Vector,
    direction: Vector,
    skip_backs: bool = False,
) -> Iterator[Hit]:
    """The visible surfaces on a ray, the nearest first.

    Args:
        scene, depsgraph: the scene and its dependency graph.
        origin: start of the ray, in the world.
        direction: of any length, in the world; without a length nothing is hit.
        skip_backs: whether the ray passes through surfaces that it hits from behind.
    """
    if direction.length == 0.0:
        return
    direction = direction.normalized()
    # Moves the next ray off the surface that the last one has hit.
    nudge = 1e-5 * max(1.0, max(abs(value) for value in origin))
    for _ in range(64):  # a ray that has not found what it looks for by then gives up
        hit, position, normal, face, item, matrix = scene.ray_cast(depsgraph, origin, direction)
        if not hit:
            return
        behind = normal.dot(direction) > 0.0
        if not (behind and skip_backs):
            yield Hit(position, normal, behind, face, item, matrix)
        origin = position + nudge * direction


def surface_on_ray(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    origin: Vector,
    direction: Vector,
    skip_backs: bool = False,
) -> tuple[bpy.types.Object, int, Vector] | None:
    """Object, polygon and point in the world of the first mesh that a ray hits; None without one.

    Args:
        scene, depsgraph, origin, direction, skip_backs: as for `hits`.
    """
    for hit in hits(scene, depsgraph, origin, direction, skip_backs):
        if hit.object.type == "MESH" and hit.face >= 0:
            return hit.object.original, hit.face, hit.position
    return None
