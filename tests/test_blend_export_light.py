# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What leaves is what renders: light, names and what is hidden, in files read back; the open file stays."""

from __future__ import annotations

import math
import re

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender import api
from fipt_blender.blend.export.exporting import ExportOptions, export_room
from fipt_blender.blend.export.lights import emitted_power
from fipt_blender.blend.lights.color import LUMENS_PER_WATT
from fipt_blender.blend.lights.convert import fixture_to_lights
from fipt_blender.blend.lights.irradiance import irradiance
from fipt_blender.blend.node_trees import node_tree
from fipt_blender.blend.room.mesh_arrays import corner_uvs
from fipt_blender.blend.room.uv_layer import write_layer
from samples.combinations import pairs
from samples.exported_files import gltf_json, opened, principled
from samples.refusals import error_of
from samples.whole_file import differences, file_state

pytestmark = pytest.mark.usefixtures("registered", "applied")

WARM = {"use_temperature": True, "temperature": 3000.0, "exposure": 1.5}
COMMON = ({"normalize": True}, {"normalize": False}), ({}, WARM)
SHAPES = [{"shape": shape, "size": 0.6, "size_y": 1.5} for shape in ("SQUARE", "RECTANGLE", "DISK", "ELLIPSE")]
ONE, EVEN, UNEVEN = (1.0, 1.0, 1.0), (2.0, 2.0, 2.0), (2.0, 0.5, 1.5)
FAMILY = {
    "AREA": pairs(SHAPES, *COMMON, (ONE, UNEVEN)),
    "POINT": pairs([{"shadow_soft_size": size} for size in (0.0, 0.2)], *COMMON, (UNEVEN,)),
    "SPOT": pairs([{"shadow_soft_size": 0.1, "spot_size": 2.0, "spot_blend": 0.5}], *COMMON, (ONE, EVEN)),
    "SUN": pairs([{"angle": 0.2}], *COMMON, (EVEN,)),
}
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


def points_below(rng):
    """Ten points one to three metres in front of the lights of `add_light`, which see them wholly."""
    places = rng.uniform((-0.8, -0.8, -3.0), (0.8, 0.8, -1.2), (10, 3))
    turn = np.array(Euler((0.4, 0.3, 0.2)).to_matrix())
    normals = rng.normal(size=(10, 3)) * 0.3 + turn @ (0.0, 0.0, 1.0)
    return places @ turn.T + (3.0, 2.0, 4.0), normals


def light_alone(scene, names, points, normals, samples=128):
    """Irradiance of each of the objects, all others being hidden."""
    found = {}
    for name in names:
        for item in scene.objects:
            item.hide_render = item.name != name
        found[name] = irradiance(scene, points, normals, samples)
    return found


@pytest.mark.parametrize("kind", FAMILY)
def test_the_irradiance_of_every_light_is_in_the_file(scene, tmp_path, rng, kind):
    bpy.data.objects.remove(bpy.data.objects["sun"])
    scene.world = None
    lights = [
        add_light(scene, f"{kind}_{index}", kind, {**own, **normalize, **warm}, scale)
        for index, (own, normalize, warm, scale) in enumerate(FAMILY[kind])
    ]
    names = [item.name for item in lights]
    powers = {item.name: emitted_power(item) for item in lights}
    sheared = ""
    paths = [tmp_path / "room.glb", tmp_path / "room.usda"]
    for path in paths:
        said = export_room(scene, path, ExportOptions(lamp_lights=False)).warnings
        sheared += "".join(each["text"] for each in said if each["code"] == "export-light-shape")
    points, normals = points_below(rng)
    before = light_alone(scene, names, points, normals)
    for path in paths:
        opened(path)
        after = light_alone(bpy.context.scene, names, points, normals)
        unit = 4.0 if (kind, path.suffix) == ("SUN", ".usda") else 1.0  # by Blender's importer
        for name, wanted in before.items():
            if (kind, path.suffix) == ("AREA", ".glb"):
                spot = bpy.data.objects[name].data  # of the same power, from one point
                power = 0.25 * (1.0 - math.cos(0.5 * spot.spot_size)) * spot.energy * np.array(spot.color)
                assert np.allclose(power, powers[name], rtol=1e-3), name
                continue
            if name in sheared:
                continue
            assert wanted.max() > 0.0, name
            error = np.abs(after[name] / unit - wanted).max() / wanted.max()
            assert error < 0.05, f"{name}{path.suffix}: {error:.3f}"
        if kind != "AREA":
            # A second reader, by the formats' specifications: radiant intensity or power from the numbers alone.
            in_file = punctual(gltf_json(path)) if path.suffix == ".glb" else usd_lights(path.read_text())
            factor = 1.0 if kind != "SUN" else math.pi * (4.0 if path.suffix == ".glb" else 1.0) / unit
            for name in names:
                light = bpy.data.objects[name].data
                assert np.allclose(in_file[name], factor * np.array(light.color) * light.energy, rtol=1e-3), name


