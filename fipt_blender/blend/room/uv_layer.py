"""The UV layer "FIPT" that carries the atlas on the result meshes. The artist's own layers stay untouched."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.run.errors import FiptError
from .mesh_arrays import corner_uvs

UV_LAYER = "FIPT"


def layer_values(mesh: bpy.types.Mesh) -> np.ndarray:
    """(L,2) f32 values of the FIPT layer of a result mesh; 0 without one."""
    if UV_LAYER not in mesh.uv_layers:
        return np.zeros((len(mesh.loops), 2), np.float32)
    return corner_uvs(mesh, mesh.uv_layers[UV_LAYER]).astype(np.float32)


def new_layer(mesh: bpy.types.Mesh, name: str) -> None:
    """Add a UV layer."""
    if mesh.uv_layers.new(name=name, do_init=False) is None:
        raise FiptError("uv-layers-full", name=mesh.name)


def write_layer(mesh: bpy.types.Mesh, uv: np.ndarray) -> None:
    """Write the FIPT layer of a result mesh, and make it active, so that solid shading draws with it.

    The layer that renders use by default stays the artist's. The values are written as those of an attribute:
    up to Blender 4.5 writing to a UV layer also changes the meshes that were copied from this mesh, or this
    one from them, since copies share their arrays.

    Args:
        mesh: a result mesh.
        uv: (L,2) of its face corners.
    """
    active_render = [layer.active_render for layer in mesh.uv_layers]
    if UV_LAYER not in mesh.uv_layers:
        new_layer(mesh, UV_LAYER)
    mesh.attributes[UV_LAYER].data.foreach_set("vector", uv.astype(np.float32).ravel())
    mesh.uv_layers.active = mesh.uv_layers[UV_LAYER]
    if True in active_render:
        mesh.uv_layers[active_render.index(True)].active_render = True
