# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Placing any object, with its children, on a surface of the room.

An object that is being placed is remembered by name, since the artist's events come in between.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.run.errors import FiptError
from ..marks import CATCHER, MADE, MOVED, inserted_objects, remove_marks
from ..outliner import INSERTED, collection
from ..room.mesh_arrays import transform_points
from .surfaces import Surface

_UP = Vector((0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Stance:
    """How an object stands on a surface.

    Attributes:
        upright: keeps its own up axis; otherwise that is aligned to the surface normal.
        turn: rotation about its up axis, radians.
        scale: factor on its own size.
        drop: whether its lowest point touches the surface; otherwise its origin does.
    """

    upright: bool = False
    turn: float = 0.0
    scale: float = 1.0
    drop: bool = True


@dataclass(frozen=True)
class Placement:
    """An object that is being placed.

    Attributes:
        root: name of the object that is moved.
        fresh: whether it was made for this placement, and is removed if that is cancelled.
        marked: whether it was placed before.
        base: its rotation and scale before it was first placed, as if it had stood on a floor (4x4 without
            translation).
        foot: the point that touches the surface, relative to its origin in `base`: at the height of its
            lowest point, below its origin, or below its middle where the origin lies beside it.
        before: its world matrix before this placement.
    """

    root: str
    fresh: bool
    marked: bool
    base: Matrix
    foot: Vector
    before: Matrix


@contextmanager
def moved_aside(placement: Placement) -> Iterator[None]:
    """Move an object that is being placed out of the way of rays for the length of the block.

    Skipping it by name would not do: where it touches a surface, the ray would skip both.
    """
    item = bpy.data.objects.get(placement.root)
    if item is None:
        yield
        return
    matrix = item.matrix_world.copy()
    item.matrix_world = Matrix.Translation((0.0, 0.0, 1e6)) @ matrix
    try:
        yield
    finally:
        item.matrix_world = matrix


def begin_placing(
    scene: bpy.types.Scene,
    source: bpy.types.Object,
    copy: bool = False,
    room: Iterable[bpy.types.Object] = (),
) -> Placement:
    """Begin to place an object, or a copy of it where it is linked or not in the scene.

    Args:
        scene: the scene.
        source: the object.
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
        return _placement(source, fresh=False)
    return begin_placing_made(_copy_family(source, collection(scene, INSERTED)))


def begin_placing_collection(scene: bpy.types.Scene, source: bpy.types.Collection) -> Placement:
    """Begin to place an instance of a collection.

    Raises:
        FiptError: ``collection-holds-itself`` where it contains the scene's inserted objects.
    """
    target = collection(scene, INSERTED)
    if source == target or target in set(source.children_recursive) or source == scene.collection:
        raise FiptError(
            "collection-holds-itself",
            f"'{source.name}' contains the inserted objects, so it can't be inserted itself.",
            "Choose another collection.",
        )
    item = bpy.data.objects.new(source.name, None)
    item.instance_type, item.instance_collection = "COLLECTION", source
    item.empty_display_size = 0.1
    target.objects.link(item)
    return begin_placing_made(item)


def begin_placing_made(item: bpy.types.Object) -> Placement:
    """Begin to place an object that was made for it, with its children."""
    bpy.context.view_layer.update()
    item[MADE] = _numbers(item.matrix_world)
    return _placement(item, fresh=True)


def _placement(root: bpy.types.Object, fresh: bool) -> Placement:
    bpy.context.view_layer.update()
    before = root.matrix_world.copy()
    mark = root.get(MADE, root.get(MOVED))
    base = (before if mark is None else _matrix(mark)).to_3x3().to_4x4()
    family = {root.name, *(child.name for child in root.children_recursive)}
    foot = _foot(family, base @ before.inverted_safe())
    return Placement(root.name, fresh, mark is not None, base, foot, before)


def _numbers(matrix: Matrix) -> list[float]:
    return [value for row in matrix for value in row]


def _matrix(numbers: Sequence[float]) -> Matrix:
    values = list(numbers)
    return Matrix([values[row : row + 4] for row in range(0, 16, 4)])


def _foot(family: Collection[str], to_base: Matrix) -> Vector:
    """`Placement.foot` of the named objects and what they instance.

    Args:
        family: names of the objects.
        to_base: 4x4 from the world to the space of `Placement.base`.
    """
    corners: list[np.ndarray] = []
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for instance in depsgraph.object_instances:
        owner = instance.parent if instance.is_instance else instance.object
        if owner is None or owner.original.name not in family:
            continue
        item = instance.object
        if item.type == "MESH":
            points = np.empty(3 * len(item.data.vertices), np.float32)
            item.data.vertices.foreach_get("co", points)
        elif item.type in ("CURVE", "SURFACE", "META", "FONT", "VOLUME", "CURVES", "POINTCLOUD"):
            points = np.array(item.bound_box, np.float32).ravel()
        else:
            continue
        if points.size:
            matrix = np.array(to_base @ instance.matrix_world, np.float64)
            points = transform_points(points.reshape(-1, 3), matrix)
            corners += [points.min(axis=0), points.max(axis=0)]
    if not corners:
        return Vector()
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    origin_is_beside = bool((low[:2] > 0.0).any() or (high[:2] < 0.0).any())
    x, y = 0.5 * (low + high)[:2] if origin_is_beside else (0.0, 0.0)
    return Vector((x, y, low[2]))


def _copy_family(root: bpy.types.Object, target: bpy.types.Collection) -> bpy.types.Object:
    """A copy of an object and its children, with the same data, linked to a collection."""
    copies = {}
    for item in (root, *root.children_recursive):
        copy = copies[item] = item.copy()
        if CATCHER in item:  # a copy of what the photograph shows is not in the photograph
            copy.is_shadow_catcher = False
        remove_marks(copy, *[key for key in copy.keys() if key.startswith("fipt_")])
        target.objects.link(copy)
    for item, copy in copies.items():
        if item != root:
            copy.parent = copies.get(item.parent)
            copy.matrix_parent_inverse = item.matrix_parent_inverse.copy()
    world = root.matrix_world.copy()
    copies[root].parent = None
    copies[root].matrix_world = world
    return copies[root]


def place(placement: Placement, surface: Surface, stance: Stance) -> bpy.types.Object | None:
    """Move an object onto a surface; None where it was removed in the meantime."""
    item = bpy.data.objects.get(placement.root)
    if item is None:
        return None
    if not placement.fresh and not placement.marked:
        item[MOVED] = _numbers(placement.before)
    item.matrix_world = placed_matrix(placement, surface, stance)
    return item


def placed_matrix(placement: Placement, surface: Surface, stance: Stance) -> Matrix:
    """World matrix of an object that stands on a surface."""
    up = _UP if stance.upright else surface.normal
    matrix = Matrix.Translation(surface.position) @ _UP.rotation_difference(up).to_matrix().to_4x4()
    matrix = matrix @ Matrix.Rotation(stance.turn, 4, "Z") @ Matrix.Scale(stance.scale, 4)
    if stance.drop:
        matrix = matrix @ Matrix.Translation(-placement.foot)
    return matrix @ placement.base


def cancel_placing(placement: Placement) -> None:
    """Remove an object that was made for the placement, and move any other back."""
    item = bpy.data.objects.get(placement.root)
    if item is None:
        return
    if placement.fresh:
        _remove(item)
    else:
        item.matrix_world = placement.before
        if not placement.marked:
            remove_marks(item, MOVED)


def remove_inserted(scene: bpy.types.Scene) -> int:
    """Remove inserted objects that we made and move the artist's own back; returns their number."""
    items = inserted_objects(scene)
    for item in items:
        if MADE not in item:
            item.matrix_world = _matrix(item[MOVED])
            remove_marks(item, MOVED)
    for name in [item.name for item in items if MADE in item]:
        if name in bpy.data.objects:  # it may have been removed with its parent
            _remove(bpy.data.objects[name])
    return len(items)


def _remove(root: bpy.types.Object) -> None:
    """Remove an object that we made, its children, and those of our meshes that only they used."""
    family = [root, *root.children_recursive]
    meshes = {item.data for item in family if item.type == "MESH" and item.data.name.startswith("FIPT ")}
    bpy.data.batch_remove(family)
    materials = {material for mesh in meshes for material in mesh.materials if material is not None}
    bpy.data.batch_remove([mesh for mesh in meshes if mesh.users == 0])
    bpy.data.batch_remove([material for material in materials if material.users == 0])
