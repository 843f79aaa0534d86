# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's lights for other programs: all settings of Cycles in the few numbers that exporters carry."""

from __future__ import annotations

import math
from collections.abc import Mapping

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...bridge.process import Message
from ..lights.color import LUMINANCE
from ..lights.convert import is_closed, vector_areas, world_triangles
from ..lights.fixture_nodes import is_emission_material, side_radiance
from ..lights.tint import split
from ..room.mesh_arrays import polygon_slots, triangle_loops

# What files don't hold of lights, by code: text after the lights' names, and remedy.
_LOST = {
    "export-light-nodes": (
        "nodes of these lights (profiles, textures) are not in the file.",
        "Set their power and color without nodes.",
    ),
    "export-light-spread": (
        "the spread of these area lights is not in the file: they send the same power to all sides.",
        "Use spots, or shades that are modelled.",
    ),
    "export-light-rays": (
        "other programs know no lights without shadows, that light chosen objects or some rays alone, or of"
        " negative power.",
        "Set these lights back, or hide them in renders.",
    ),
    "export-light-edges": (
        "other programs blend the edge of these spots in another way, and know no spots that are scaled.",
        "Set Blend to 0 and remove the scale if the edge matters.",
    ),
    "export-light-size": (
        "glTF has no size of these lights: their shadows have hard edges, and area lights are wide spots.",
        "Export USD.",
    ),
    "export-light-shape": (
        "USD has no ellipses and no sheared lights: these are disks and rectangles of the same power.",
        "Use rectangles or disks without shear.",
    ),
}
# Blender's exporter of USD divides the strength of suns by this, which UsdLux does not know.
_USD_SUN = 4.0
# Metres by which the light of a lamp stands before its surface, which shadow maps would take for a blocker.
_BEFORE = 0.01
# Angle of the cone of a lamp's spot: browsers draw shadow maps of no hemisphere.
_CONE = math.radians(170.0)
# A lamp is a spot if its mean normal, weighted by power, is longer than this; a hemisphere's has 0.5.
_DIRECTED = 0.8
# Diameter of the sun as seen from the earth, radians. Suns as small are meant to be that.
_SUN = 0.0094


class Lost:
    """What a file does not hold of which lights."""

    def __init__(self) -> None:
        self._names: dict[str, list[str]] = {}

    def add(self, name: str, losses: Mapping[str, bool]) -> None:
        """Note a light's losses by code."""
        for code in (code for code, lost in losses.items() if lost):
            self._names.setdefault(code, []).append(name)

    def warnings(self) -> list[Message]:
        """A warning for each loss, which names the lights."""
        return [warning(code, f"{', '.join(names)}: {_LOST[code][0]}", _LOST[code][1])
                for code, names in self._names.items()]  # fmt: skip


def warning(code: str, text: str, remedy: str) -> Message:
    """A message of an export."""
    return {"type": "warning", "code": code, "text": text, "remedy": remedy}


def emits(item: bpy.types.Object) -> bool:
    """Whether a Blender light emits: portals of Cycles do not."""
    if item.data.type != "AREA" or not hasattr(bpy.types.Light, "cycles"):
        return True
    light = item.data.copy()  # reading Cycles' settings writes them to a light that has none
    portal = light.cycles.is_portal
    bpy.data.lights.remove(light)
    return not portal


def emitted_power(item: bpy.types.Object) -> np.ndarray:
    """(3,) rgb watts of a Blender light, W/m² of a sun: colour, temperature, exposure, size where the power
    is not normalized, and nodes that are constants."""
    light = item.data
    power = light.energy * 2.0 ** getattr(light, "exposure", 0.0) * np.array(light.color, np.float64)
    if getattr(light, "use_temperature", False):
        power *= np.array(light.temperature_color)
    if not getattr(light, "normalize", True):
        power *= light.area(matrix_world=item.matrix_world)
    return power * _node_factor(light)[0]


def note_losses(name: str, item: bpy.types.Object, gltf: bool, lost: Lost) -> None:
    """Note under a name what a file can't hold of a Blender light."""
    light, linking = item.data, getattr(item, "light_linking", None)
    linked = linking is not None and (linking.receiver_collection or linking.blocker_collection)
    sizes = {"SUN": ("angle", _SUN), "POINT": ("shadow_soft_size", 0.0), "SPOT": ("shadow_soft_size", 0.0)}
    size, least = sizes.get(light.type, ("size", math.inf))
    scale = item.matrix_world.to_scale()
    squashed = max(map(abs, scale)) > 1.001 * min(map(abs, scale))
    is_area = light.type == "AREA"
    lost.add(
        name,
        {
            "export-light-nodes": not _node_factor(light)[1],
            "export-light-spread": is_area and light.spread < math.pi - 1e-4,
            "export-light-rays": not (light.use_shadow and item.visible_diffuse and item.visible_glossy)
            or bool(linked)
            or light.energy < 0.0,
            "export-light-edges": light.type == "SPOT" and (light.spot_blend > 0.0 or squashed),
            "export-light-size": gltf and (is_area or getattr(light, size) > least),
            "export-light-shape": is_area and not gltf and not _is_plain_area(item),
        },
    )


def _is_plain_area(item: bpy.types.Object) -> bool:
    """Whether USD has a light of this shape: a rectangle or a disk."""
    across, up = _axes(item)
    square = abs(across.dot(up)) <= 1e-4 * across.length * up.length
    round_shape = item.data.shape in ("DISK", "ELLIPSE")
    return square and (not round_shape or math.isclose(across.length, up.length, rel_tol=1e-3))


