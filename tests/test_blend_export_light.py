"""What leaves is what renders: light, names and what is hidden, in files read back; the open file stays."""

from __future__ import annotations

import math
import re

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender import api
from fipt_blender.blend.export.exporting import export_room
from fipt_blender.blend.lights.color import LUMENS_PER_WATT
from fipt_blender.blend.lights.convert import fixture_to_lights
from fipt_blender.blend.node_trees import node_tree
from samples.exported_files import gltf_json, opened, principled
from samples.refusals import error_of
from samples.whole_file import differences, file_state

pytestmark = pytest.mark.usefixtures("registered", "applied")

UNEVEN = (2.0, 0.5, 1.5)
FORMATS = pytest.mark.parametrize("suffix", [".glb", ".usdc"])


def add_light(scene, name, kind, settings, scale=(1.0, 1.0, 1.0), turn=(0.4, 0.3, 0.2)):
    light = bpy.data.lights.new(f"{name} data", kind)
    light.energy, light.color = 20.0, (1.0, 0.6, 0.3)
    for key, value in settings.items():
        if hasattr(light, key):  # not in Blender 4.2 to 4.4
            setattr(light, key, value)
    item = bpy.data.objects.new(name, light)
    item.matrix_world = Matrix.LocRotScale((3.0, 2.0, 4.0), Euler(turn), scale)
    scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    return item


@FORMATS
def test_lights_are_in_the_file(scene, tmp_path, suffix):
    area = {"shape": "ELLIPSE", "size": 0.6, "size_y": 1.5, "normalize": False, "use_temperature": True}
    softbox = add_light(scene, "Softbox", "AREA", area, UNEVEN)
    for kind in ("POINT", "SPOT", "SUN"):
        add_light(scene, kind, kind, {}).data.use_nodes = True  # always, from Blender 5.0 on
    power = softbox.data.energy * np.array(softbox.data.color)
    if hasattr(softbox.data, "normalize"):
        power *= softbox.data.area(matrix_world=softbox.matrix_world) * np.array(softbox.data.temperature_color)
    exported = export_room(scene, tmp_path / f"room{suffix}", lamp_lights=False)
    said = {each["code"]: each["text"] for each in exported.warnings}
    objects, _ = opened(exported.path)
    kinds = {item.name: item.data.type for item in objects if item.type == "LIGHT"}
    assert kinds.items() >= {"POINT": "POINT", "SPOT": "SPOT", "SUN": "SUN"}.items()
    assert kinds["Softbox"] == ("SPOT" if suffix == ".glb" else "AREA")
    assert ("export-light-size" in said) == (suffix == ".glb")
    assert np.allclose(objects["POINT"].data.color, (1.0, 0.6, 0.3), rtol=1e-2)
    if suffix == ".glb":
        assert said["export-light-size"].startswith("Softbox: ")
        spot = objects["Softbox"].data
        watts = 0.25 * (1.0 - math.cos(0.5 * spot.spot_size)) * spot.energy * np.array(spot.color)
        assert np.allclose(watts, power, rtol=1e-3)


@FORMATS
def test_names_are_the_artists_and_the_same_at_each_export(scene, tmp_path, suffix):
    for material in [each for each in bpy.data.materials if "fipt_part" in each]:
        bpy.data.materials.new(material["fipt_part_name"])  # as the artist's own material of that surface
    add_light(scene, "Bulb", "POINT", {})
    parts = {each["fipt_part_name"] for each in bpy.data.materials if "fipt_part" in each}
    exported = [export_room(scene, tmp_path / f"{index}{suffix}").path for index in range(2)]
    found = []
    for path in exported:
        objects, materials = opened(path)
        names = {each.name for each in materials}
        assert parts <= names, (parts, names)
        assert {"cube", "Bulb"} <= {item.name for item in objects}
        assert all(item.data.name == item.name for item in objects if item.type == "MESH")
        found.append(names)
    assert found[0] == found[1]


@pytest.mark.parametrize("how", ["object", "collection", "excluded", "viewport"])
def test_what_renders_do_not_show_is_not_exported(scene, tmp_path, how):
    hidden = bpy.data.collections.new("Hidden")
    scene.collection.children.link(hidden)
    cube, bulb = bpy.data.objects["cube"], add_light(scene, "Bulb", "POINT", {})
    for item in (cube, bulb):
        for each in list(item.users_collection):
            each.objects.unlink(item)
        hidden.objects.link(item)
        if how == "object":
            item.hide_render = True
        elif how == "viewport":
            item.hide_viewport = True
    hidden.hide_render = how == "collection"
    bpy.context.view_layer.layer_collection.children["Hidden"].exclude = how == "excluded"
    names = {node["name"] for node in gltf_json(export_room(scene, tmp_path / "room.glb").path)["nodes"]}
    assert {"panel", "Panel"} <= names
    assert {"cube", "Bulb"} & names == ({"cube", "Bulb"} if how == "viewport" else set())


