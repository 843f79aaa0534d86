# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of their own for objects or parts, and parts of one value, which need none."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend.export.exporting import ExportOptions, export_room
from fipt_blender.blend.marks import MAP
from fipt_blender.blend.results.materials import is_uniform
from fipt_blender.blend.room.atlas import file_names
from fipt_blender.core.run.parts import read_parts
from fipt_blender.core.run.run_files import read_room_files
from fipt_blender.core.textures import bake
from samples.applied_rooms import ConstantFields, picture

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


class PlacedFields(ConstantFields):
    """The cube's base colour shows the place, that of the panel is one."""

    def query(self, positions, triangles):
        color, roughness, metallic = super().query(positions, triangles)
        on_cube = positions[:, 1] > 2.0
        color[on_cube] = color_at(positions[on_cube])
        return color, roughness, metallic


def color_at(positions):
    return np.clip(0.5 + 0.1 * (np.asarray(positions) - (0.0, 5.0, 0.0)), 0.0, 1.0)


@pytest.fixture
def scene(scene, monkeypatch):
    real = bake.bake

    def with_parts(run, fields):
        room, names = read_room_files(run)
        parts = read_parts(run, room["triangle_object"], names.objects)
        return real(run, PlacedFields(), ranges=bake.PartRanges(parts))

    monkeypatch.setattr(bake, "bake", with_parts)
    return scene


def material(name):
    (slot,) = bpy.data.objects[name].material_slots
    return slot.material


def test_a_part_of_one_value_has_constants_which_can_be_adjusted_and_exported(scene, tmp_path):
    assert ops.apply_results() == {"FINISHED"}
    panel = material("panel")
    assert is_uniform(panel) and not is_uniform(material("cube"))
    shown = panel.node_tree.nodes[MAP.format("Base Color")].outputs["Color"].default_value[:3]
    assert np.allclose(shown, ConstantFields.base_color, atol=1e-5)
    assert np.allclose(panel.diffuse_color[:3], ConstantFields.base_color, atol=1e-5)  # for Solid shading
    assert [node.name for node in panel.node_tree.nodes if node.show_texture] == [MAP.format("Base Color")]
    row = next(row for row in scene.fipt.materials.parts if row.name == "Panel")
    row.roughness_offset = 0.2
    scene.fipt.materials.shown = "ROUGHNESS"
    scene.view_settings.view_transform = "Raw"
    seen = picture(scene, Vector((4.5, 0.5, 1.0)), Vector((4.5, 0.5, 0.0)))
    assert np.allclose(seen, ConstantFields.roughness + 0.2, atol=0.01)
    scene.fipt.materials.shown = "ESTIMATED"
    path = export_room(scene, tmp_path / "room.glb").path
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    nodes = (node for each in bpy.data.materials for node in each.node_tree.nodes)
    shaders = [node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"]
    (principled,) = (
        node
        for node in shaders
        if not node.inputs["Base Color"].is_linked
        and node.inputs["Emission Strength"].default_value == 0.0
        and max(node.inputs["Base Color"].default_value[:3]) > 0.0
    )
    assert principled.inputs["Roughness"].default_value == pytest.approx(0.9, abs=1e-4)
    assert np.allclose(principled.inputs["Base Color"].default_value[:3], ConstantFields.base_color, atol=1e-4)


@pytest.mark.parametrize("owner", ["object", "part"])
def test_each_owner_has_an_image_and_shows_its_place(scene, owner, tmp_path):
    scene.fipt.materials.atlas_images = owner
    assert ops.apply_results() == {"FINISHED"}
    assert scene.fipt.materials.image_count == 2
    images = {material(name).node_tree.nodes[MAP.format("Confidence")].image for name in ("panel", "cube")}
    assert len(images) == 2 and all(image.source == "FILE" for image in images)
    uv = np.array([entry.vector for entry in bpy.data.objects["cube"].data.uv_layers["FIPT"].uv])
    assert 0.0 <= uv.min() and uv.max() <= 1.0
    scene.fipt.materials.shown = "BASE_COLOR"
    scene.view_settings.view_transform = "Raw"
    for axis in range(3):
        side = Vector((0.0, 5.0, 0.0)) + Vector(np.eye(3)[axis])
        seen = picture(scene, side + Vector(np.eye(3)[axis]), side)
        assert np.allclose(seen, color_at(side), atol=0.02), axis
    scene.fipt.materials.shown = "ESTIMATED"
    kept = material("cube")
    kept.name = "My cube"
    assert ops.apply_results() == {"FINISHED"} and material("cube") == kept
    assert export_room(scene, tmp_path / "room.glb", ExportOptions(lamp_lights=False)).objects == 3
    scene.fipt.materials.atlas_images = "room"
    assert ops.apply_results() == {"FINISHED"}
    assert scene.fipt.materials.image_count == 1 and material("cube") == kept


def test_names_of_files_differ_on_every_system():
    assert file_names(["Wall", "wall", "Wall/2", "Wall 2", "?"]) == ["Wall", "wall_2", "Wall_2_2", "Wall_2_3", "Part"]
