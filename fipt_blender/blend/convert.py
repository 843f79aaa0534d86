# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A fixture's light from Blender lights of the same radiance and shape, and back to its own surface.

Blender lights can be aimed, shaped and, in EEVEE, light the room at all. Cameras don't see them: the
fixture's surface stays for the camera alone.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ..core.job.errors import FiptError
from ..properties.lights import BACK, BASE, FIXTURE, FIXTURE_LIGHT, VISIBILITY
from . import light_state
from .originals import FIXTURE_SOURCES
from .outliner import FIXTURES, collection
from .packing import connected_triangles
from .room_export import triangle_loops

MAX_LIGHTS = 16
_RAYS = ("visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter",
         "visible_shadow")  # fmt: skip
_FLAT = 0.999  # cosine between a flat piece's faces
_FILL_RECTANGLE, _FILL_TOLERANCE = 0.97, 0.03


@dataclass
class Shape:
    """A Blender light that stands for one piece of a surface.

    Attributes:
        kind: "RECTANGLE" or "ELLIPSE" (area lights), or "POINT".
        matrix: (4,4) object to world; area lights shine along -Z.
        size: width and height, or the diameter twice, in metres.
        area: of the piece, m²; power is pi times area times radiance.
        exact: whether the light is the piece's, and not only of the same power.
    """

    kind: str
    matrix: np.ndarray
    size: tuple[float, float]
    area: float
    exact: bool


def fixture_to_lights(scene: bpy.types.Scene, item: bpy.types.Object) -> tuple[list[bpy.types.Object], bool]:
    """Let Blender lights give a fixture's light; only cameras then see its surface.

    Args:
        scene: of the fixture.
        item: the fixture; one that is converted already is converted anew.

    Returns:
        The lights, children of the fixture, and whether they give exactly its light: they do where its
        pieces are rectangles, ellipses or spheres.

    Raises:
        FiptError: ``fixture-empty`` where it has no surface.
    """
    lights_to_fixture(scene, item)
    shapes = fit_shapes(*_world_triangles(item))
    if not shapes:
        raise FiptError(
            "fixture-empty", f"'{item.name}' has no surface to make a light of.", "Choose another fixture."
        )
    target = collection(scene, FIXTURES)
    made = []
    for shape in shapes:
        for key, turn in ((BASE, False), (BACK, True)):
            radiance = list(item.get(key, (0.0, 0.0, 0.0)))
            # Either side of a ball is its outside or inside; only the outside lights the room.
            if max(radiance) > 0.0 and not (turn and shape.kind == "POINT"):
                made.append(_add_light(item, shape, radiance, turn, target))
    item[VISIBILITY] = json.dumps({name: getattr(item, name) for name in _RAYS})
    for name in _RAYS:
        setattr(item, name, False)
    light_state.refresh(scene)
    return made, all(shape.exact for shape in shapes)


