"""The state of the whole open file, to tell whether an action has changed anything in it."""

from __future__ import annotations

import hashlib

import bpy
import numpy as np

# Derived from other values, or changed by looking at them.
_DERIVED = {
    "rna_type", "bl_rna", "session_uid", "preview", "is_updated", "is_updated_data", "users", "is_evaluated",
    "original", "bindcode", "has_data", "is_dirty", "loop_triangles", "loop_triangle_polygons",
    "corner_normals",
    "vertex_normals", "polygon_normals", "depsgraph", "pixels", "active_operator", "bound_box", "statistics",
    "is_tagged", "asset_data", "matrix_world", "linear_colorspace_settings",
    "internal_links", "cycles", "render_slots", "is_runtime_data",
    "total_vert_sel", "total_edge_sel", "total_face_sel", "light_linking",
}  # fmt: skip
# (name of the array of an attribute's values, numbers for a value, type) by the attribute's type.
_VALUES = {
    "FLOAT": ("value", 1, np.float32), "INT": ("value", 1, np.int32), "BOOLEAN": ("value", 1, bool),
    "FLOAT_VECTOR": ("vector", 3, np.float32), "FLOAT2": ("vector", 2, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32), "BYTE_COLOR": ("color", 4, np.float32),
    "INT8": ("value", 1, np.int32), "INT32_2D": ("value", 2, np.int32), "INT16_2D": ("value", 2, np.int32),
}  # fmt: skip


def file_state() -> dict[str, object]:
    """Every datablock of the file by kind and name: properties, node trees, pixels and mesh attributes."""
    found: dict[str, object] = {}
    for collection in bpy.data.bl_rna.properties:
        if collection.type != "COLLECTION" or collection.identifier in ("screens", "window_managers"):
            continue
        for block in getattr(bpy.data, collection.identifier):
            if getattr(block, "type", "") == "RENDER_RESULT":  # Blender's own, made by the first render
                continue
            found[f"{collection.identifier}/{block.name}"] = _struct(block, 0)
    return found


def _struct(owner: bpy.types.bpy_struct, depth: int) -> object:
    if depth > 6:
        return None
    state: dict[str, object] = {}
    if isinstance(owner, bpy.types.ID):
        state["custom"] = sorted(key for key in owner.keys() if not key.startswith("cycles"))
    if isinstance(owner, bpy.types.Mesh):
        state["attributes"] = {name: _attribute(owner, name) for name in owner.attributes.keys()}
        state["layers"] = [(each.name, each.active_render) for each in owner.uv_layers]
        state["materials"] = [each and each.name for each in owner.materials]
        return state
    if isinstance(owner, bpy.types.Image):
        tuple(owner.size)  # loads it: a render in the background frees the images that it has used
    if isinstance(owner, bpy.types.Image) and owner.has_data and owner.source != "TILED":
        pixels = np.empty(len(owner.pixels), np.float32)
        owner.pixels.foreach_get(pixels)
        state["pixels"] = _digest(pixels)
    for each in owner.bl_rna.properties:
        name = each.identifier
        if name in _DERIVED:
            continue
        value = getattr(owner, name, None)
        if each.type == "COLLECTION":
            state[name] = [_value(item, depth) for item in value]
        elif each.type == "POINTER":
            state[name] = _value(value, depth)
        elif getattr(each, "is_array", False):
            state[name] = repr([tuple(row) if hasattr(row, "__len__") else row for row in value])
        else:
            state[name] = repr(value)
    return state


def _value(value: object, depth: int) -> object:
    if value is None:
        return None
    if isinstance(value, bpy.types.ID) and not value.is_embedded_data:
        return value.name
    if (depth > 1 and isinstance(value, bpy.types.Node)) or (depth > 2 and isinstance(value, bpy.types.NodeSocket)):
        return value.name  # it is listed with its tree or node
    return _struct(value, depth + 1)


def _attribute(mesh: bpy.types.Mesh, name: str) -> object:
    attribute = mesh.attributes[name]
    kind = (attribute.data_type, attribute.domain)
    if attribute.data_type not in _VALUES:
        return kind
    field, width, dtype = _VALUES[attribute.data_type]
    values = np.empty(len(attribute.data) * width, dtype)
    attribute.data.foreach_get(field, values)
    return (*kind, _digest(values))


def _digest(values: np.ndarray) -> str:
    return hashlib.sha256(values.tobytes()).hexdigest()


def differences(before: object, after: object, path: str = "") -> list[str]:
    """Where two states differ."""
    if isinstance(before, dict) and isinstance(after, dict) and before.keys() == after.keys():
        return [text for key in before for text in differences(before[key], after[key], f"{path}/{key}")]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        pairs = enumerate(zip(before, after, strict=True))
        return [text for index, pair in pairs for text in differences(*pair, f"{path}/{index}")]
    return [] if before == after else [f"{path}: {before} -> {after}"]
