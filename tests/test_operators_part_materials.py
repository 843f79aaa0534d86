"""One material a part: faces, the artist's adjustments, picking, selecting, assets, applying again."""

from __future__ import annotations

from dataclasses import astuple

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend import marks
from fipt_blender.blend.png16 import decode_srgb
from fipt_blender.blend.results import adjust
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.jobs import running
from samples.applied_rooms import ConstantFields, fingerprint, picture
from samples.operator_calls import refused

ops = bpy.ops.fipt


pytestmark = pytest.mark.usefixtures("registered")
# The panel's quads, the last of which is a lamp; the first three faces of the cube.
NAMES = ["Sill", "Frame", "Box"]


def describe(scene, names=NAMES, prefix="mask"):
    """Parts of the run: a quad of the panel, the other two, three faces of the cube; not the rest of it."""
    run = RunFolder(scene.fipt.run_folder)
    with np.load(run.room_npz) as room:
        item, polygon = room["triangle_object"], room["triangle_polygon"]
    unit = np.where(item == 0, np.minimum(polygon, 1), np.where(polygon < 3, 2, -1)).astype(np.int32)
    np.savez(run.parts_npz, triangle_part=unit, single=np.ones(3, bool))
    parts = [
        {
            "id": index, "key": f"{prefix}:{index}", "name": name, "single": True, "class": None,
            "triangles": 1, "pixels": 100 * index + 1, "area": 1.0, "base_color": [0.6, 0.3, 0.1],
            "roughness": 0.7, "metallic": 0.25, "confidence": [1.0, 1.0, 1.0],
        }
        for index, name in enumerate(names)
    ]  # fmt: skip
    document = {"format": "fipt-parts", "version": 1, "source": "masks", "parts": parts}
    write_json(run.parts_json, document)
    return run


@pytest.fixture
def scene(scene):
    """The room of all such tests, with parts."""
    describe(scene)
    return scene


def row(scene, name):
    return scene.fipt.materials.parts[name]


def make_active(scene, name):
    scene.fipt.materials.active_part = scene.fipt.materials.parts.find(name)


def face_materials(name):
    item = bpy.data.objects[name]
    return [item.material_slots[polygon.material_index].material.name for polygon in item.data.polygons]


def test_faces_have_the_materials_of_their_parts(applied):
    assert face_materials("panel") == ["Sill FIPT", "Frame FIPT"]  # the third is the lamp
    cube = face_materials("cube")
    assert cube[:3] == ["Box FIPT"] * 3 and set(cube[3:]) == {"Cube FIPT"}
    names = [part.name for part in applied.fipt.materials.parts]
    assert names == ["Box", "Frame", "Sill", "Cube"]  # by their pixels
    assert row(applied, "Box").faces == 3 and not row(applied, "Cube").known
    images = {
        node.image.name
        for material in bpy.data.materials
        if marks.PART in material
        for node in material.node_tree.nodes
        if node.bl_idname == "ShaderNodeTexImage"
    }
    assert len(images) == 4  # shared


def test_an_adjustment_changes_its_part_alone(applied):
    part = row(applied, "Sill")
    part.hue, part.saturation, part.value, part.roughness_offset = 0.2, 0.5, 0.8, -0.3
    part.metallic_offset = 0.9
    wanted = adjust.Adjustment(-0.3, 0.9, 0.2, 0.5, 0.8)
    assert astuple(adjust.read(bpy.data.materials["Sill FIPT"])) == pytest.approx(astuple(wanted))
    estimate = np.array([[*ConstantFields.base_color, ConstantFields.roughness, ConstantFields.metallic]])
    sill, frame = Vector((4.5, 0.5, 0.0)), Vector((3.5, 0.5, 0.0))
    for place, values in ((sill, adjust.adjusted(wanted, estimate)), (frame, estimate)):
        (red, green, blue, roughness, metallic) = values[0]
        ops.show_map(shown="BASE_COLOR")
        linear = np.array([red, green, blue])
        srgb = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        assert np.allclose(picture(applied, place + Vector((0, 0, 2)), place, 3, 0.1), srgb, atol=0.01)
        ops.show_map(shown="ROUGHNESS")
        assert np.allclose(picture(applied, place + Vector((0, 0, 2)), place, 3, 0.1), roughness, atol=0.01)
        ops.show_map(shown="METALLIC")
        assert np.allclose(picture(applied, place + Vector((0, 0, 2)), place, 3, 0.1), min(metallic, 1.0), atol=0.01)


