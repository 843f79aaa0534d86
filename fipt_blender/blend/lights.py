# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting: the estimated lights off and on, and new area lights of known radiance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix

from ..properties.lights import ON, SOLO, WORLD_ON
from . import light_state
from .fixture_nodes import emission_material
from .fixtures import fixtures
from .outliner import LIGHTS, collection


def set_estimated_lights(on: bool, scene: bpy.types.Scene | None = None) -> None:
    """Switch all fixtures and the estimated environment of a scene (the context's by default).

    A fixture that is off is black. Lights that were added stay as they are, and nothing is soloed any more.
    """
    scene = scene or bpy.context.scene
    world = light_state.own_world(scene)
    if world is not None:
        world[WORLD_ON] = on
    light_state.change_all(scene, light_state.lights_of(scene), {SOLO: False})
    light_state.change_all(scene, fixtures(scene), {ON: on})


def area_light_watts(radiance: float, area: float) -> float:
    """Power of a one-sided Lambertian area light, P = pi A L.

    Args:
        radiance: L, W/(m² sr).
        area: A, m².
    """
    return math.pi * area * radiance


def add_area_light(
    name: str,
    radiance: Sequence[float],
    *,
    size: tuple[float, float] | None = None,
    matrix: np.ndarray | None = None,
    vertices: Sequence[Sequence[float]] | None = None,
    as_mesh: bool = False,
    scene: bpy.types.Scene | None = None,
) -> bpy.types.Object:
    """Add a rectangular light that emits from one side.

    Either `size` and `matrix`, or four `vertices`: counter-clockwise seen from the side that it lights.

    Args:
        name: of the new object.
        radiance: rgb, W/(m² sr), the same everywhere on its front.
        size: width and height in metres.
        matrix: 4x4 object to world, without scale; the light shines along its -Z.
        vertices: (4,3) corners of a rectangle in the world.
        as_mesh: make an emissive surface, which cameras and mirrors see and whose back is black, instead of
            a Blender area light.
        scene: the context's scene by default.
    """
    if vertices is not None:
        size, matrix = _rectangle(np.asarray(vertices, np.float64))
    if size is None or matrix is None:
        raise ValueError("an area light needs a size and a matrix, or four vertices")
    if as_mesh:
        x, y = 0.5 * size[0], 0.5 * size[1]
        data = bpy.data.meshes.new(name)
        # Front faces look along -Z, as Blender's area lights do.
        data.from_pydata([(-x, -y, 0.0), (-x, y, 0.0), (x, y, 0.0), (x, -y, 0.0)], [], [(0, 1, 2, 3)])
        data.materials.append(emission_material(name, list(radiance), [0.0, 0.0, 0.0]))
    else:
        data = bpy.data.lights.new(name, "AREA")
        data.shape, data.size, data.size_y = "RECTANGLE", size[0], size[1]
        strongest = float(max(radiance))
        data.energy = area_light_watts(strongest, size[0] * size[1])
        data.color = [value / strongest if strongest > 0.0 else 1.0 for value in radiance]
    item = bpy.data.objects.new(name, data)
    collection(scene or bpy.context.scene, LIGHTS).objects.link(item)
    item.matrix_world = Matrix(np.asarray(matrix, np.float64).tolist())
    return item


def _rectangle(corners: np.ndarray) -> tuple[tuple[float, float], np.ndarray]:
    across, up = corners[1] - corners[0], corners[3] - corners[0]
    width, height = float(np.linalg.norm(across)), float(np.linalg.norm(up))
    front = np.cross(across, up) / (width * height)
    matrix = np.eye(4)
    # -Z is the front: X turns against `across` to keep the frame right-handed.
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = -across / width, up / height, -front
    matrix[:3, 3] = corners.mean(axis=0)
    return (width, height), matrix
