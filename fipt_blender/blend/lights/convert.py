"""Replaces a fixture's emission by Blender lights of the same radiance and shape, and reverts that.

Blender lights can be aimed and shaped, and only they light the room in EEVEE. Cameras don't see them, so the
fixture's surface stays, visible to cameras alone.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix
from mathutils.geometry import box_fit_2d

from ...core.run.errors import FiptError
from ..marks import (
    AS_CONVERTED,
    BACK,
    BASE,
    CATCHER,
    FIXTURE,
    FIXTURE_LIGHT,
    FIXTURE_SOURCES,
    VISIBILITY,
    fixture_lights,
    remove_marks,
)
from ..outliner import FIXTURES, collection, remove_object
from ..room.islands import connected_triangles
from ..room.mesh_arrays import (
    corner_vertices,
    polygon_slots,
    transform_points,
    triangle_loops,
    vertex_positions,
)
from . import light_state
from .area_lights import shaped_light
from .fixture_nodes import surfaces
from .power import world_matrix

RAYS = ("visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter",
        "visible_shadow")  # fmt: skip
_SHAPE_FIELDS = ("size", "size_y", "spread", "shadow_soft_size", "exposure", "use_shadow", "use_temperature")
_KINDS = ("", "POINT", "SUN", "SPOT", "AREA", "SQUARE", "RECTANGLE", "DISK", "ELLIPSE")


@dataclass(frozen=True)
class Shape:
    """A Blender light that stands for one piece of a surface.

    Attributes:
        kind: "RECTANGLE" or "ELLIPSE" (area lights), or "POINT".
        matrix: (4,4) object to world; area lights shine along -Z.
        size: width and height, or the diameter twice, in metres.
        area: area of the piece, m²; the light's power is pi times area times radiance.
        exact: whether the light has the shape of the piece; otherwise it only has its power.
    """

    kind: str
    matrix: np.ndarray
    size: tuple[float, float]
    area: float
    exact: bool


def fixture_to_lights(scene: bpy.types.Scene, item: bpy.types.Object) -> tuple[list[bpy.types.Object], bool]:
    """Let Blender lights emit in place of a fixture, whose surface is then visible to cameras only.

    Args:
        scene: the fixture's scene.
        item: the fixture; an earlier conversion is replaced.

    Returns:
        The lights, children of the fixture, and whether they emit exactly as the fixture does, which is so
        where its pieces are rectangles, ellipses or spheres.
    """
    lights_to_fixture(scene, item)
    vertices, triangles = world_triangles(item)
    slot = polygon_slots(item.data)[triangle_loops(item.data, mirrored=False)[1]]
    emitted = [
        (shape, sides)
        for chosen, sides in _emission(item, slot)
        for shape in fit_shapes(vertices, triangles[chosen])
    ]
    if not emitted:
        raise FiptError("fixture-empty", name=item.name)
    target = collection(scene, FIXTURES)
    lights = []
    for shape, sides in emitted:
        for radiance, backwards in zip(sides, (False, True), strict=True):
            # The back of a ball is its inside, which does not light the room.
            if max(radiance) > 0.0 and not (backwards and shape.kind == "POINT"):
                lights.append(_add_light(item, shape, list(radiance), backwards, target))
    item[AS_CONVERTED] = len(lights)
    item[VISIBILITY] = json.dumps({name: getattr(item, name) for name in RAYS})
    for name in RAYS:
        setattr(item, name, False)
    light_state.refresh(scene)
    return lights, all(shape.exact for shape, _ in emitted)


def _emission(
    item: bpy.types.Object, slot: np.ndarray
) -> list[tuple[np.ndarray, tuple[Sequence[float], Sequence[float]]]]:
    """Triangles ((T,) bool) of each surface of a fixture with the radiances of its front and back.

    A fixture without its material has one surface.
    """
    found = surfaces(item)
    if len(found) > 1:
        return [(slot == each.slot, (each.front, each.back)) for each in found]
    sides = tuple(list(item.get(key, (0.0, 0.0, 0.0))) for key in (BASE, BACK))
    return [(np.ones(len(slot), bool), (sides[0], sides[1]))]


def lights_to_fixture(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Let a fixture's surface emit again, and remove its Blender lights, if any."""
    for light in fixture_lights(item):
        remove_object(light)
    if VISIBILITY in item:
        for name, value in json.loads(item[VISIBILITY]).items():
            setattr(item, name, value)
        remove_marks(item, VISIBILITY, AS_CONVERTED)
    light_state.refresh(scene)


