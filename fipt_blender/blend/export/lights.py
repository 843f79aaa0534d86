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
from ..lights.area_lights import area_light_watts
from ..lights.tint import split

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
        "glTF has no size of these lights: their shadows have hard edges.",
        "Export USD, or use area lights.",
    ),
}
# Blender's exporter of USD divides the strength of suns by this, which UsdLux does not know.
_USD_SUN = 4.0
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
    lost.add(
        name,
        {
            "export-light-nodes": not _node_factor(light)[1],
            "export-light-spread": light.type == "AREA" and light.spread < math.pi - 1e-4,
            "export-light-rays": not (light.use_shadow and item.visible_diffuse and item.visible_glossy)
            or bool(linked)
            or light.energy < 0.0,
            "export-light-edges": light.type == "SPOT" and (light.spot_blend > 0.0 or squashed),
            "export-light-size": gltf and getattr(light, size) > least,
        },
    )


def is_plain_area(item: bpy.types.Object) -> bool:
    """Whether USD has a light of this shape: a rectangle or a disk."""
    across, up = _axes(item)
    square = abs(across.dot(up)) <= 1e-4 * across.length * up.length
    round_shape = item.data.shape in ("DISK", "ELLIPSE")
    return square and (not round_shape or math.isclose(across.length, up.length, rel_tol=1e-3))


def plain_light(item: bpy.types.Object, gltf: bool) -> bpy.types.Light:
    """A new light of the same light, without nodes and scale, for the matrix of `turned`."""
    light = item.data
    made = bpy.data.lights.new(light.name, light.type)
    if made.node_tree is not None:  # exporters of some versions take the color of these nodes, white
        made.node_tree.nodes.clear()
    made.color, made.energy = split(np.maximum(emitted_power(item), 0.0).tolist())
    if light.type == "SUN" and not gltf:
        made.energy *= _USD_SUN
    if light.type == "AREA":
        across, up = _axes(item)
        made.shape = "DISK" if light.shape in ("DISK", "ELLIPSE") else "RECTANGLE"
        made.size, made.size_y = 2.0 * across.length, 2.0 * up.length
    for name in ("angle", "shadow_soft_size", "use_soft_falloff", "spot_size", "spot_blend"):
        if hasattr(light, name):
            setattr(made, name, getattr(light, name))
    return made


def turned(matrix: Matrix) -> Matrix:
    """A matrix to the world without scale, shear and mirroring, along whose -Z a light shines."""
    across, back = matrix.col[0].to_3d().normalized(), matrix.col[2].to_3d().normalized()
    up = back.cross(across).normalized()
    rotation = Matrix((up.cross(back), up, back)).transposed().to_4x4()
    rotation.translation = matrix.translation
    return rotation


def area_surface(item: bpy.types.Object) -> tuple[bpy.types.Mesh, tuple[float, ...]]:
    """A new mesh of an area light in the frame of `turned`, and the radiance (rgb) of its front."""
    inverse = turned(item.matrix_world).to_3x3().transposed()
    across, up = (inverse @ axis for axis in _axes(item))
    if across.cross(up).z < 0.0:
        up = -up
    area = 4.0 * across.length * up.length  # Cycles' area, also of a sheared light
    if item.data.shape in ("DISK", "ELLIPSE"):
        turns = [2.0 * math.pi * step / 32 for step in range(32)]
        points = [across * math.cos(turn) - up * math.sin(turn) for turn in turns]
        area *= 0.25 * math.pi
    else:
        points = [-across - up, -across + up, across + up, across - up]
    mesh = bpy.data.meshes.new(item.data.name)
    mesh.from_pydata(points, [], [tuple(range(len(points)))])
    # A polygon is smaller than its ellipse; the power stays.
    area *= mesh.polygons[0].area / _outline_area(item, across, up)
    radiance = np.maximum(emitted_power(item), 0.0) / max(area_light_watts(1.0, area), 1e-12)
    return mesh, tuple(radiance.tolist())


def _outline_area(item: bpy.types.Object, across: Vector, up: Vector) -> float:
    share = math.pi if item.data.shape in ("DISK", "ELLIPSE") else 4.0
    return max(share * float(across.cross(up).length), 1e-12)


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