def plain_light(item: bpy.types.Object, gltf: bool) -> bpy.types.Light:
    """A new light of the same light, without nodes and scale, for the matrix of `turned`."""
    light, watts = item.data, np.maximum(emitted_power(item), 0.0)
    if gltf and light.type == "AREA":
        return wide_spot(watts)
    made = _without_nodes(bpy.data.lights.new(light.name, light.type))
    made.color, made.energy = split(watts.tolist())
    if light.type == "SUN" and not gltf:
        made.energy *= _USD_SUN
    if light.type == "AREA":
        across, up = _axes(item)
        made.size, made.size_y = 2.0 * across.length, 2.0 * up.length
        made.shape = "RECTANGLE"
        if light.shape in ("DISK", "ELLIPSE"):
            made.shape, made.size = "DISK", math.sqrt(made.size * made.size_y)
    for name in ("angle", "shadow_soft_size", "use_soft_falloff", "spot_size", "spot_blend"):
        if hasattr(light, name):
            setattr(made, name, getattr(light, name))
    return made


def lamp_light(item: bpy.types.Object) -> tuple[bpy.types.Light, Matrix] | None:
    """A new light of the power and color of a fixture's surfaces, and its matrix to the world.

    It is a spot for a lamp that shines to one side, otherwise a point. None where nothing emits.
    """
    vertices, triangles = world_triangles(item)
    vectors = vector_areas(vertices, triangles)
    slots = polygon_slots(item.data)[triangle_loops(item.data, False)[1]]
    front, back = np.zeros((2, len(slots), 3))
    for index, slot in enumerate(item.material_slots):
        if slot.material is not None and is_emission_material(slot.material):
            front[slots == index], back[slots == index] = side_radiance(slot.material)
    if is_closed(vectors):
        back[:] = 0.0  # the inside
    areas = np.linalg.norm(vectors, axis=1)
    total = (front + back).T @ areas  # (3,) area times radiance
    weight = areas * ((front + back) @ LUMINANCE)
    if total.max(initial=0.0) <= 0.0:
        return None
    place = Vector((vertices[triangles].mean(axis=1).T @ weight / weight.sum()).tolist())
    axis = Vector((vectors.T @ ((front - back) @ LUMINANCE)).tolist())
    if axis.length <= _DIRECTED * weight.sum():
        light = bpy.data.lights.new("Light", "POINT")
        light.color, light.energy = split((math.pi * total).tolist())
        light.shadow_soft_size = 0.0
        return _without_nodes(light), Matrix.Translation(place)
    turn = axis.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    return wide_spot(math.pi * total), Matrix.Translation(place + _BEFORE * axis.normalized()) @ turn


def wide_spot(watts: np.ndarray) -> bpy.types.Light:
    """A new spot that sends out so many watts (rgb), as a surface sends them to its front.

    Its edge is blended over the whole cone: readers then show about the cosine of a surface. With a
    smoothstep of the cosine from that of the edge, e, to 1, a spot of intensity I sends out pi I (1 - e).
    Blender takes the power of a spot for that of a point light, 4 pi I.
    """
    light = bpy.data.lights.new("Light", "SPOT")
    light.color, light.energy = split((4.0 * watts / (1.0 - math.cos(0.5 * _CONE))).tolist())
    light.spot_size, light.spot_blend, light.shadow_soft_size = _CONE, 1.0, 0.0
    return _without_nodes(light)


def _without_nodes(light: bpy.types.Light) -> bpy.types.Light:
    """Without nodes, of which exporters of some versions take the color, white."""
    if light.node_tree is not None:
        light.node_tree.nodes.clear()
    return light


def turned(matrix: Matrix) -> Matrix:
    """A matrix to the world without scale, shear and mirroring, along whose -Z a light shines."""
    across, back = matrix.col[0].to_3d().normalized(), matrix.col[2].to_3d().normalized()
    up = back.cross(across).normalized()
    rotation = Matrix((up.cross(back), up, back)).transposed().to_4x4()
    rotation.translation = matrix.translation
    return rotation


def _axes(item: bpy.types.Object) -> tuple[Vector, Vector]:
    """Half the width and half the height of an area light, vectors in the world."""
    light, columns = item.data, item.matrix_world.col
    height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    return 0.5 * light.size * columns[0].to_3d(), 0.5 * height * columns[1].to_3d()


def _node_factor(light: bpy.types.Light) -> tuple[np.ndarray, bool]:
    """(3,) by which a light's nodes multiply its power, and whether that is all they do."""
    factor, tree = np.ones(3), light.node_tree
    # From Blender 5.0 on `use_nodes` is always true.
    if tree is None or (bpy.app.version < (5, 0) and not light.use_nodes):
        return factor, True
    output = tree.get_output_node("CYCLES")
    if output is None or not output.inputs["Surface"].is_linked:
        return (np.zeros(3), True) if len(tree.nodes) else (factor, True)
    emission = output.inputs["Surface"].links[0].from_node
    if emission.bl_idname != "ShaderNodeEmission":
        return factor, False
    color, strength = emission.inputs["Color"], emission.inputs["Strength"]
    if not color.is_linked:
        factor *= np.array(color.default_value[:3])
    if not strength.is_linked:
        factor *= strength.default_value
    return factor, not (color.is_linked or strength.is_linked)