def lights_as_converted(scene: bpy.types.Scene, item: bpy.types.Object) -> bool:
    """Whether the Blender lights of a fixture are as `fixture_to_lights` has made them.

    Power and colour from the panel are no change. A light that was moved, reshaped, hidden, deleted or given
    another power in Blender's own fields is one.
    """
    lights = fixture_lights(item)
    return len(lights) == item.get(AS_CONVERTED) and all(
        AS_CONVERTED in light
        and not light.hide_render
        and np.allclose(
            light[AS_CONVERTED], _shape_and_place(light, light.matrix_local), rtol=1e-3, atol=1e-4
        )
        and light_state.has_set_power(scene, item, light)
        for light in lights
    )


def _shape_and_place(light: bpy.types.Object, matrix: Matrix) -> list[float]:
    """What determines the light of a Blender light besides its power, given its matrix to the fixture."""
    data = light.data
    numbers = [getattr(data, name, 0.0) for name in _SHAPE_FIELDS]
    kinds = [_KINDS.index(data.type), _KINDS.index(getattr(data, "shape", ""))]
    nodes = 0 if data.node_tree is None else len(data.node_tree.nodes)
    return [
        *map(float, numbers),
        *map(float, kinds),
        float(nodes),
        *(value for row in matrix for value in row),
    ]


def _add_light(
    item: bpy.types.Object, shape: Shape, radiance: list[float], backwards: bool, target: bpy.types.Collection
) -> bpy.types.Object:
    """Add a Blender light of a shape as a fixture's child; `backwards` it shines from the shape's back."""
    light = shaped_light(f"{item.name} Light", shape.kind, *shape.size)
    light[FIXTURE_LIGHT] = item[FIXTURE]
    light[FIXTURE_SOURCES] = item[FIXTURE_SOURCES]
    light[BASE] = [math.pi * shape.area * value for value in radiance]
    light.lightgroup = item.lightgroup
    if CATCHER in item:  # the photograph is the backdrop, and shows this light already
        light.is_shadow_catcher = light[CATCHER] = True
    target.objects.link(light)
    light.parent = item
    matrix = shape.matrix.copy()
    if backwards:
        matrix[:3, 0], matrix[:3, 2] = -matrix[:3, 0], -matrix[:3, 2]
    # The fixture may have just been made or moved: its matrix_world may be out of date.
    light.matrix_parent_inverse = item.matrix_basis.inverted() if item.parent is None else Matrix()
    light.matrix_basis = Matrix(matrix.tolist())
    if item.parent is not None:
        light.matrix_world = Matrix(matrix.tolist())
    light[AS_CONVERTED] = _shape_and_place(light, world_matrix(item).inverted() @ Matrix(matrix.tolist()))
    return light


