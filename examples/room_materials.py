"""The example room's materials in the paper's parameters, as plain data and as Principled node trees.

A material is base colour (constant or texture), roughness and metallic; fixtures emit and reflect nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy

SEMANTIC_CLASSES = {
    1: "emitter",
    2: "wall",
    3: "floor",
    4: "ceiling",
    5: "window",
    6: "cabinet",
    7: "table",
    8: "seat",
    9: "picture",
    10: "lamp",
    11: "mirror",
    12: "appliance",
    14: "plant",
    15: "book",
    16: "object",
}


@dataclass(frozen=True)
class RoomMaterial:
    """`base_color` is linear albedo; `texture` names one of room_textures.MAKERS instead."""

    name: str
    semantic: int
    base_color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    roughness: float = 1.0
    metallic: float = 0.0
    texture: str | None = None
    radiance: tuple[float, float, float] | None = None


def _fixture(name: str, radiance: tuple[float, float, float]) -> RoomMaterial:
    return RoomMaterial(name, 1, (0.0, 0.0, 0.0), radiance=radiance)


_M = RoomMaterial
MATERIALS = [
    _M("WallPaint", 2, (0.66, 0.61, 0.53)),
    _M("WallAccent", 2, (0.17, 0.31, 0.33)),
    _M("CeilingPaint", 4, (0.76, 0.75, 0.72)),
    _M("GlossPaint", 2, (0.70, 0.69, 0.65), 0.4),
    _M("FloorPlanks", 3, roughness=0.3, texture="floor"),
    _M("Rug", 3, texture="rug"),
    _M("SofaCloth", 8, texture="sofa"),
    _M("ArmchairCloth", 8, texture="armchair"),
    _M("StripedCloth", 8, texture="striped"),
    _M("ZigzagCloth", 8, texture="zigzag"),
    _M("CoralCloth", 8, (0.56, 0.17, 0.10)),
    _M("CurtainLinen", 5, texture="curtain"),
    _M("Walnut", 7, roughness=0.45, texture="walnut"),
    _M("Oak", 6, roughness=0.55, texture="oak"),
    _M("CabinetLacquer", 6, (0.055, 0.11, 0.19), 0.2),
    _M("BrushedSteel", 7, (0.60, 0.59, 0.57), 0.35, 1.0),
    _M("Brass", 16, (0.78, 0.57, 0.30), 0.3, 1.0),
    _M("MirrorSilver", 11, (0.88, 0.88, 0.87), 0.06, 1.0),
    _M("GiltFrame", 9, (0.66, 0.47, 0.22), 0.4, 1.0),
    _M("BlackFrame", 9, (0.045, 0.042, 0.04), 0.3),
    _M("Mount", 9, (0.72, 0.70, 0.65)),
    _M("Landscape", 9, texture="landscape"),
    _M("AbstractA", 9, texture="abstract_a"),
    _M("AbstractB", 9, texture="abstract_b"),
    _M("WindowPane", 5, (0.035, 0.045, 0.06), 0.15),
    _M("RadiatorEnamel", 12, (0.72, 0.72, 0.70), 0.3),
    _M("BookCovers", 15, texture="books"),
    _M("BookPages", 15, (0.66, 0.60, 0.48)),
    _M("GlazeGreen", 16, (0.10, 0.26, 0.20), 0.15),
    _M("GlazeWhite", 16, (0.72, 0.71, 0.68), 0.2),
    _M("LampGlaze", 10, (0.42, 0.15, 0.08), 0.2),
    _M("ShadeOutside", 10, (0.60, 0.50, 0.36)),
    _M("ShadeInside", 10, (0.74, 0.72, 0.68)),
    _M("Terracotta", 14, (0.45, 0.20, 0.12)),
    _M("Soil", 14, (0.06, 0.045, 0.035)),
    _M("LeafDark", 14, (0.06, 0.17, 0.045), 0.5),
    _M("LeafLight", 14, (0.16, 0.30, 0.07), 0.5),
    _M("FruitOrange", 16, (0.62, 0.25, 0.045), 0.5),
    _M("FruitApple", 16, (0.42, 0.07, 0.05), 0.3),
    _M("ClockFace", 16, (0.70, 0.68, 0.62)),
    _M("Wicker", 16, (0.38, 0.25, 0.13)),
    _fixture("CeilingPanelLight", (62.0, 58.0, 52.0)),
    _fixture("BulbLight", (1300.0, 900.0, 500.0)),
]


def make_principled(material: RoomMaterial, textures: Path) -> bpy.types.Material:
    """The Blender material; the emission is the Principled's, strength = radiance."""
    made = bpy.data.materials.new(material.name)
    if made.node_tree is None:
        made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*material.base_color, 1.0)
    shader.inputs["Roughness"].default_value = material.roughness
    shader.inputs["Metallic"].default_value = material.metallic
    if material.radiance is not None:
        strength = max(material.radiance)
        shader.inputs["Emission Color"].default_value = (*(c / strength for c in material.radiance), 1.0)
        shader.inputs["Emission Strength"].default_value = strength
    if material.texture is not None:
        node = nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.load(str(textures / f"{material.texture}.png"))
        node.image.colorspace_settings.name = "sRGB"
        node.location = (-320, 200)
        links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return made