def test_adjusted_colours_of_arrays():
    maps = np.array([[0.6, 0.3, 0.1, 0.7, 0.2], [0.5, 0.5, 0.5, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0, 0.0]])
    assert adjust.adjusted(adjust.NO_ADJUSTMENT, maps) is maps
    nearly = adjust.Adjustment(saturation=1.0 + 1e-12)
    assert np.allclose(adjust.adjusted(nearly, maps), maps, atol=1e-9)
    turned = adjust.adjusted(adjust.Adjustment(hue=1.0 / 3.0), maps)
    assert np.allclose(turned[:, :3], maps[:, [2, 0, 1]])  # red becomes green
    grey = adjust.adjusted(adjust.Adjustment(saturation=0.0, value=2.0), maps)
    assert np.allclose(grey[:, :3], [[1.0] * 3, [1.0] * 3, [0.0] * 3])
    offset = adjust.adjusted(adjust.Adjustment(roughness=0.5, metallic=-0.5), maps)
    assert np.allclose(offset[:, 3:], [[1.0, 0.0], [0.5, 0.5], [1.0, 0.0]])


def test_applying_again_keeps_adjustments_and_names(applied):
    row(applied, "Sill").value = 0.5
    bpy.data.materials["Sill FIPT"].name = "My sill"
    before = fingerprint(applied)
    assert ops.apply_results() == {"FINISHED"}
    assert fingerprint(applied) == before
    assert row(applied, "Sill").value == pytest.approx(0.5) and face_materials("panel")[0] == "My sill"
    # Other parts with other keys: the name finds it; what is gone is told.
    row(applied, "Box").roughness_offset = 0.25
    describe(applied, ["Sill", "Frame", "Crate"], "piece")
    assert ops.apply_results() == {"FINISHED"}
    assert row(applied, "Sill").value == pytest.approx(0.5)
    (warning,) = running.last("materials").warnings
    assert warning["code"] == "adjustments-lost" and "'Box'" in warning["text"]


def test_resetting_one_and_all(applied):
    for name in NAMES:
        row(applied, name).metallic_offset = 0.5
    make_active(applied, "Frame")
    ops.reset_part()
    assert row(applied, "Frame").metallic_offset == 0.0 and row(applied, "Sill").metallic_offset == 0.5
    ops.reset_part(all_parts=True)
    assert all(part.metallic_offset == 0.0 for part in applied.fipt.materials.parts)


def test_picking_makes_the_part_under_the_ray_active(applied):
    assert ops.pick_part(origin=(3.5, 0.5, 2.0), direction=(0.0, 0.0, -1.0)) == {"FINISHED"}
    assert applied.fipt.materials.part().name == "Frame"
    assert ops.pick_part(origin=(4.5, 0.5, 2.0), direction=(0.0, 0.0, -1.0)) == {"FINISHED"}
    assert applied.fipt.materials.part().name == "Sill"
    for origin in ((2.5, 0.5, 2.0), (90.0, 0.0, 2.0)):  # on the lamp, and beside the room
        assert "no estimated surface" in refused(ops.pick_part, origin=origin)
    assert applied.fipt.materials.part().name == "Sill"