def world_triangles(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """World positions of a fixture's vertices (V,3) and its triangles (T,3)."""
    mesh = item.data
    loops, _ = triangle_loops(mesh, mirrored=False)
    matrix = np.array(world_matrix(item), np.float64)
    return transform_points(vertex_positions(mesh), matrix), corner_vertices(mesh)[loops]


def fit_shapes(vertices: np.ndarray, triangles: np.ndarray) -> list[Shape]:
    """Lights in the shape of a surface: one for each connected piece, or a single one if there are many.

    Args:
        vertices: (V,3) world positions; vertices at the same position count as one.
        triangles: (T,3), counter-clockwise seen from the front.
    """
    vector_area = vector_areas(vertices, triangles)
    has_area = np.linalg.norm(vector_area, axis=1) > 1e-12
    triangles, vector_area = triangles[has_area], vector_area[has_area]
    if not len(triangles):
        return []
    _, position_id = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    piece = connected_triangles(position_id.reshape(-1)[triangles])
    if piece.max() >= 16:
        piece = np.zeros_like(piece)
    members = [piece == index for index in range(piece.max() + 1)]
    return [_fit_shape(vertices[triangles[member]], vector_area[member]) for member in members]


def vector_areas(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T,3) normals of triangles, as long as the triangles' areas in m².

    Args:
        vertices: (V,3) metres.
        triangles: (T,3), counter-clockwise seen from the front.
    """
    corners = vertices[triangles]
    return 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def is_closed(vector_area: np.ndarray) -> bool:
    """Whether a surface encloses a volume, given the vector areas (T,3) of its triangles."""
    return _openness(vector_area) < 0.5


def _openness(vector_area: np.ndarray) -> float:
    """1 for a plane, 0 for a closed surface: length of the sum of vector areas (T,3) over the area."""
    area = np.linalg.norm(vector_area, axis=1).sum()
    return float(np.linalg.norm(vector_area.sum(axis=0)) / max(area, 1e-12))


def _fit_shape(corners: np.ndarray, vector_area: np.ndarray) -> Shape:
    """The light for one piece, given its triangles (T,3,3) and their vector areas (T,3)."""
    areas = np.linalg.norm(vector_area, axis=1)
    area = float(areas.sum())
    front = vector_area.sum(axis=0)
    center = (corners.mean(axis=1) * areas[:, None]).sum(axis=0) / area
    if is_closed(vector_area):
        distance = np.linalg.norm(corners.reshape(-1, 3) - center, axis=1)
        radius = math.sqrt(area / (4.0 * math.pi))
        matrix = np.eye(4)
        matrix[:3, 3] = center
        exact = _openness(vector_area) < 0.05 and float(distance.std()) < 0.05 * float(distance.mean())
        return Shape("POINT", matrix, (2.0 * radius, 2.0 * radius), area, exact)
    front = front / np.linalg.norm(front)
    across, up = _plane_axes(front)
    outline = np.stack([corners.reshape(-1, 3) @ across, corners.reshape(-1, 3) @ up], axis=1)
    # The angle by which the points fit into the smallest box; Blender computes in single precision.
    angle = box_fit_2d((outline - outline.mean(axis=0)).tolist())
    box = _box(outline, np.array([math.cos(angle), -math.sin(angle)]))
    is_ellipse = _is_ellipse(area, box)
    if is_ellipse:
        # No edge of a polygon around an ellipse need be parallel to the ellipse's axes.
        by_axes = _box(outline, _long_axis(outline.reshape(-1, 3, 2), areas))
        box = by_axes if _is_ellipse(area, by_axes) else box
    depth = corners.reshape(-1, 3) @ front
    # Flat: all face normals are within 2.5 degrees of their mean.
    flat = bool((vector_area @ front > 0.999 * areas).all()) and np.ptp(depth) < 0.01 * max(box.size)
    exact = flat and (is_ellipse or area > 0.97 * math.prod(box.size))
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 2] = box.direction[0] * across + box.direction[1] * up, -front
    matrix[:3, 1] = np.cross(matrix[:3, 2], matrix[:3, 0])
    matrix[:3, 3] = box.center[0] * across + box.center[1] * up + front * float(depth.max())
    return Shape("ELLIPSE" if is_ellipse else "RECTANGLE", matrix, box.size, area, exact)


@dataclass(frozen=True)
class _Box:
    """A rectangle around points of a plane: the unit direction of its width, its centre, width and height."""

    direction: np.ndarray
    center: np.ndarray
    size: tuple[float, float]


def _is_ellipse(area: float, box: _Box) -> bool:
    """Whether an outline of this area fills its box as an ellipse does."""
    return abs(area / math.prod(box.size) - 0.25 * math.pi) < 0.03


def _plane_axes(front: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3,) that are perpendicular to `front` and to each other."""
    helper = np.array([1.0, 0.0, 0.0] if abs(front[0]) < 0.7 else [0.0, 1.0, 0.0])
    across = np.cross(helper, front)
    across /= np.linalg.norm(across)
    return across, np.cross(front, across)


def _long_axis(triangles: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """The direction (2,) in which a surface of triangles (T,3,2) extends most, by its second moments."""
    middle = triangles.mean(axis=1)
    center = (middle * areas[:, None]).sum(axis=0) / areas.sum()
    points = np.concatenate([triangles, 3.0 * middle[:, None]], axis=1)
    points[:, :3] -= center
    points[:, 3] -= 3.0 * center
    moments = np.einsum("t,tpi,tpj->ij", areas, points, points)
    direction: np.ndarray = np.linalg.eigh(moments)[1][:, 1]
    return direction


def _box(outline: np.ndarray, direction: np.ndarray) -> _Box:
    """The smallest rectangle around points (P,2) with a side along a unit direction (2,)."""
    axes = np.array([direction, [-direction[1], direction[0]]])
    places = outline @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    return _Box(direction, axes.T @ (0.5 * (low + high)), (float(high[0] - low[0]), float(high[1] - low[1])))