def punctual(document):
    """Watts (rgb) of a point light of the same intensity by node, of KHR_lights_punctual."""
    lights = document.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    found = {}
    for node in document["nodes"]:
        index = node.get("extensions", {}).get("KHR_lights_punctual", {}).get("light")
        if index is not None:
            color = np.array(lights[index].get("color", (1.0, 1.0, 1.0)))
            found[node["name"]] = color * lights[index]["intensity"] / 683.0 * 4.0 * math.pi
    return found


def usd_lights(text):
    """Watts (rgb) of the lights of a .usda file by UsdLux: pi times a normalized intensity."""
    found = {}
    for name, body in re.findall(r'def (?:\w+)Light "(\w+)"(.*?)\n    (?:    )?\}', text, re.DOTALL):
        color = re.search(r"inputs:color = \((.*?)\)", body)
        intensity = re.search(r"inputs:intensity = (\S+)", body)
        if color is not None:
            rgb = np.array([float(value) for value in color[1].split(",")])
            found[name] = rgb * float(intensity[1] if intensity else 1.0) * math.pi
    return found


@FORMATS
def test_what_files_can_not_hold_of_lights_is_said(scene, tmp_path, suffix):
    odd = {
        "export-light-spread": ("AREA", {"spread": 1.0}),
        "export-light-edges": ("SPOT", {"spot_blend": 0.3}),
        "export-light-rays": ("POINT", {"use_shadow": False}),
    }
    for code, light in odd.items():
        add_light(scene, code, *light)
    add_light(scene, "Even", "AREA", {})
    said = {each["code"]: each["text"] for each in export_room(scene, tmp_path / f"room{suffix}").warnings}
    assert all(said[code].startswith(f"{code}: ") for code in odd)


def test_constant_nodes_of_lights_are_in_their_power_and_others_are_said(scene, tmp_path):
    for name, factor in (("Constant", 3.0), ("Textured", None)):
        light = add_light(scene, name, "POINT", {}).data
        light.use_nodes = True
        tree = light.node_tree
        emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
        if factor is None:
            falloff = tree.nodes.new("ShaderNodeLightFalloff")
            tree.links.new(falloff.outputs["Linear"], emission.inputs["Strength"])
        else:
            emission.inputs["Strength"].default_value = factor
            emission.inputs["Color"].default_value = (0.5, 1.0, 1.0, 1.0)
    exported = export_room(scene, tmp_path / "room.glb")
    watts = punctual(gltf_json(exported.path))
    assert np.allclose(watts["Constant"], 20.0 * 3.0 * np.array([0.5, 0.6, 0.3]), rtol=1e-3)
    said = {each["code"]: each["text"] for each in exported.warnings}
    assert said["export-light-nodes"].startswith("Textured: ")


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
        assert all(item.data.name == item.name for item in objects if item.type in ("MESH", "LIGHT"))
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
    exported = export_room(scene, tmp_path / "room.glb", ExportOptions(lamp_lights=False))
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
    assert "export-world" not in {each["code"] for each in exported.warnings}
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


def test_a_dark_environment_is_not_written_and_one_of_other_nodes_is_said(scene, tmp_path):
    nodes = node_tree(scene.world).nodes
    nodes["FIPT Background"].inputs["Strength"].default_value = 0.0
    exported = export_room(scene, tmp_path / "dark.usda")
    assert "DomeLight" not in exported.path.read_text() and not exported.warnings
    nodes["FIPT Background"].inputs["Strength"].default_value = 1.0
    nodes["FIPT Mapping"].inputs["Scale"].default_value = (2.0, 1.0, 1.0)
    exported = export_room(scene, tmp_path / "odd.usda")
    assert "export-world" in {each["code"] for each in exported.warnings}


def test_the_open_file_is_the_same_after_exports_and_renders(scene, tmp_path):
    add_light(scene, "Softbox", "AREA", {"shape": "ELLIPSE"}, UNEVEN)
    mesh = bpy.data.objects["cube"].data  # onto the second image of an atlas
    write_layer(mesh, corner_uvs(mesh, mesh.uv_layers["FIPT"]) + (1.0, 0.0))
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
