"""Atlases of several images: shared, one an object or part, and parts that need none."""

from __future__ import annotations

import itertools

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend.export.exporting import export_room
from fipt_blender.blend.marks import MAP
from fipt_blender.blend.results import adjust
from fipt_blender.blend.results.materials import is_uniform
from fipt_blender.blend.room.atlas import file_names
from fipt_blender.blend.room.mesh_arrays import corner_uvs
from fipt_blender.core.run.parts import read_parts
from fipt_blender.core.run.run_files import read_room
from fipt_blender.core.textures import bake
from samples.applied_rooms import ConstantFields, picture
from samples.exported_files import encoded, opened, principled, texel, texture_behind

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


def color_at(positions):
    """The base colour (..., 3) of a place in the room, which differs on all sides of the cube."""
    return np.clip(0.5 + 0.1 * (np.asarray(positions) - (0.0, 5.0, 0.0)), 0.0, 1.0)


class PlacedFields(ConstantFields):
    """The cube's base colour shows the place, that of the panel is one."""

    def query(self, positions, triangles):
        color, roughness, metallic = super().query(positions, triangles)
        on_cube = positions[:, 1] > 2.0
        color[on_cube] = color_at(positions[on_cube])
        return color, roughness, metallic


@pytest.fixture
def scene(scene, monkeypatch):
    real = bake.bake

    def with_parts(run, fields):
        room = read_room(run)
        parts = read_parts(run, room.triangle_object, room.objects)
        return real(run, PlacedFields(), parts=parts)

    monkeypatch.setattr(bake, "bake", with_parts)
    return scene


@pytest.fixture
def large(scene):
    """The cube is larger than one image of 512 texels."""
    cube = bpy.data.objects["cube"].data
    cube.uv_layers.remove(cube.uv_layers[0])  # one island would be one image
    scene.fipt.materials.texel_density = 100.0
    scene.fipt.materials.texture_size = "512"
    assert ops.apply_results() == {"FINISHED"}
    return scene


def assert_each_side_shows_its_place(scene):
    scene.fipt.materials.shown = "BASE_COLOR"
    scene.view_settings.view_transform = "Raw"
    for axis, sign in itertools.product(range(3), (-1.0, 1.0)):
        outwards = Vector(np.eye(3)[axis] * sign)
        side = Vector((0.0, 5.0, 0.0)) + outwards
        assert np.allclose(picture(scene, side + outwards, side), color_at(side), atol=0.02), (axis, sign)
    scene.fipt.materials.shown = "ESTIMATED"


def material(name):
    (slot,) = bpy.data.objects[name].material_slots
    return slot.material


def test_a_part_on_several_images_is_one_also_after_saving(large, tmp_path):
    materials = {slot.material for slot in bpy.data.objects["cube"].material_slots}
    images = {material.node_tree.nodes[MAP.format("Base Color")].image for material in materials}
    assert 1 < len(materials) == len(images) <= large.fipt.materials.image_count
    assert all(max(image.size) <= 512 for image in images)
    large.fipt.materials.parts["Cube"].roughness_offset = 0.2
    assert ops.apply_results() == {"FINISHED"}
    assert {slot.material for slot in bpy.data.objects["cube"].material_slots} == materials
    assert all(adjust.read(material).roughness == pytest.approx(0.2) for material in materials)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    for path in (tmp_path / "run" / "textures").glob("*.exr"):
        path.unlink()  # they are packed
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert_each_side_shows_its_place(bpy.context.scene)


def test_other_programs_get_all_images_of_the_chosen_size(large, tmp_path):
    sizes = {"a.glb": 256, "b.usdc": 4096}
    for name, size in sizes.items():
        export_room(large, tmp_path / name, size)
    for name, size in sizes.items():
        item = opened(tmp_path / name)[0]["cube"]
        mesh = item.data
        uv = corner_uvs(mesh, mesh.uv_layers[0])
        for polygon in mesh.polygons:
            image = texture_behind(principled(mesh.materials[polygon.material_index]).inputs["Base Color"])
            place = uv[list(polygon.loop_indices)].mean(axis=0)
            assert image.source == "FILE" and 128 < max(image.size) <= size
            seen = texel(image, place)
            assert np.allclose(seen, encoded(color_at(item.matrix_world @ polygon.center)), atol=0.03), name


def test_a_part_of_one_value_has_constants_which_can_be_adjusted_and_exported(scene, tmp_path):
    assert ops.apply_results() == {"FINISHED"}
    panel = material("panel")
    assert is_uniform(panel) and not is_uniform(material("cube"))
    shown = panel.node_tree.nodes[MAP.format("Base Color")].outputs["Color"].default_value[:3]
    assert np.allclose(shown, ConstantFields.base_color, atol=1e-5)
    assert np.allclose(panel.diffuse_color[:3], ConstantFields.base_color, atol=1e-5)  # for Solid shading
    assert [node.name for node in panel.node_tree.nodes if node.show_texture] == [MAP.format("Base Color")]
    scene.fipt.materials.parts["Panel"].roughness_offset = 0.2
    scene.fipt.materials.shown = "ROUGHNESS"
    scene.view_settings.view_transform = "Raw"
    seen = picture(scene, Vector((4.5, 0.5, 1.0)), Vector((4.5, 0.5, 0.0)))
    assert np.allclose(seen, ConstantFields.roughness + 0.2, atol=0.01)
    scene.fipt.materials.shown = "ESTIMATED"
    objects, _ = opened(export_room(scene, tmp_path / "room.glb").path)
    shader = principled(objects["panel"].data.materials[0])
    assert not shader.inputs["Base Color"].is_linked
    assert shader.inputs["Roughness"].default_value == pytest.approx(0.9, abs=1e-4)
    assert np.allclose(shader.inputs["Base Color"].default_value[:3], ConstantFields.base_color, atol=1e-4)


@pytest.mark.parametrize("owner", ["object", "part"])
def test_each_owner_has_an_image_and_shows_its_place(scene, owner, tmp_path):
    scene.fipt.materials.atlas_images = owner
    assert ops.apply_results() == {"FINISHED"}
    assert scene.fipt.materials.image_count == 2
    images = {material(name).node_tree.nodes[MAP.format("Confidence")].image for name in ("panel", "cube")}
    assert len(images) == 2
    uv = np.array([entry.vector for entry in bpy.data.objects["cube"].data.uv_layers["FIPT"].uv])
    assert 0.0 <= uv.min() and uv.max() <= 1.0
    assert_each_side_shows_its_place(scene)
    kept = material("cube")
    kept.name = "My cube"
    assert ops.apply_results() == {"FINISHED"} and material("cube") == kept
    assert export_room(scene, tmp_path / "room.glb", lamp_lights=False).objects == 3
    scene.fipt.materials.atlas_images = "room"
    assert ops.apply_results() == {"FINISHED"}
    assert scene.fipt.materials.image_count == 1 and material("cube") == kept


def test_names_of_files_differ_on_every_system():
    assert file_names(["Wall", "wall", "Wall/2", "Wall 2", "?"]) == ["Wall", "wall_2", "Wall_2_2", "Wall_2_3", "Part"]
