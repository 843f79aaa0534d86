# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""New area lights of known radiance, for relighting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ..outliner import LIGHTS, collection
from .fixture_nodes import emission_material


def area_light_watts(radiance: float, area: float) -> float:
    """Power in watts of a one-sided Lambertian area light, P = pi A L.

    Args:
        radiance: L, W/(m² sr).
        area: A, m².
    """
    return math.pi * area * radiance


@dataclass(frozen=True)
class Rectangle:
    """A rectangle with a front.

    Attributes:
        size: width and height in metres.
        matrix: 4x4 object to world, without scale; the front faces along its -Z.
    """

    size: tuple[float, float]
    matrix: np.ndarray

    @classmethod
    def of_corners(cls, corners: Sequence[Sequence[float]]) -> Rectangle:
        """The rectangle with these corners (4,3) in the world, counter-clockwise seen from its front."""
        points = np.asarray(corners, np.float64)
        across, up = points[1] - points[0], points[3] - points[0]
        width, height = float(np.linalg.norm(across)), float(np.linalg.norm(up))
        front = np.cross(across, up) / (width * height)
        matrix = np.eye(4)
        # -Z is the front, so X points against `across` to keep the frame right-handed.
        matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = -across / width, up / height, -front
        matrix[:3, 3] = points.mean(axis=0)
        return cls((width, height), matrix)


def add_area_light(
    name: str, radiance: Sequence[float], rectangle: Rectangle, scene: bpy.types.Scene | None = None
) -> bpy.types.Object:
    """Add an emissive rectangle, which cameras and mirrors see; its back is black.

    Args:
        name: name of the new object.
        radiance: rgb, W/(m² sr), of its front.
        rectangle: its size and place.
        scene: the context's scene by default.
    """
    x, y = 0.5 * rectangle.size[0], 0.5 * rectangle.size[1]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-x, -y, 0.0), (-x, y, 0.0), (x, y, 0.0), (x, -y, 0.0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(emission_material(name, list(radiance), [0.0, 0.0, 0.0]))
    item = bpy.data.objects.new(name, mesh)
    collection(scene or bpy.context.scene, LIGHTS).objects.link(item)
    item.matrix_world = Matrix(np.asarray(rectangle.matrix, np.float64).tolist())
    return item