@pytest.mark.parametrize(("suffix", "render", "factor"), [(".glb", True, 3), (".usdc", True, 3), (".glb", False, 1)])
def test_modifiers_are_applied_as_renders_show_them(scene, tmp_path, suffix, render, factor):
    cube = bpy.data.objects["cube"]
    array = cube.modifiers.new("Row", "ARRAY")
    array.count, array.show_render, array.show_viewport = 3, render, not render
    area = sum(face.area for face in cube.data.polygons)
    export_room(scene, tmp_path / f"room{suffix}")
    objects, _ = opened(tmp_path / f"room{suffix}")
    exported = sum(face.area for face in objects["cube"].data.polygons)
    assert exported == pytest.approx(area * factor, rel=1e-3)
    assert len(objects["cube"].data.uv_layers) == 1


@pytest.mark.parametrize("edited", [False, True])
def test_converted_lamps_follow_their_lights_once_these_are_edited(scene, tmp_path, edited):
    lamp = bpy.data.objects["Panel"]
    (light, *_), _ = fixture_to_lights(scene, lamp)
    name = light.name
    if edited:
        light.data.energy *= 4.0
    bpy.context.view_layer.update()
    exported = export_room(scene, tmp_path / "room.glb", lamp_lights=False)
    objects, _ = opened(exported.path)
    codes = {each["code"] for each in exported.warnings}
    assert (name in objects) == edited == ("export-lamps-dark" in codes)

    def strength(item):
        node = principled(item.data.materials[0])
        color, strength = (node.inputs[f"Emission {each}"].default_value for each in ("Color", "Strength"))
        return max(color[:3]) * strength / LUMENS_PER_WATT

    assert strength(objects["Panel"]) == pytest.approx(0.0 if edited else 8.0, rel=1e-3)
    if edited:
        spot = objects[name].data
        watts = 0.25 * (1.0 - math.cos(0.5 * spot.spot_size)) * spot.energy * max(spot.color)
        assert watts == pytest.approx(32.0 * math.pi, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "turn", "strength"),
    [
        ("TEXTURE", (0.0, 0.0, -2.5), 1.0),
        ("TEXTURE", (0.4, -0.3, 1.1), 3.0),
        ("POINT", (0.4, -0.3, 1.1), 1.0),
        ("VECTOR", (0.4, -0.3, 1.1), 3.0),
    ],
)
def test_the_environment_of_usd_shines_from_where_it_renders(scene, tmp_path, kind, turn, strength):
    nodes = node_tree(scene.world).nodes
    mapping = nodes["FIPT Mapping"]
    mapping.vector_type, mapping.inputs["Rotation"].default_value = kind, turn
    nodes["FIPT Background"].inputs["Strength"].default_value = strength
    exported = export_room(scene, tmp_path / "room.usda")
    text = exported.path.read_text()
    dome = text[text.index("def DomeLight") :]
    angles = [float(value) for value in re.search(r"rotateXYZ = \((.*?)\)", dome)[1].split(",")]
    rotation = np.array(Euler(np.radians(angles), "XYZ").to_matrix())
    # UsdLux: the middle of the picture is at +Z, its left quarter at +X. Cycles: at +X and at +Y.
    inverse = np.array(Euler(turn).to_matrix())
    inverse = inverse if kind == "TEXTURE" else inverse.T
    assert np.allclose(rotation @ (0.0, 0.0, 1.0), inverse @ (1.0, 0.0, 0.0), atol=1e-4)
    assert np.allclose(rotation @ (1.0, 0.0, 0.0), inverse @ (0.0, 1.0, 0.0), atol=1e-4)
    intensity = re.search(r"inputs:intensity = (\S+)", dome)
    picture = bpy.data.images.load(str(tmp_path / re.search(r"texture:file = @\./(.*?)@", dome)[1]))
    radiance = np.array(picture.pixels[:3]) * float(intensity[1] if intensity else 1.0)
    assert np.allclose(radiance, 2.0 * strength, rtol=1e-3)


def test_a_dark_environment_is_not_written(scene, tmp_path):
    nodes = node_tree(scene.world).nodes
    nodes["FIPT Background"].inputs["Strength"].default_value = 0.0
    exported = export_room(scene, tmp_path / "dark.usda")
    assert "DomeLight" not in exported.path.read_text() and not exported.warnings


def test_the_open_file_is_the_same_after_exports_and_renders(scene, tmp_path):
    add_light(scene, "Softbox", "AREA", {"shape": "ELLIPSE"}, UNEVEN)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 8
    bpy.context.view_layer.update()
    file_state()  # loads pictures
    before = file_state()
    for function, name in ((api.export, "room.gltf"), (api.export, "room.usdc"), (api.render, "view.exr")):
        function(tmp_path / name)
        bpy.context.view_layer.update()
        assert (tmp_path / name).exists() and differences(before, file_state()) == [], name
    assert error_of(api.export, tmp_path / "room.obj").code == "export-format"
    assert differences(before, file_state()) == []