def test_assets_have_previews_and_survive_revert(applied):
    make_active(applied, "Sill")
    assert ops.mark_part_assets() == {"FINISHED"}
    material = bpy.data.materials["Sill"]
    assert material.asset_data is not None and "FIPT" in material.asset_data.tags
    assert tuple(material.preview.image_size) == (128, 128)
    assert bpy.data.materials["Sill FIPT"].asset_data is None and "Frame" not in bpy.data.materials
    part = row(applied, "Sill")
    part.color = (0.1, 0.2, 0.3)
    ops.mark_part_assets(all_parts=True)
    assert bpy.data.materials["Frame"].asset_data is not None and "Sill.001" not in bpy.data.materials
    ops.revert()
    assert not len(applied.fipt.materials.parts)
    # It is the same on any object: no textures, which lie on the room's UVs.
    nodes = {node.bl_idname: node for node in material.node_tree.nodes}
    assert "ShaderNodeTexImage" not in nodes
    assert tuple(nodes["ShaderNodeBsdfPrincipled"].inputs["Base Color"].default_value)[:3] == pytest.approx(
        (0.1, 0.2, 0.3), abs=1e-5
    )


@pytest.mark.parametrize("mode", ["uv", "color_attribute"])
def test_faces_that_were_left_alone_keep_their_material(scene, mode):
    run = RunFolder(scene.fipt.run_folder)
    with np.load(run.room_npz) as room:
        left = (room["triangle_object"] == 1) & (room["triangle_polygon"] >= 3)
    np.savez(run.left_alone_npz, left_alone=left)
    scene.fipt.materials.atlas_mode = mode
    assert ops.apply_results() == {"FINISHED"}
    own = face_materials("cube")
    assert own[:3] == ["Box FIPT"] * 3 and set(own[3:]) == {"red", "own", "blue"}
    row(scene, "Box").value = 0.5
    assert ops.apply_results() == {"FINISHED"} and face_materials("cube") == own
    assert row(scene, "Box").value == pytest.approx(0.5)


def test_a_part_gets_a_colour_and_keeps_its_pattern(applied):
    part = row(applied, "Sill")
    assert tuple(part.color) == pytest.approx((0.6, 0.3, 0.1), abs=1e-6)
    make_active(applied, "Sill")
    assert "is no color" in refused(ops.set_part_color, color="RAL 1")
    assert ops.set_part_color(color="RAL 7035") == {"FINISHED"}
    grey = decode_srgb(np.array([0xC5, 0xC7, 0xC4]) / 255.0)
    assert np.allclose(part.color, grey, atol=1e-5)
    assert ops.set_part_color(color="#fff") == {"FINISHED"} and np.allclose(part.color, 1.0)
    for code in ("#c5c7c4", "rgb(197, 199, 196)"):
        part.color = (0.1, 0.1, 0.1)
        assert ops.set_part_color(color=code) == {"FINISHED"} and np.allclose(part.color, grey, atol=1e-5)
    values = adjust.read(bpy.data.materials["Sill FIPT"])
    assert row(applied, "Frame").color[0] == pytest.approx(0.6)
    maps = np.array([[0.6, 0.3, 0.1, 0.7, 0.2], [0.7, 0.4, 0.2, 0.5, 0.0], [0.5, 0.2, 0.0, 0.9, 1.0]])
    colored = adjust.adjusted(values, maps)
    assert np.allclose(colored[:, :3].mean(axis=0), grey, atol=1e-5)
    assert np.allclose(np.ptp(colored[:, :3], axis=0), 0.2 * values.gain, atol=1e-5)
    assert np.array_equal(colored[:, 3:], maps[:, 3:])
    ops.show_map(shown="BASE_COLOR")
    sill = Vector((4.5, 0.5, 0.0))
    shown = picture(applied, sill + Vector((0, 0, 2)), sill, 3, 0.1)
    assert np.allclose(shown, np.array([0xC5, 0xC7, 0xC4]) / 255.0, atol=0.01)
    fingerprint_before = astuple(values)
    assert ops.apply_results() == {"FINISHED"}
    assert astuple(adjust.read(bpy.data.materials["Sill FIPT"])) == pytest.approx(fingerprint_before)
    part = row(applied, "Sill")
    part.color = part.base_color
    assert adjust.read(bpy.data.materials["Sill FIPT"]).gain == 1.0
