# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Standing any object, with all that belongs to it, on a surface of the room.

What is being placed is remembered by names, since the artist's events come in between.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.job.errors import FiptError
from .outliner import collection

INSERTED = "FIPT Inserted"
# Custom properties of what was placed, with its matrix from before its first placing.
MADE = "fipt_inserted"  # we made it for that: "Remove Inserted" removes it
MOVED = "fipt_inserted_from"  # the artist had it already: "Remove Inserted" moves it back
_MAX_HITS = 64
_FAR = 1e6
_UP = Vector((0.0, 0.0, 1.0))


class Surface(NamedTuple):
    """A place on a surface: position and unit normal on the side it was seen from, in the world."""

    position: Vector
    normal: Vector


@dataclass(frozen=True)
class Stance:
    """How something stands.

    Attributes:
        upright: keeps its own up; otherwise its up is the surface's normal.
        turn: radians about its up.
        scale: factor on its own size.
        drop: its lowest point touches the surface; otherwise its origin does.
    """

    upright: bool = False
    turn: float = 0.0
    scale: float = 1.0
    drop: bool = True


@dataclass(frozen=True)
class Guest:
    """Something that is being placed.

    Attributes:
        root: name of the object that is moved.
        fresh: whether it was made for this placing, and goes if that is given up.
        marked: whether it was placed before.
        base: its rotation and size from before its first placing, as if it had stood on a floor (4x4
            without translation).
        foot: the point that touches a surface, seen from its origin in `base`: as low as its lowest point;
            below its origin, or below its middle where the origin lies beside it.
        before: where it stood before this placing.
    """

    root: str
    fresh: bool
    marked: bool
    base: Matrix
    foot: Vector
    before: Matrix


def find_surface(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    origin: Vector,
    direction: Vector,
    skip_backs: bool = False,
) -> Surface | None:
    """The first surface that a ray meets, of what is visible.

    Args:
        origin, direction: in the world; the direction of any length.
        skip_backs: whether it passes surfaces that it meets from behind.
    """
    direction = direction.normalized()
    nudge = 1e-5 * max(1.0, max(abs(value) for value in origin))
    for _ in range(_MAX_HITS):
        hit, position, normal, *_ = scene.ray_cast(depsgraph, origin, direction)
        if not hit:
            return None
        behind = normal.dot(direction) > 0.0
        if not (behind and skip_backs):
            return Surface(position, -normal if behind else normal)
        origin = position + nudge * direction
    return None


@contextmanager
def aside(guest: Guest) -> Iterator[None]:
    """Something that is being placed out of the way of rays, for a while.

    Passing it by its name would not do: where it touches a surface, the ray would pass both.
    """
    item = bpy.data.objects.get(guest.root)
    if item is None:
        yield
        return
    place = item.matrix_world.copy()
    item.matrix_world = Matrix.Translation((0.0, 0.0, _FAR)) @ place
    try:
        yield
    finally:
        item.matrix_world = place


def invite(
    scene: bpy.types.Scene,
    source: bpy.types.Object,
    copy: bool = False,
    room: Iterable[bpy.types.Object] = (),
) -> Guest:
    """Make an object ready to be placed: itself, or a copy where it is not in the scene or may not move.

    Args:
        copy: whether to place a copy in any case, which shares the object's data.
        room: objects that can't be placed themselves.

    Raises:
        FiptError: ``object-is-room``.
    """
    movable = source.library is None and source.name in scene.objects and scene.objects[source.name] == source
    if movable and not copy:
        if source in set(room):
            raise FiptError(
                "object-is-room",
                f"'{source.name}' is a part of the room.",
                "Choose another object, or place a copy of it.",
            )
        return _guest(source, fresh=False)
    return guest_of_made(_copy_family(source, collection(scene, INSERTED)))


def invite_collection(scene: bpy.types.Scene, source: bpy.types.Collection) -> Guest:
    """Make an instance of a collection ready to be placed.

    Raises:
        FiptError: ``collection-holds-itself`` where the scene's inserted objects lie in it.
    """
    target = collection(scene, INSERTED)
    if source == target or target in set(source.children_recursive) or source == scene.collection:
        raise FiptError(
            "collection-holds-itself",
            f"'{source.name}' holds the inserted objects, so it can't stand among them.",
            "Choose another collection.",
        )
    item = bpy.data.objects.new(source.name, None)
    item.instance_type, item.instance_collection = "COLLECTION", source
    item.empty_display_size = 0.1
    target.objects.link(item)
    return guest_of_made(item)


def guest_of_made(item: bpy.types.Object) -> Guest:
    """An object that was made to be placed, with its children."""
    bpy.context.view_layer.update()
    item[MADE] = _numbers(item.matrix_world)
    return _guest(item, fresh=True)


