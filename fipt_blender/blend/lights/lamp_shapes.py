# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Simple shapes of lamps: the rectangle, disc, tube or ball that fits the ragged surface of a scanned lamp.

Shapes are fitted by the moments of the surface, to which a ragged border adds little.
"""

from __future__ import annotations

from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from mathutils import Matrix

from ...core.run.errors import FiptError
from ..marks import BACK, BASE, remove_marks
from .convert import is_closed, vector_areas
from .power import world_matrix

# Ratio of the variances along and across a closed surface from which it is a tube.
_LONG = 3.0
# Fourth moment over squared variance along the sides: 1.8 for a rectangle, 2 for an ellipse.
_ROUND = 1.9
# Share of the surface that must lie on the shape, and the margin, as a share of its size.
_FITS, _MARGIN = 0.85, 0.1
# The surface's area as a share of the shape's: less has gaps, more is folded or has a back.
_FILLED = (0.6, 1.7)


@dataclass(frozen=True)
class LampShape:
    """A shape in its own coordinates.

    Attributes:
        kind: "RECTANGLE" or "ELLIPSE", which face along Z, "TUBE" along Z, or "BALL".
        size: (3,) extent along X, Y and Z, metres; flat shapes have none along Z.
        matrix: (4, 4) shape to world, without scale.
    """

    kind: str
    size: np.ndarray
    matrix: np.ndarray


def fit_lamp_shape(vertices: np.ndarray, triangles: np.ndarray) -> LampShape:
    """The simple shape of a surface.

    Args:
        vertices: (V,3) world positions. triangles: (T,3), counter-clockwise seen from the front.

    Raises:
        FiptError: ``shape-unclear`` where none fits, ``fixture-empty`` where there is no surface.
    """
    corners = vertices[triangles].astype(np.float64)
    vector_area = vector_areas(vertices.astype(np.float64), triangles)
    area = np.linalg.norm(vector_area, axis=1)
    if not area.sum() > 0.0:
        raise FiptError("fixture-empty", "The lamp has no surface.", "Choose another fixture.")
    points, weight = _points(corners, area)
    middle = weight @ points
    front = vector_area.sum(axis=0)
    closed = is_closed(vector_area)
    shape = _closed_shape(points, weight, middle) if closed else _flat_shape(points, weight, middle, front)
    filled = float(area.sum()) / _shape_area(shape)
    if weight @ _on_shape(shape, points) < _FITS or not _FILLED[0] < filled < _FILLED[1]:
        raise FiptError(
            "shape-unclear",
            "No rectangle, disc, tube or ball fits this lamp.",
            "Change its mesh in Edit Mode, or keep it as it is.",
        )
    return shape


def _points(corners: np.ndarray, area: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N,3) on triangles and their shares (N,) of the area."""
    if len(corners) > 500:
        return corners.mean(axis=1), area / area.sum()
    n = 8  # divisions of the edges of few triangles, to have points enough
    cells = [((3 * i + 1) / (3 * n), (3 * j + 1) / (3 * n)) for i in range(n) for j in range(n - i)]
    cells += [((3 * i + 2) / (3 * n), (3 * j + 2) / (3 * n)) for i in range(n) for j in range(n - i - 1)]
    u, v = np.array(cells).T[:, :, None]
    points = (1.0 - u - v) * corners[:, None, 0] + u * corners[:, None, 1] + v * corners[:, None, 2]
    return points.reshape(-1, 3), np.repeat(area / (len(cells) * area.sum()), len(cells))


def _flat_shape(points: np.ndarray, weight: np.ndarray, middle: np.ndarray, front: np.ndarray) -> LampShape:
    front = front / np.linalg.norm(front)
    offset = points - middle
    offset = offset - (offset @ front)[:, None] * front
    variance, axes = np.linalg.eigh((offset * weight[:, None]).T @ offset)
    spread = np.sqrt(np.maximum(variance[1:], 1e-30))
    plane = offset @ axes[:, 1:] / spread  # an ellipse becomes a disc, a rectangle a square
    angles = np.radians(np.arange(90)) if spread[1] < 1.1 * spread[0] else np.zeros(1)
    fourth = [float(weight @ (turned**4).sum(axis=1)) / 2.0 for turned in (plane @ _turn(a) for a in angles)]
    best = int(np.argmin(fourth))
    directions = axes[:, 1:] @ _turn(angles[best])
    is_round = fourth[best] > _ROUND
    width = spread * (4.0 if is_round else np.sqrt(12.0))
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 2] = directions[:, 0], front
    matrix[:3, 1] = np.cross(front, directions[:, 0])
    matrix[:3, 3] = middle
    return LampShape("ELLIPSE" if is_round else "RECTANGLE", np.array([*width, 0.0]), matrix)


