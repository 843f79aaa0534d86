# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Visible surfaces of a scene, found by casting rays, on which objects can be placed."""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Vector

from ...core.run.errors import FiptError
from ..capture.cameras import camera_geometry
from ..capture.view_geometry import ViewGeometry
from ..ray_hits import hits
from ..room.rays import Cast
from .support import find_support


class Surface(NamedTuple):
    """A point on a surface: position and unit normal towards the viewer, in the world."""

    position: Vector
    normal: Vector


def find_surface(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    origin: Vector,
    direction: Vector,
    skip_backs: bool = False,
) -> Surface | None:
    """The first visible surface that a ray hits.

    Args:
        scene, depsgraph, origin, direction, skip_backs: as for `hits`.
    """
    hit = next(hits(scene, depsgraph, origin, direction, skip_backs), None)
    return None if hit is None else Surface(hit.position, -hit.normal if hit.behind else hit.normal)


def surface_at(scene: bpy.types.Scene, camera: bpy.types.Object, u: float, v: float) -> Surface:
    """The surface at a pixel of a camera's image.

    Args:
        scene: the scene.
        camera: one of its cameras.
        u, v: pixels from the top left.

    Raises:
        FiptError: ``surface-missing`` or ``camera-kind``.
    """
    origin, direction = camera_geometry(scene, camera).ray(u, v)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    surface = find_surface(scene, depsgraph, Vector(origin), Vector(direction))
    if surface is None:
        raise FiptError(
            "surface-missing",
            "There is no surface at that place.",
            "Choose a place where the room is visible.",
        )
    return surface


def free_spot(scene: bpy.types.Scene, camera: bpy.types.Object) -> Surface:
    """Where in a camera's image an object can stand: a free level spot, else any level surface.

    Raises:
        FiptError: ``surface-missing`` or ``camera-kind``.
    """
    view, cast = camera_geometry(scene, camera), _cast(scene)
    for share in (0.18, 0.1, 0.05):
        support = find_support(cast, view, share)
        if support is not None:
            return Surface(Vector(support.point), Vector((0.0, 0.0, 1.0)))
    return _lowest_level(cast, view)


def _lowest_level(cast: Cast, view: ViewGeometry) -> Surface:
    """The lowest surface facing upwards that a grid of rays hits."""
    lowest: Surface | None = None
    for v in np.linspace(0.1, 0.9, 9):
        for u in (0.5, 0.375, 0.625, 0.25, 0.75):
            hit = cast(*view.ray(u * view.width, v * view.height))
            if hit is None or hit[1][2] <= 0.9:
                continue
            if lowest is None or hit[0][2] < lowest.position.z - 0.01:
                lowest = Surface(Vector(hit[0]), Vector(hit[1]))
    if lowest is None:
        raise FiptError(
            "surface-missing",
            "The view shows no level surface.",
            "Choose a view that shows the floor or a table.",
        )
    return lowest


def _cast(scene: bpy.types.Scene) -> Cast:
    """A function that casts rays at what is visible."""
    depsgraph = bpy.context.evaluated_depsgraph_get()

    def cast(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        start = origin + 1e-5 * max(1.0, float(np.abs(origin).max())) * direction
        surface = find_surface(scene, depsgraph, Vector(start), Vector(direction))
        return None if surface is None else (np.array(surface.position), np.array(surface.normal))

    return cast
