"""Area lights that the artist adds to the room, with size, power and place derived from it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.run.errors import FiptError
from ..marks import BASE, NEW_LIGHT
from ..outliner import LIGHTS, collection
from ..room.mesh_arrays import world_bounds
from . import light_state
from .area_lights import shaped_light
from .calibration import scene_unit
from .placement import room_light_power


@dataclass(frozen=True)
class Suggestion:
    """A square light that suits a room."""

    size: float  # its side, metres
    watts: float
    distance: float  # from the surface that it lights, metres


def suggest(scene: bpy.types.Scene) -> Suggestion:
    """A light that alone makes the room about as bright as its photographs."""
    bounds = world_bounds(scene.fipt.capture.room_objects(scene))
    if bounds is None:
        return Suggestion(1.0, 100.0, 2.0)
    low, high = bounds
    extent = high - low
    median = scene_unit(scene) * scene.fipt.lights.median_radiance
    size = 0.2 * float(min(extent[0], extent[1])) or 1.0
    watts = room_light_power(median, low, high) if median > 0.0 else 100.0 * size**2
    return Suggestion(size, watts, 0.35 * float(np.linalg.norm(extent)))


def add_light(
    scene: bpy.types.Scene, location: Vector, direction: Vector, size: float, watts: float
) -> bpy.types.Object:
    """A square area light.

    Args:
        scene: the scene to add it to.
        location: its centre, world.
        direction: the direction in which it shines, of any length.
        size: its side, metres.
        watts: its power.
    """
    if direction.length <= 0.0:
        raise FiptError("direction-missing.add-light")
    item = shaped_light("FIPT Light", "SQUARE", size, size)
    item[NEW_LIGHT] = 1
    item[BASE] = [watts] * 3
    collection(scene, LIGHTS).objects.link(item)
    rotation = direction.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    item.matrix_world = Matrix.Translation(location) @ rotation
    light_state.refresh(scene)
    light_state.list_lights(scene)
    for index, row in enumerate(scene.fipt.lights.lights):
        if row.object == item:
            scene.fipt.lights.active = index
    return item


def aim(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, point: Vector, normal: Vector, distance: float
) -> tuple[Vector, Vector]:
    """Location of a light that is aimed at a point of the room, and the unit direction in which it shines.

    It lies in front of the surface, raised where possible, and closer where something is in between. At a
    ceiling it hangs below the point and shines down, as a lamp does.

    Args:
        scene: the scene, whose visible objects block the light.
        depsgraph: its dependency graph.
        point: position on the surface, world.
        normal: unit normal there, on the side to light.
        distance: metres from the point where nothing is in between.
    """
    if normal.z < -0.7:  # a ceiling
        return point + 0.05 * normal, normal.copy()  # a scan is bumpy
    outwards = (normal + Vector((0.0, 0.0, 0.7))).normalized()
    start = point + 1e-3 * distance * normal
    hit, position, *_ = scene.ray_cast(depsgraph, start, outwards)
    free = (position - start).length if hit else math.inf
    location = start + outwards * min(distance, 0.8 * free)
    return location, (point - location).normalized()


def turn_to(item: bpy.types.Object, target: Vector) -> None:
    """Turn a light, which shines along its -Z axis, towards a point of the world."""
    place, _, scale = item.matrix_world.decompose()
    direction = target - place
    if direction.length <= 1e-6:
        raise FiptError("direction-missing.turn-to")
    item.matrix_world = Matrix.LocRotScale(place, direction.to_track_quat("-Z", "Y"), scale)


def beam_end(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, item: bpy.types.Object, distance: float
) -> Vector:
    """Where a light's axis meets the room; `distance` metres away where it meets nothing."""
    place, rotation, _ = item.matrix_world.decompose()
    direction = rotation @ Vector((0.0, 0.0, -1.0))
    hit, position, *_ = scene.ray_cast(depsgraph, place + 1e-3 * direction, direction)
    return position if hit else place + distance * direction
