# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Area lights that an artist adds to the room: their place, size and power suggested by it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.job.errors import FiptError
from ..properties.lights import BASE, NEW_LIGHT
from . import light_state
from .outliner import LIGHTS, collection
from .placement import room_light_power

_SIZE_SHARE = 0.2  # of the room's shorter side
_DISTANCE_SHARE = 0.35  # from what it lights, of the room's diagonal
_PLAIN_SIZE, _PLAIN_WATTS = 1.0, 100.0  # without a room


@dataclass(frozen=True)
class Suggestion:
    """What suits a room: side of a square light in metres, watts, and the way from what it lights."""

    size: float
    watts: float
    distance: float


def suggest(scene: bpy.types.Scene) -> Suggestion:
    """A light that alone makes the room about as bright as its photographs."""
    points = [
        item.matrix_world @ Vector(corner)
        for item in scene.fipt.capture.room_objects(scene)
        for corner in item.bound_box
    ]
    if not points:
        return Suggestion(_PLAIN_SIZE, _PLAIN_WATTS, 2.0 * _PLAIN_SIZE)
    corners = np.array(points)
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = high - low
    median = scene.fipt.lights.median_radiance
    size = _SIZE_SHARE * float(min(extent[0], extent[1])) or _PLAIN_SIZE
    watts = room_light_power(median, low, high) if median > 0.0 else _PLAIN_WATTS * size**2
    return Suggestion(size, watts, _DISTANCE_SHARE * float(np.linalg.norm(extent)))


def add_light(
    scene: bpy.types.Scene, location: Vector, direction: Vector, size: float, watts: float
) -> bpy.types.Object:
    """A square area light.

    Args:
        scene: that it lights.
        location: of its centre, world.
        direction: in which it shines; need not be of unit length.
        size: its side, metres.
        watts: its power.

    Raises:
        FiptError: ``direction-missing``.
    """
    if direction.length <= 0.0:
        raise FiptError(
            "direction-missing", "The light has no direction.", "Give a direction other than zero."
        )
    data = bpy.data.lights.new("FIPT Light", "AREA")
    data.shape, data.size = "SQUARE", size
    item = bpy.data.objects.new(data.name, data)
    item[NEW_LIGHT] = 1
    item[BASE] = [watts] * 3
    collection(scene, LIGHTS).objects.link(item)
    turn = direction.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    item.matrix_world = Matrix.Translation(location) @ turn
    light_state.refresh(scene)
    light_state.list_lights(scene)
    for index, row in enumerate(scene.fipt.lights.lights):
        if row.object == item:
            scene.fipt.lights.active = index
    return item


def aim(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, point: Vector, normal: Vector, distance: float
) -> tuple[Vector, Vector]:
    """A place from which a light shines onto a point of the room, and the direction to it.

    It stands off the surface, rather above it, and this side of whatever is in the way.

    Args:
        point, normal: of the surface, unit, on the side to light; world.
        distance: how far away where nothing is in the way.
    """
    way = normal.copy()
    if normal.z > -0.7:  # below a ceiling it stays below
        way = (normal + Vector((0.0, 0.0, 0.7))).normalized()
    start = point + 1e-3 * distance * normal
    hit, position, *_ = scene.ray_cast(depsgraph, start, way)
    free = (position - start).length if hit else math.inf
    place = start + way * min(distance, 0.8 * free)
    return place, (point - place).normalized()
