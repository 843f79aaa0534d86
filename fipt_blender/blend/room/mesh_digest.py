"""Whether the artist has changed a result mesh since we made it, by a digest of its geometry and layers."""

from __future__ import annotations

import hashlib

import bpy
import numpy as np

from ..marks import MADE
from .mesh_arrays import polygon_starts

_OURS = ("FIPT", "fipt_")  # layers that results write
_TOPOLOGY = (".corner_vert", ".corner_edge", ".edge_verts")
_TYPES = {"FLOAT": np.float32, "INT": np.int32, "BOOLEAN": np.bool_}  # of a layer's values that count


def sign(mesh: bpy.types.Mesh) -> None:
    """Remember a result mesh as it is."""
    mesh[MADE] = _digest(mesh)


def is_edited(mesh: bpy.types.Mesh) -> bool:
    """Whether a result mesh was changed since `sign`; not known, and taken for no, of earlier versions."""
    return MADE in mesh and mesh[MADE] != _digest(mesh)


def _digest(mesh: bpy.types.Mesh) -> str:
    """Of positions, topology, all layers but ours, and what Blender stores beside them; not of selections."""
    digest = hashlib.blake2b(polygon_starts(mesh).tobytes(), digest_size=16)
    for layer in sorted(mesh.attributes, key=lambda each: each.name):
        if layer.name.startswith(_OURS) or (layer.name.startswith(".") and layer.name not in _TOPOLOGY):
            continue
        digest.update(f"{layer.name} {layer.data_type} {layer.domain} {len(layer.data)}".encode())
        for field in layer.data[0].bl_rna.properties if len(layer.data) else ():
            if field.identifier in ("value", "vector", "color") and field.type in _TYPES:
                values = np.empty(max(field.array_length, 1) * len(layer.data), _TYPES[field.type])
                layer.data.foreach_get(field.identifier, values)
                digest.update(values.tobytes())
    groups = [(each.group, each.weight) for vertex in mesh.vertices for each in vertex.groups]
    keys = [] if mesh.shape_keys is None else [key.name for key in mesh.shape_keys.key_blocks]
    digest.update(repr((groups, keys)).encode())
    return digest.hexdigest()
