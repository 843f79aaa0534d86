"""The material of an emissive surface: a radiance for each side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy

from ..marks import BACK, BACKSIDE, BASE, FRONT, OUTPUT
from ..node_trees import node_tree
from ..shown import UNCHANGED, write_surface
from .tint import blender_color

_MIX = "FIPT Sides"
_SIDES = ((FRONT, "Front: strength is radiance"), (BACKSIDE, "Back: strength is radiance"))
_BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Surface:
    """What one material slot of a fixture emits as estimated; joined lamps have several.

    Attributes:
        slot: its index.
        material: made by `emission_material`.
        front, back: rgb radiance, W/(m² sr).
    """

    slot: int
    material: bpy.types.Material
    front: Sequence[float]
    back: Sequence[float]


def surfaces(item: bpy.types.Object) -> list[Surface]:
    """The emitting surfaces of a fixture; none of a light, or where the artist has removed the materials.

    Materials carry their own radiances, so that fixtures can be joined; in older files, the object has them.
    """
    if item.type != "MESH":
        return []
    own = item.get(BASE, _BLACK), item.get(BACK, _BLACK)
    return [
        Surface(slot, material, material.get(BASE, own[0]), material.get(BACK, own[1]))
        for slot, material in enumerate(item.data.materials)
        if material is not None and material.node_tree is not None
    ]


def emission_material(
    name: str, radiance: Sequence[float], back_radiance: Sequence[float]
) -> bpy.types.Material:
    """A new material that emits.

    Args:
        name: name of the material.
        radiance, back_radiance: rgb emitted from the front (where normals point) and the back, W/(m² sr).
    """
    material = bpy.data.materials.new(name)
    tree = node_tree(material)
    nodes, links = tree.nodes, tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.name, output.location = OUTPUT, (400, 0)
    mix = nodes.new("ShaderNodeMixShader")
    mix.name, mix.location = _MIX, (200, 0)
    geometry = nodes.new("ShaderNodeNewGeometry")
    geometry.location = (-40, 260)
    links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    links.new(mix.outputs["Shader"], output.inputs["Surface"])
    sides = list(enumerate(_SIDES, start=1))
    if max(back_radiance) > max(radiance):
        sides.reverse()  # exporters such as glTF's take the first emission node for the material's emission
    for slot, (node_name, label) in sides:
        node = nodes.new("ShaderNodeEmission")
        node.name, node.label, node.location = node_name, label, (-40, 60 - 140 * (slot - 1))
        links.new(node.outputs["Emission"], mix.inputs[slot])
    write_radiance(material, radiance, back_radiance)
    return material


def write_radiance(
    material: bpy.types.Material, front: Sequence[float], back: Sequence[float], sampled: bool = True
) -> None:
    """Set the radiance of both sides.

    Args:
        material: made by `emission_material`; nodes that the artist has removed are skipped.
        front, back: rgb radiance, W/(m² sr).
        sampled: whether Cycles samples the surface as a light; false where Blender lights stand for it.
    """
    for (name, _), rgb in zip(_SIDES, (front, back), strict=True):
        node = material.node_tree.nodes.get(name)
        if node is not None:
            color, strength = blender_color(rgb)
            node.inputs["Color"].default_value = (*color, 1.0)
            node.inputs["Strength"].default_value = strength
    if hasattr(material, "cycles"):  # not where the Cycles add-on is disabled
        material.cycles.emission_sampling = emitting_sides(front, back) if sampled else "NONE"


def emitting_sides(front: Sequence[float], back: Sequence[float]) -> str:
    """Cycles' `emission_sampling` of a surface whose sides have these radiances."""
    return "FRONT" if max(back) <= 0.0 else "BACK" if max(front) <= 0.0 else "FRONT_BACK"


def node_strength(material: bpy.types.Material, back: bool) -> float | None:
    """Strength of a side's emission node; None where the artist has removed it."""
    node = material.node_tree.nodes.get(_SIDES[int(back)][0])
    return None if node is None else float(node.inputs["Strength"].default_value)


def write_shown(material: bpy.types.Material, shown: str) -> None:
    """Show the surface itself, or its value in the map that the room shows.

    Args:
        material: made by `emission_material`; lamps reflect nothing.
        shown: see `shown.write_surface`.
    """
    sides = [material.node_tree.nodes.get(name) for name, _ in _SIDES]
    emitting = (node for node in sides if node is not None and node.inputs["Strength"].default_value > 0.0)
    emission = next(emitting, None)
    black, white = (0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0, 1.0)
    color = black if emission is None else tuple(emission.inputs["Color"].default_value)
    constant = {"CONFIDENCE": white, "EMISSION": color}.get(shown, black)
    write_surface(material, shown, None, constant)
    material.diffuse_color = color if shown in UNCHANGED else constant


def is_emission_material(material: bpy.types.Material) -> bool:
    """Whether a material was made by `emission_material`, and still has its nodes."""
    nodes = material.node_tree.nodes if material.node_tree is not None else {}
    return any(name in nodes for name, _ in _SIDES)


def side_radiance(material: bpy.types.Material) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Radiance of the front and the back, scene-linear each, of an emission material as it is."""
    nodes = material.node_tree.nodes
    sides = []
    for name, _ in _SIDES:
        node = nodes.get(name)
        strength = 0.0 if node is None else node.inputs["Strength"].default_value
        color = (0.0, 0.0, 0.0) if node is None else node.inputs["Color"].default_value[:3]
        sides.append(tuple(float(strength * value) for value in color))
    return sides[0], sides[1]
