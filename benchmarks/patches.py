"""Small patches of many materials, each with its own viewing angle, in one small Cycles render.

Each patch fills one pixel of an orthographic camera that looks down. Patches neither light nor shadow each
other. Therefore a pixel is the radiance that one material reflects under a white world or under the sun.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Matrix

from benchmarks.cycles_pixels import render_pixels
from fipt_blender.blend.marks import MAP
from fipt_blender.blend.pictures.cycles import RenderOptions
from fipt_blender.blend.results import materials


@dataclass(frozen=True)
class Patches:
    """Materials and viewing directions of N patches.

    Attributes:
        base_color: (N,3). roughness, metallic: (N,).
        cosine: (N,) n.v.
        azimuth: (N,) of the normal about the direction of view, radians; 0 is the side of the sun.
    """

    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    cosine: np.ndarray
    azimuth: np.ndarray

    def normals(self) -> np.ndarray:
        """(N,3) normals; the viewing direction is +Z."""
        sine = np.sqrt(1.0 - self.cosine**2)
        return np.column_stack([sine * np.cos(self.azimuth), sine * np.sin(self.azimuth), self.cosine])


def grid(base_colors: Any, roughnesses: Any, metallics: Any, cosines: Any, azimuths: Any = (0.0,)) -> Patches:
    """All combinations, the last value varying fastest; base colours are greys (numbers) or rgb."""
    colors = np.array([np.broadcast_to(color, 3) for color in base_colors], np.float64)
    index, *rest = np.meshgrid(
        np.arange(len(colors)), roughnesses, metallics, cosines, azimuths, indexing="ij"
    )
    return Patches(colors[index.ravel()], *(each.ravel().astype(np.float64) for each in rest))


def render(
    patches: Patches,
    finish: Callable[[bpy.types.Material], None],
    sun: float | None = None,
    spp: int = 256,
) -> np.ndarray:
    """Radiance (N,3) of the patches; replaces the open file.

    Args:
        finish: what is done to the material, which reads the patches' values as colour attributes.
        sun: angle between the sun's direction and that of view, radians; the sun lies towards azimuth 0 and
            brings irradiance 1 to surfaces that face it. None: a white world of radiance 1.
        spp: samples a pixel; sunlight needs few, since it has one direction.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _light(scene, sun)
    count = len(patches.cosine)
    columns = int(np.ceil(np.sqrt(count)))
    rows = -(-count // columns)
    item = bpy.data.objects.new("Patches", _mesh(patches, columns))
    material = materials.part_material("patches", "patches", "Patches")
    finish(material)
    item.data.materials.append(material)
    item.visible_diffuse = item.visible_glossy = item.visible_shadow = False
    scene.collection.objects.link(item)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", max(columns, rows)
    camera.data.clip_end = 1000.0
    camera.matrix_world = Matrix.Translation((columns / 2, rows / 2, 500.0))
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = columns, rows
    image = render_pixels(scene, RenderOptions(spp, denoise=False))
    return image[::-1].reshape(-1, 3)[:count]  # the first row of patches is at the bottom


def _light(scene: bpy.types.Scene, sun: float | None) -> None:
    scene.world = bpy.data.worlds.new("World")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    background = scene.world.node_tree.nodes["Background"].inputs
    background["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background["Strength"].default_value = 1.0 if sun is None else 0.0
    if sun is not None:
        light = bpy.data.lights.new("Sun", "SUN")
        light.energy, light.angle = 1.0, 0.0
        item = bpy.data.objects.new("Sun", light)
        item.rotation_euler = Euler((0.0, sun, 0.0))  # at 0 it shines downwards; rotated, it comes from +X
        scene.collection.objects.link(item)


def _mesh(patches: Patches, columns: int) -> bpy.types.Mesh:
    """Quads that exactly fill their pixel at any tilt."""
    normals, count = patches.normals(), len(patches.cosine)
    corner = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    centre = np.column_stack([np.arange(count) % columns, np.arange(count) // columns]) + 0.5
    depth = -np.einsum("nk,ck->nc", normals[:, :2], corner) / normals[:, 2:]
    points = np.concatenate([centre[:, None] + corner, depth[..., None]], axis=2).reshape(-1, 3)
    mesh = bpy.data.meshes.new("Patches")
    mesh.from_pydata(points.tolist(), [], np.arange(4 * count).reshape(-1, 4).tolist())
    for label, values in (
        ("Base Color", patches.base_color),
        ("Roughness", patches.roughness[:, None]),
        ("Metallic", patches.metallic[:, None]),
    ):
        name = MAP.format(label)
        mesh.attributes.new(name, "FLOAT_COLOR", "CORNER")
        rgba = np.ones((4 * count, 4), np.float32)
        rgba[:, :3] = np.repeat(np.broadcast_to(values, (count, 3)), 4, axis=0)
        mesh.attributes[name].data.foreach_set("color", rgba.ravel())
    return mesh
