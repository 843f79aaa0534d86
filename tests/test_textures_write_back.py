# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The write-back: Cycles with corrected base colours reflects what the paper's BRDF does."""

import bpy
import numpy as np
import pytest

from fipt_blender.blend import materials, renders
from fipt_blender.core.textures import write_back


def grid():
    a, sigma, m = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0.02, 1, 9), [0.0, 0.5, 1.0], indexing="ij")
    return np.repeat(a.reshape(-1, 1), 3, axis=1), sigma.ravel(), m.ravel()


def test_corrected_albedo_is_the_papers_wherever_it_can_be():
    base_color, sigma, m = grid()
    corrected = write_back.cycles_base_color(base_color, sigma, m)
    assert corrected.min() >= 0.0 and corrected.max() <= 1.0
    inside = (corrected > 1e-6) & (corrected < 1.0 - 1e-6)
    wanted = write_back.paper_albedo(base_color, sigma, m)
    reached = write_back.cycles_albedo(corrected, sigma, m)
    assert inside.mean() > 0.6
    assert np.allclose(wanted[inside], reached[inside], rtol=1e-6)
    # More base colour is never less, and outside the bounds the nearest is taken.
    uncorrected = write_back.cycles_albedo(base_color, sigma, m)
    assert (np.abs(reached - wanted) <= np.abs(uncorrected - wanted) + 1e-9).all()


@pytest.mark.parametrize(
    ("base_color", "roughness", "metallic"), [(0.6, 1.0, 0.0), (0.5, 0.15, 0.0), (0.8, 0.3, 1.0)]
)
def test_cycles_agrees_in_a_white_furnace(base_color, roughness, metallic):
    corrected = write_back.cycles_base_color(
        np.full((1, 3), base_color), np.array([roughness]), np.array([metallic])
    )
    wanted = write_back.paper_albedo(np.full((1, 3), base_color), np.array([roughness]), np.array([metallic]))
    before = furnace(base_color, roughness, metallic)
    after = furnace(float(corrected[0, 0]), roughness, metallic)
    assert abs(after / wanted[0, 0] - 1.0) < 0.01
    assert abs(before / wanted[0, 0] - 1.0) > abs(after / wanted[0, 0] - 1.0)


def furnace(base_color, roughness, metallic, size=32):
    """Mean of a sphere's disc in a white world: the cosine-weighted mean of its albedo over directions."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("White")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64)
    bpy.context.object.data.shade_smooth()
    material, nodes = materials.new_material("Furnace")
    principled = nodes["FIPT Principled"].inputs
    principled["Base Color"].default_value = (base_color, base_color, base_color, 1.0)
    principled["Roughness"].default_value = roughness
    principled["Metallic"].default_value = metallic
    bpy.context.object.data.materials.append(material)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0
    camera.location = (0.0, 0.0, 3.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = size
    image = renders.render_pixels(scene, spp=64)
    x = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    return float(image.mean(axis=2)[x[:, None] ** 2 + x[None] ** 2 < 0.97].mean())