def _guest(root: bpy.types.Object, fresh: bool) -> Guest:
    bpy.context.view_layer.update()
    before = root.matrix_world.copy()
    mark = root.get(MADE, root.get(MOVED))
    base = (before if mark is None else _matrix(mark)).to_3x3().to_4x4()
    family = {root.name, *(child.name for child in root.children_recursive)}
    foot = _foot(family, base @ before.inverted_safe())
    return Guest(root.name, fresh, mark is not None, base, foot, before)


def _numbers(matrix: Matrix) -> list[float]:
    return [value for row in matrix for value in row]


def _matrix(numbers: Sequence[float]) -> Matrix:
    values = list(numbers)
    return Matrix([values[row : row + 4] for row in range(0, 16, 4)])


def _foot(family: Collection[str], moved: Matrix) -> Vector:
    """`Guest.foot` of objects and what they instance, moved by a matrix that brings their origin to zero."""
    corners: list[np.ndarray] = []
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for each in depsgraph.object_instances:
        owner = each.parent if each.is_instance else each.object
        if owner is None or owner.original.name not in family:
            continue
        if each.object.type == "MESH":
            points = np.empty(3 * len(each.object.data.vertices), np.float32)
            each.object.data.vertices.foreach_get("co", points)
        elif each.object.type in ("CURVE", "SURFACE", "META", "FONT", "VOLUME", "CURVES", "POINTCLOUD"):
            points = np.array(each.object.bound_box, np.float32).ravel()
        else:
            continue
        if points.size:
            matrix = np.array(moved @ each.matrix_world, np.float64)
            placed = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
            corners += [placed.min(axis=0), placed.max(axis=0)]
    if not corners:
        return Vector()
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    beside = bool((low[:2] > 0.0).any() or (high[:2] < 0.0).any())
    x, y = 0.5 * (low + high)[:2] if beside else (0.0, 0.0)
    return Vector((x, y, low[2]))


def _copy_family(root: bpy.types.Object, target: bpy.types.Collection) -> bpy.types.Object:
    """A copy of an object and its children, with the same data, linked into a collection."""
    copies = {}
    for item in (root, *root.children_recursive):
        copy = copies[item] = item.copy()
        for key in [key for key in copy.keys() if key.startswith("fipt_")]:
            del copy[key]
        target.objects.link(copy)
    for item, copy in copies.items():
        if item != root:
            copy.parent = copies.get(item.parent)
            copy.matrix_parent_inverse = item.matrix_parent_inverse.copy()
    world = root.matrix_world.copy()
    copies[root].parent = None
    copies[root].matrix_world = world
    return copies[root]


def stand(guest: Guest, surface: Surface, stance: Stance) -> bpy.types.Object | None:
    """Move something onto a surface; None where it has gone in the meantime."""
    item = bpy.data.objects.get(guest.root)
    if item is None:
        return None
    if not guest.fresh and not guest.marked:
        item[MOVED] = _numbers(guest.before)
    item.matrix_world = stance_matrix(guest, surface, stance)
    return item


def stance_matrix(guest: Guest, surface: Surface, stance: Stance) -> Matrix:
    """Object to world of something that stands on a surface."""
    up = _UP if stance.upright else surface.normal
    matrix = Matrix.Translation(surface.position) @ _UP.rotation_difference(up).to_matrix().to_4x4()
    matrix = matrix @ Matrix.Rotation(stance.turn, 4, "Z") @ Matrix.Scale(stance.scale, 4)
    if stance.drop:
        matrix = matrix @ Matrix.Translation(-guest.foot)
    return matrix @ guest.base


def give_up(guest: Guest) -> None:
    """As if it had not been placed: gone if it was made for that, where it stood if not."""
    item = bpy.data.objects.get(guest.root)
    if item is None:
        return
    if guest.fresh:
        _remove(item)
    else:
        item.matrix_world = guest.before
        if not guest.marked:
            item.pop(MOVED, None)


def inserted(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """What was placed in a scene."""
    return [item for item in scene.objects if MADE in item or MOVED in item]


def remove_inserted(scene: bpy.types.Scene) -> int:
    """Remove what we made, move what we moved back; returns how many things that were."""
    items = inserted(scene)
    for item in items:
        if MADE not in item:
            item.matrix_world = _matrix(item[MOVED])
            del item[MOVED]
    for name in [item.name for item in items if MADE in item]:
        if name in bpy.data.objects:  # it may have been another one's child
            _remove(bpy.data.objects[name])
    return len(items)


def _remove(root: bpy.types.Object) -> None:
    """Remove an object that we made, its children, and what only they used of ours."""
    family = [root, *root.children_recursive]
    meshes = {item.data for item in family if item.type == "MESH" and item.data.name.startswith("FIPT ")}
    bpy.data.batch_remove(family)
    materials = {material for mesh in meshes for material in mesh.materials if material is not None}
    bpy.data.batch_remove([mesh for mesh in meshes if mesh.users == 0])
    bpy.data.batch_remove([material for material in materials if material.users == 0])
