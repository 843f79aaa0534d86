"""Renders of a small spot of the scene, seen straight on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Matrix, Vector

from benchmarks.cycles_pixels import render_pixels
from fipt_blender.blend.node_trees import node_tree
from fipt_blender.blend.pictures.cycles import RenderOptions


@contextmanager
def spot_camera(scene: bpy.types.Scene, position, target, size: int, ortho: float) -> Iterator[None]:
    """The scene is seen by an orthographic camera: `size` pixels over `ortho` metres along each edge."""
    camera = bpy.data.objects.new("spot", bpy.data.cameras.new("spot"))
    scene.collection.objects.link(camera)
    camera.data.type, camera.data.ortho_scale, camera.data.clip_start = "ORTHO", ortho, 1e-4
    turn = (Vector(target) - Vector(position)).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    camera.matrix_world = Matrix.Translation(position) @ turn
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = size
    yield
    bpy.data.objects.remove(camera)


def spot(position, target, spp: int = 16, size: int = 9, ortho: float = 0.1, seed: int = 0) -> np.ndarray:
    """Radiance (size, size, 3) of a spot of the open scene by Cycles."""
    scene = bpy.context.scene
    with spot_camera(scene, position, target, size, ortho):
        return render_pixels(scene, RenderOptions(spp, seed=seed, denoise=False))


def white_world() -> None:
    """Give the open scene a white world."""
    world = bpy.context.scene.world = bpy.data.worlds.new("white")
    node_tree(world).nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