def lights_to_fixture(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Let a fixture's own surface give its light again; does nothing where it does."""
    for light in light_state.fixture_lights(item):
        data = light.data
        bpy.data.objects.remove(light)
        if data.users == 0:
            bpy.data.lights.remove(data)
    if VISIBILITY in item:
        for name, value in json.loads(item[VISIBILITY]).items():
            setattr(item, name, value)
        del item[VISIBILITY]
    light_state.refresh(scene)


def _add_light(
    item: bpy.types.Object,
    shape: Shape,
    radiance: list[float],
    turn: bool,
    target: bpy.types.Collection,
) -> bpy.types.Object:
    name = f"{item.name} Light"
    if shape.kind == "POINT":
        data = bpy.data.lights.new(name, "POINT")
        data.shadow_soft_size = 0.5 * shape.size[0]
        if hasattr(data, "use_soft_falloff"):  # a ball's true falloff
            data.use_soft_falloff = False
    else:
        data = bpy.data.lights.new(name, "AREA")
        data.shape, data.size, data.size_y = shape.kind, *shape.size
    light = bpy.data.objects.new(name, data)
    light[FIXTURE_LIGHT] = item[FIXTURE]
    light[FIXTURE_SOURCES] = item[FIXTURE_SOURCES]
    light[BASE] = [math.pi * shape.area * value for value in radiance]
    light.lightgroup = item.lightgroup
    target.objects.link(light)
    light.parent = item
    matrix = shape.matrix.copy()
    if turn:
        matrix[:3, 0], matrix[:3, 2] = -matrix[:3, 0], -matrix[:3, 2]
    # item.matrix_world may be stale: the fixture may have been made or moved just now.
    light.matrix_parent_inverse = item.matrix_basis.inverted() if item.parent is None else Matrix()
    light.matrix_basis = Matrix(matrix.tolist())
    if item.parent is not None:
        light.matrix_world = Matrix(matrix.tolist())
    return light


def _world_triangles(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    mesh = item.data
    loops, _ = triangle_loops(mesh, mirrored=False)
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", vertex)
    points = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", points)
    matrix = np.array(item.matrix_basis if item.parent is None else item.matrix_world, np.float64)
    return points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3], vertex[loops]


def fit_shapes(vertices: np.ndarray, triangles: np.ndarray) -> list[Shape]:
    """Lights in the shape of a surface: one for each piece that hangs together, or one for all if many.

    Args:
        vertices: (V,3) world.
        triangles: (T,3), fronts counter-clockwise.
    """
    normal = 0.5 * np.cross(
        vertices[triangles[:, 1]] - vertices[triangles[:, 0]],
        vertices[triangles[:, 2]] - vertices[triangles[:, 0]],
    )
    kept = np.linalg.norm(normal, axis=1) > 1e-12
    triangles, normal = triangles[kept], normal[kept]
    if not len(triangles):
        return []
    _, same = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    piece = connected_triangles(same.reshape(-1)[triangles])
    if piece.max() >= MAX_LIGHTS:
        piece = np.zeros_like(piece)
    return [
        _fit(vertices[triangles[piece == each]], normal[piece == each]) for each in range(piece.max() + 1)
    ]


def _fit(corners: np.ndarray, normal: np.ndarray) -> Shape:
    """One piece from its triangles (T,3,3) and their vector areas (T,3)."""
    areas = np.linalg.norm(normal, axis=1)
    area = float(areas.sum())
    front = normal.sum(axis=0)
    openness = float(np.linalg.norm(front)) / area  # 1 for a plane, 0 for a closed surface
    centre = (corners.mean(axis=1) * areas[:, None]).sum(axis=0) / area
    if openness < 0.5:
        distance = np.linalg.norm(corners.reshape(-1, 3) - centre, axis=1)
        radius = math.sqrt(area / (4.0 * math.pi))
        matrix = np.eye(4)
        matrix[:3, 3] = centre
        exact = openness < 0.05 and float(distance.std()) < 0.05 * float(distance.mean())
        return Shape("POINT", matrix, (2.0 * radius, 2.0 * radius), area, exact)
    front = front / np.linalg.norm(front)
    flat = bool((normal @ front > _FLAT * areas).all())
    matrix, size = _bounding_rectangle(corners.reshape(-1, 3), front)
    thickness = np.ptp(corners.reshape(-1, 3) @ front)
    flat = flat and thickness < 0.01 * max(size)
    fill = area / (size[0] * size[1])
    is_ellipse = abs(fill - 0.25 * math.pi) < _FILL_TOLERANCE
    exact = flat and (fill > _FILL_RECTANGLE or is_ellipse)
    return Shape("ELLIPSE" if is_ellipse else "RECTANGLE", matrix, size, area, exact)


def _bounding_rectangle(points: np.ndarray, front: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """The smallest rectangle across `front` around points: its frame, -Z along `front`, and its size."""
    helper = np.array([1.0, 0.0, 0.0] if abs(front[0]) < 0.7 else [0.0, 1.0, 0.0])
    across = np.cross(helper, front)
    across /= np.linalg.norm(across)
    up = np.cross(front, across)
    flat = np.stack([points @ across, points @ up], axis=1)
    best = None
    # Straight edges first: a rectangle's own; then all directions, for round shapes.
    for angle in np.deg2rad(np.arange(0.0, 90.0, 0.5)):
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        low, high = (flat @ turn.T).min(axis=0), (flat @ turn.T).max(axis=0)
        rank = float((high - low).prod())
        if best is None or rank < best[0] * (1.0 - 1e-6):
            best = rank, turn, low, high
    assert best is not None
    _, turn, low, high = best
    x = turn[0, 0] * across + turn[0, 1] * up
    middle = turn.T @ (0.5 * (low + high))
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 2] = x, -front
    matrix[:3, 1] = np.cross(matrix[:3, 2], matrix[:3, 0])
    centre = middle[0] * across + middle[1] * up
    matrix[:3, 3] = centre + front * float((points @ front).max())
    return matrix, (float(high[0] - low[0]), float(high[1] - low[1]))
