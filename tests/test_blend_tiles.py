# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An atlas of several images: a part has one material, whose textures have tiles."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend.export.exporting import ExportOptions, export_room
from fipt_blender.blend.image_datablocks import tile_values
from fipt_blender.blend.room.tiles import polygon_images, tile_number
from samples.applied_rooms import ConstantFields, make_scene, picture, use_fake_engine

pytestmark = pytest.mark.usefixtures("registered")


def color_at(positions):
    """The base colour (..., 3) of a place in the room, which differs on all sides of the cube."""
    return 0.5 + 0.1 * (np.asarray(positions) - (0.0, 5.0, 0.0))


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The cube is larger than one image of 512 texels; its estimate shows the place."""
    bakes = use_fake_engine(monkeypatch)

    def query(self, positions, triangles):
        count = len(positions)
        return np.clip(color_at(positions), 0, 1), np.full(count, self.roughness), np.full(count, 0.0)

    monkeypatch.setattr(ConstantFields, "query", query)
    scene = make_scene(tmp_path / "run")
    cube = bpy.data.objects["cube"].data
    cube.uv_layers.remove(cube.uv_layers[0])  # one island would be one image
    scene.fipt.materials.texel_density = 250.0
    scene.fipt.materials.texture_size = "512"
    assert bpy.ops.fipt.apply_results() == {"FINISHED"} and bakes
    return scene


def test_a_part_on_several_images_has_one_material(scene):
    mesh = bpy.data.objects["cube"].data
    images = np.unique(polygon_images(mesh))
    assert len(images) > 1 and scene.fipt.materials.image_count >= len(images)
    assert [each.name for each in mesh.materials] == ["Cube FIPT"]
    texture = mesh.materials[0].node_tree.nodes["FIPT Base Color"].image
    assert [tile.number for tile in texture.tiles] == [
        tile_number(index) for index in range(scene.fipt.materials.image_count)
    ]
    assert tile_values(texture, tile_number(int(images[-1]))).shape[0] <= 512


def test_every_side_shows_its_place_also_after_saving(scene, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    for path in (tmp_path / "run" / "textures").glob("*.exr"):
        path.unlink()  # they are packed
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    scene.fipt.materials.shown = "BASE_COLOR"
    scene.view_settings.view_transform = "Raw"
    for axis in range(3):
        for sign in (-1.0, 1.0):
            side = Vector((0.0, 5.0, 0.0)) + Vector(np.eye(3)[axis] * sign)
            seen = picture(scene, side + Vector(np.eye(3)[axis] * sign), side)
            assert np.allclose(seen, color_at(side), atol=0.02), (axis, sign)


@pytest.mark.parametrize("suffix, size", [(".glb", 4096), (".glb", 256), (".usdc", 4096)])
def test_other_programs_get_one_material_of_the_chosen_size(scene, tmp_path, suffix, size):
    path = tmp_path / f"room{suffix}"
    export_room(scene, path, ExportOptions(size))
    assert len(bpy.data.objects["cube"].data.materials) == 1  # the original stays
    bpy.ops.wm.read_homefile(use_empty=True)
    read = bpy.ops.import_scene.gltf if suffix == ".glb" else bpy.ops.wm.usd_import
    read(filepath=str(path))
    item = bpy.data.objects["cube"]
    mesh = item.data
    uv = np.empty(len(mesh.loops) * 2, np.float32)
    mesh.uv_layers[0].uv.foreach_get("vector", uv)
    uv = uv.reshape(-1, 2)
    assert uv.min() >= 0.0 and uv.max() <= 1.0 and [each.name for each in mesh.materials] == ["Cube"]
    pictures = {}
    for polygon in mesh.polygons:
        shader = next(
            node
            for node in mesh.materials[polygon.material_index].node_tree.nodes
            if node.bl_idname == "ShaderNodeBsdfPrincipled"
        )
        node = shader.inputs["Base Color"].links[0].from_node
        while node.bl_idname != "ShaderNodeTexImage":
            node = node.inputs[0].links[0].from_node
        width, height = node.image.size
        assert 128 < max(width, height) <= size
        values = pictures.get(node.image.name)
        if values is None:
            values = np.empty(4 * width * height, np.float32)
            node.image.pixels.foreach_get(values)
            values = pictures[node.image.name] = values.reshape(height, width, 4)
        x, y = uv[list(polygon.loop_indices)].mean(axis=0)
        found = values[int(y * height), int(x * width), :3]
        linear = np.where(found <= 0.04045, found / 12.92, ((found + 0.055) / 1.055) ** 2.4)
        assert np.allclose(linear, color_at(item.matrix_world @ polygon.center), atol=0.05)