def _turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _closed_shape(points: np.ndarray, weight: np.ndarray, middle: np.ndarray) -> LampShape:
    offset = points - middle
    variance, axes = np.linalg.eigh((offset * weight[:, None]).T @ offset)
    matrix = np.eye(4)
    matrix[:3, 3] = middle
    if variance[2] < _LONG * 0.5 * (variance[0] + variance[1]):
        radius = float(np.sqrt(variance.sum()))  # every point of a ball has the same distance
        return LampShape("BALL", np.full(3, 2.0 * radius), matrix)
    matrix[:3, 2], matrix[:3, 0] = axes[:, 2], axes[:, 0]
    matrix[:3, 1] = np.cross(axes[:, 2], axes[:, 0])
    width = 2.0 * float(np.sqrt(variance[0] + variance[1]))
    return LampShape("TUBE", np.array([width, width, float(np.sqrt(12.0 * variance[2]))]), matrix)


def _shape_area(shape: LampShape) -> float:
    """Area in m2, of a tube without its ends."""
    x, y, z = (float(value) for value in shape.size)
    areas = {"RECTANGLE": x * y, "ELLIPSE": 0.25 * np.pi * x * y, "TUBE": np.pi * x * z, "BALL": np.pi * x**2}
    return max(areas[shape.kind], 1e-12)


def _on_shape(shape: LampShape, points: np.ndarray) -> np.ndarray:
    """(N,) bool, points that lie on a shape or nearly so."""
    local = (points - shape.matrix[:3, 3]) @ shape.matrix[:3, :3]
    half = 0.5 * shape.size
    if shape.kind == "BALL":
        distance = np.linalg.norm(local, axis=1)
        return np.asarray(np.abs(distance - half[0]) < 3.0 * _MARGIN * half[0])
    if shape.kind == "TUBE":
        distance = np.linalg.norm(local[:, :2], axis=1)
        on_side = np.abs(distance - half[0]) < 4.0 * _MARGIN * half[0]
        return np.asarray(on_side & (np.abs(local[:, 2]) < (1.0 + _MARGIN) * half[2]))
    scaled = np.abs(local[:, :2]) / half[:2]
    reach = np.linalg.norm(scaled, axis=1) if shape.kind == "ELLIPSE" else scaled.max(axis=1)
    near = np.abs(local[:, 2]) < 2.0 * _MARGIN * float(half[:2].max())
    return np.asarray((reach < 1.0 + _MARGIN) & near)


def shape_mesh(name: str, shape: LampShape) -> bpy.types.Mesh:
    """A new mesh of a shape in its own coordinates, fronts outwards or along Z."""
    mesh = bpy.data.meshes.new(name)
    x, y, z = (float(value) for value in 0.5 * shape.size)
    if shape.kind == "RECTANGLE":
        mesh.from_pydata([(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)], [], [(0, 1, 2, 3)])
        return mesh
    made = bmesh.new()
    if shape.kind == "ELLIPSE":
        bmesh.ops.create_circle(made, cap_ends=True, segments=32, radius=1.0)
        # A polygon of the circle's area.
        x, y = (r * np.sqrt(2.0 * np.pi / (32 * np.sin(2.0 * np.pi / 32))) for r in (x, y))
        bmesh.ops.transform(made, matrix=Matrix.Diagonal((x, y, 1.0, 1.0)), verts=made.verts)
    elif shape.kind == "TUBE":
        bmesh.ops.create_cone(made, cap_ends=True, segments=32, radius1=x, radius2=x, depth=2.0 * z)
    else:
        bmesh.ops.create_uvsphere(made, u_segments=32, v_segments=16, radius=x)
    made.normal_update()
    made.to_mesh(mesh)
    made.free()
    return mesh


def clean_fixture(item: bpy.types.Object, vertices: np.ndarray, triangles: np.ndarray) -> LampShape:
    """Replace a fixture's mesh by the simple shape that fits it; materials and settings stay.

    Args:
        item: the fixture. vertices, triangles: its surface in the world.

    Raises:
        FiptError: ``shape-unclear``, ``fixture-empty``.
    """
    shape = fit_lamp_shape(vertices, triangles)
    before = item.data
    mesh = shape_mesh(before.name, shape)
    for material in before.materials[:1]:  # merged lamps become one surface of their mean radiance
        remove_marks(material, BASE, BACK)
        mesh.materials.append(material)
    mesh.transform(world_matrix(item).inverted() @ Matrix(shape.matrix.tolist()))
    item.data = mesh
    name = before.name
    if not before.users:
        bpy.data.meshes.remove(before)
        mesh.name = name
    return shape
