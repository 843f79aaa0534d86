# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The material of fixtures: the radiance of both sides in Cycles, and their emission in glTF files."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from fipt_blender.blend.lights.fixture_nodes import emission_material
from fipt_blender.blend.pictures.cycles import RenderOptions, render_pixels

BLACK, WARM, DIM = [0.0, 0.0, 0.0], [8.0, 4.0, 2.0], [0.5, 0.25, 0.5]
SIDES = pytest.mark.parametrize(("front", "back"), [(WARM, BLACK), (BLACK, WARM), (WARM, DIM), (DIM, WARM)])
REFLECTION = pytest.mark.parametrize("base_color", [BLACK, [0.3, 0.4, 0.5]])


def lamp(front: list[float], back: list[float], base_color: list[float]) -> bpy.types.Scene:
    """A scene with a lamp that faces up."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    bpy.context.object.data.materials.append(emission_material("lamp", front, back, base_color))
    return bpy.context.scene


@SIDES
@REFLECTION
def test_cycles_renders_the_radiance_of_both_sides(front, back, base_color):
    scene = lamp(front, back, base_color)
    camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
    scene.collection.objects.link(camera)
    camera.data.type, camera.data.ortho_scale = "ORTHO", 0.1
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 3
    for turn, radiance in ((0.0, front), (np.pi, back)):
        camera.matrix_world = Matrix.Rotation(turn, 4, "X") @ Matrix.Translation((0.0, 0.0, 1.0))
        pixels = render_pixels(scene, RenderOptions(4, denoise=False))
        assert np.allclose(pixels, radiance, atol=1e-4)


@SIDES
@REFLECTION
def test_gltf_files_receive_the_emission_of_the_brighter_side(tmp_path: Path, front, back, base_color):
    lamp(front, back, base_color)
    import addon_utils  # importing bpy makes it known

    addon_utils.enable("io_scene_gltf2", default_set=False)
    path = tmp_path / "lamp.gltf"
    bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLTF_SEPARATE")
    (material,) = json.loads(path.read_text(encoding="utf-8"))["materials"]
    strength = material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    assert np.allclose(np.array(material["emissiveFactor"]) * strength, WARM)
    assert np.allclose(material["pbrMetallicRoughness"]["baseColorFactor"][:3], base_color)
