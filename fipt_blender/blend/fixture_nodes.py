# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The material of a surface that emits, each side with a radiance of its own, and may reflect as well."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from .shown import write_surface
from .tint import split

_REFLECTION = "FIPT Reflection"
_SIDES = (("FIPT Front", "Front: strength is radiance"), ("FIPT Back", "Back: strength is radiance"))


def emission_material(
    name: str,
    radiance: Sequence[float],
    back_radiance: Sequence[float],
    base_color: Sequence[float] = (0.0, 0.0, 0.0),
) -> bpy.types.Material:
    """A new material that emits.

    Args:
        name: of the material.
        radiance, back_radiance: rgb leaving the front (where normals point) and the back, W/(m² sr).
        base_color: rgb of the rough surface beneath; black reflects nothing.
    """
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.name, output.location = "FIPT Output", (400, 0)
    mix = nodes.new("ShaderNodeMixShader")
    mix.name, mix.location = "FIPT Sides", (200, 0)
    geometry = nodes.new("ShaderNodeNewGeometry")
    geometry.location = (-40, 260)
    links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    links.new(mix.outputs["Shader"], output.inputs["Surface"])
    for slot, (node_name, label) in enumerate(_SIDES, start=1):
        node = nodes.new("ShaderNodeEmission")
        node.name, node.label, node.location = node_name, label, (-40, 60 - 140 * (slot - 1))
        links.new(node.outputs["Emission"], mix.inputs[slot])
    if max(base_color) > 0.0:
        _add_reflection(material, base_color)
    write_radiance(material, radiance, back_radiance)
    return material


def _add_reflection(material: bpy.types.Material, base_color: Sequence[float]) -> None:
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = nodes.new("ShaderNodeBsdfPrincipled")
    principled.name, principled.location = _REFLECTION, (100, -220)
    principled.inputs["Base Color"].default_value = (*base_color, 1.0)
    principled.inputs["Roughness"].default_value = 1.0
    add = nodes.new("ShaderNodeAddShader")
    add.location = (300, 0)
    links.new(nodes["FIPT Sides"].outputs["Shader"], add.inputs[0])
    links.new(principled.outputs["BSDF"], add.inputs[1])
    links.new(add.outputs["Shader"], nodes["FIPT Output"].inputs["Surface"])


def write_radiance(
    material: bpy.types.Material, front: Sequence[float], back: Sequence[float], sampled: bool = True
) -> None:
    """Set what the two sides emit.

    Args:
        material: of `emission_material`; nodes that the artist took out are passed over.
        front, back: rgb radiance.
        sampled: whether Cycles aims at the surface; not where Blender lights stand for it.
    """
    for (name, _), rgb in zip(_SIDES, (front, back), strict=True):
        node = material.node_tree.nodes.get(name)
        if node is not None:
            color, strength = split(rgb)
            node.inputs["Color"].default_value = (*color, 1.0)
            node.inputs["Strength"].default_value = strength
    if hasattr(material, "cycles"):  # the Cycles add-on can be switched off
        sides = "FRONT" if max(back) <= 0.0 else "BACK" if max(front) <= 0.0 else "FRONT_BACK"
        material.cycles.emission_sampling = sides if sampled else "NONE"


def node_strength(material: bpy.types.Material, back: bool) -> float | None:
    """Strength of a side's node; None where the artist took it out."""
    node = material.node_tree.nodes.get(_SIDES[int(back)][0])
    return None if node is None else float(node.inputs["Strength"].default_value)


def write_shown(material: bpy.types.Material, shown: str) -> None:
    """Let the surface show itself, or what it has in the map that the room shows.

    Args:
        shown: see `shown.write_surface`. A lamp without reflection has a black base colour.
    """
    front = material.node_tree.nodes.get(_SIDES[0][0])
    back = material.node_tree.nodes.get(_SIDES[1][0])
    lit = next(
        (node for node in (front, back) if node is not None and node.inputs["Strength"].default_value > 0.0),
        None,
    )
    color = (0.0, 0.0, 0.0, 1.0) if lit is None else tuple(lit.inputs["Color"].default_value)
    black, white = (0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0, 1.0)
    below = material.node_tree.nodes.get(_REFLECTION)
    base_color = black if below is None else tuple(below.inputs["Base Color"].default_value)
    constant = {"CONFIDENCE": white, "EMISSION": color, "BASE_COLOR": base_color}.get(shown, black)
    write_surface(material, shown, None, constant)
    plain = shown in ("ESTIMATED", "ORIGINAL")
    material.diffuse_color = color if plain else constant
