"""What is in exported files: the JSON of glTF, and what Blender reads back."""

from __future__ import annotations

import json
import struct

import bpy
import numpy as np


def gltf_json(path):
    """The JSON chunk of a .glb file (glTF 2.0, chapter 4)."""
    content = path.read_bytes()
    magic, version, length = struct.unpack("<4sII", content[:12])
    size, kind = struct.unpack("<I4s", content[12:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(content), b"JSON")
    return json.loads(content[20 : 20 + size])


def opened(path):
    """The objects and materials of an exported file in an empty Blender."""
    bpy.ops.wm.read_homefile(use_empty=True)
    if path.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    else:
        bpy.ops.wm.usd_import(filepath=str(path))
    return bpy.data.objects, bpy.data.materials


def principled(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")


def texture_behind(socket):
    """The image that feeds an input, through other nodes."""
    node = socket.links[0].from_node
    while node.bl_idname != "ShaderNodeTexImage":
        node = node.inputs[0].links[0].from_node
    return node.image


def texel(image, uv):
    """The texel (3,) of an image at a place (2,)."""
    width, height = image.size
    start = image.channels * (int(uv[1] * height) * width + int(uv[0] * width))
    return np.array(image.pixels[start : start + 3])


def encoded(linear):
    """Linear values as sRGB's codes from 0 to 1."""
    linear = np.asarray(linear)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
