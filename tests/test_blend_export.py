"""Export as glTF and USD: what the files hold, opened again in an empty Blender, what stays unchanged."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender import cli
from fipt_blender.blend.export import exporting
from fipt_blender.blend.export.exporting import export_room
from fipt_blender.blend.export.lights import lamp_light
from fipt_blender.blend.lights.color import LUMENS_PER_WATT
from fipt_blender.blend.lights.fixture_nodes import emission_material
from fipt_blender.blend.room.mesh_arrays import corner_uvs
from fipt_blender.core.run.errors import FiptError
from samples.applied_rooms import RADIANCE, ConstantFields, fingerprint
from samples.exported_files import encoded, gltf_json, opened, principled, texel, texture_behind
from samples.refusals import error_of

ops = bpy.ops.fipt


pytestmark = pytest.mark.usefixtures("registered", "applied")


def test_gltf_has_textures_emission_and_names_and_is_valid(scene, tmp_path):
    before = fingerprint(scene)
    exported = export_room(scene, tmp_path / "out" / "room.glb")
    assert exported.objects == 4
    assert [warning["code"] for warning in exported.warnings] == ["export-environment"]
    assert fingerprint(scene) == before and len(bpy.data.scenes) == 1
    document = gltf_json(exported.path)
    assert {node["name"] for node in document["nodes"]} == {"panel", "cube", "Panel", "Panel Light"}
    surfaces = [material for material in document["materials"] if "emissiveFactor" not in material]
    assert sorted(material["name"] for material in surfaces) == ["Cube", "Panel"]
    for material in surfaces:
        values = material["pbrMetallicRoughness"]
        assert values["baseColorTexture"]["index"] != values["metallicRoughnessTexture"]["index"]
    (lamp,) = (material for material in document["materials"] if "emissiveFactor" in material)
    assert lamp["name"] == "Panel Light" and not lamp.get("doubleSided")  # its back is dark
    strength = lamp["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    nits = LUMENS_PER_WATT * np.array(RADIANCE)
    assert np.allclose(strength * np.array(lamp["emissiveFactor"]), nits, rtol=1e-4)
    (light,) = document["extensions"]["KHR_lights_punctual"]["lights"]
    # The lumens of a surface of 1 m², where the light falls off to the edge of its cone by a smoothstep.
    edge = np.cos(light["spot"]["outerConeAngle"])
    assert light["type"] == "spot" and light["spot"]["innerConeAngle"] == pytest.approx(0.0, abs=1e-3)
    lumens = np.pi * (1.0 - edge) * light["intensity"] * np.array(light["color"])
    assert np.allclose(lumens, np.pi * nits, rtol=1e-4)
    assert {image["name"] for image in document["images"]} == {"Room_001_base_color", "Room_001_orm"}
    accessors = {key for mesh in document["meshes"] for each in mesh["primitives"] for key in each["attributes"]}
    assert "TEXCOORD_0" in accessors and "TEXCOORD_1" not in accessors


@pytest.mark.parametrize("suffix", [".gltf", ".usda"])
def test_two_exports_into_a_folder_share_no_picture(scene, tmp_path, suffix):
    """The first one stays what it was, whatever the second shows."""
    export_room(scene, tmp_path / f"a{suffix}")
    first = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    scene.fipt.materials.parts["Cube"].value = 0.5
    export_room(scene, tmp_path / f"b{suffix}")
    assert sum(path.suffix == ".png" for path in first) == 2
    assert {path: path.read_bytes() for path in first} == first
    assert len([path for path in tmp_path.rglob("*.png")]) == 6  # the cube has its own by now


def test_inserted_objects_are_in_the_file_with_their_materials(scene, tmp_path):
    bpy.ops.fipt.add_ball(kind="MIRROR_BALL", size=0.5)
    curve = bpy.data.objects.new("Cable", bpy.data.curves.new("Cable", "CURVE"))
    curve.data.splines.new("POLY").points.add(1)
    curve.data.splines[0].points[1].co = (1.0, 0.0, 0.0, 1.0)
    curve.data.bevel_depth, curve.data.dimensions = 0.05, "3D"
    group = bpy.data.collections.new("Set")
    group.objects.link(bpy.data.objects.new("Leg", bpy.data.objects["cube"].data.copy()))
    instance = bpy.data.objects.new("Chair", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", group
    for item in (curve, instance):
        scene.collection.objects.link(item)
    exported = export_room(scene, tmp_path / "room.glb")
    document = gltf_json(exported.path)
    nodes = {node["name"]: node for node in document["nodes"]}
    assert {"FIPT Mirror Ball", "Cable", "Chair", "Leg"} <= set(nodes)
    mesh = document["meshes"][nodes["FIPT Mirror Ball"]["mesh"]]
    material = document["materials"][mesh["primitives"][0]["material"]]
    assert material["name"] == "FIPT Mirror Ball" and material["pbrMetallicRoughness"].get("metallicFactor", 1.0) == 1.0
    assert [warning["code"] for warning in exported.warnings] == ["export-environment"]
    assert len(bpy.data.scenes) == 1


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="a folder that nobody can write to")
def test_a_folder_that_cannot_be_written_is_explained(scene):
    with pytest.raises(FiptError) as caught:
        export_room(scene, Path("/proc/self/room.glb"))
    assert "Traceback" not in str(caught.value) and "/proc/self" in str(caught.value)


def test_an_export_that_fails_leaves_what_was_there(scene, tmp_path, monkeypatch):
    export_room(scene, tmp_path / "out" / "room.gltf")
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*")}

    def full(path):
        raise FiptError.of("disk-full", f"{path}", "Free some space.")

    monkeypatch.setattr(exporting, "check_space", full)
    scene.fipt.materials.parts["Cube"].value = 0.5
    assert error_of(export_room, scene, tmp_path / "out" / "room.gltf").code == "disk-full"
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*")} == before
    assert error_of(export_room, scene, tmp_path / "new" / "room.glb").code == "disk-full"
    assert not (tmp_path / "new").exists()


def first_middle(mesh):
    """The middle of the first polygon in the UVs, (2,)."""
    return corner_uvs(mesh, mesh.uv_layers[0])[list(mesh.polygons[0].loop_indices)].mean(axis=0)


@pytest.mark.parametrize("suffix", [".glb", ".usdc"])
def test_an_empty_blender_shows_the_estimate_with_its_adjustments(scene, tmp_path, suffix):
    part = scene.fipt.materials.parts["Cube"]
    part.value, part.roughness_offset = 0.5, 0.2
    export_room(scene, tmp_path / f"room{suffix}")
    objects, _ = opened(tmp_path / f"room{suffix}")
    cube = objects["cube"].data
    assert len(cube.uv_layers) == 1
    material = cube.materials[0]
    shader = principled(material)
    color, rough, metal = (texture_behind(shader.inputs[name]) for name in ("Base Color", "Roughness", "Metallic"))
    wanted = np.array(ConstantFields.base_color)
    middle = first_middle(cube)
    assert np.allclose(texel(color, middle), encoded(0.5 * wanted), atol=0.004)
    assert texel(rough, middle)[1] == pytest.approx(ConstantFields.roughness + 0.2, abs=0.004)
    assert texel(metal, middle)[2] == pytest.approx(ConstantFields.metallic, abs=0.004)
    # USD's names may not differ by case alone.
    named = {item.name.removesuffix("_001"): item for item in objects}
    panel = named["panel"].data
    color = texture_behind(principled(panel.materials[0]).inputs["Base Color"])
    assert np.allclose(texel(color, first_middle(panel)), encoded(wanted), atol=0.004)
    lamp = principled(named["Panel"].data.materials[0])
    emitted = np.array(lamp.inputs["Emission Color"].default_value[:3])
    unit = LUMENS_PER_WATT if suffix == ".glb" else 1.0
    emitted *= lamp.inputs["Emission Strength"].default_value
    assert np.allclose(emitted, unit * np.array(RADIANCE), rtol=1e-3)
    # The world axes are Blender's again.
    corners = [named["panel"].matrix_world @ vertex.co for vertex in panel.vertices]
    assert max(abs(corner.z) for corner in corners) < 1e-5 and max(corner.x for corner in corners) > 4.0


def test_a_ball_has_a_point_light_of_its_power():
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2, radius=0.1, location=(1.0, 2.0, 3.0))
    item = bpy.context.object
    mesh = item.data
    mesh.materials.append(emission_material("Ball", [3.0, 2.0, 1.0], [9.0, 9.0, 9.0]))
    light, matrix = lamp_light(item)
    area = sum(face.area for face in mesh.polygons)
    assert light.type == "POINT" and np.allclose(matrix.translation, (1.0, 2.0, 3.0), atol=1e-3)
    assert np.allclose(light.energy * np.array(light.color), np.pi * area * np.array([3.0, 2.0, 1.0]), rtol=1e-3)


def test_what_can_not_be_exported_is_refused_and_changes_nothing(scene, tmp_path):
    before = fingerprint(scene)
    error = error_of(export_room, scene, tmp_path / "room.obj")
    assert error.code == "export-format"
    ops.show_map(shown="ORIGINAL")
    error = error_of(export_room, scene, tmp_path / "room.glb")
    assert error.code == "export-nothing" and not ops.export_room.poll()
    ops.show_map(shown="ESTIMATED")
    (tmp_path / "file").write_text("no folder")
    error = error_of(export_room, scene, tmp_path / "file" / "room.glb")
    assert error.code == "run-unwritable"
    assert fingerprint(scene) == before
    scene.fipt.materials.atlas_mode = "color_attribute"
    ops.apply_results()
    error = error_of(export_room, scene, tmp_path / "room.glb")
    assert error.code == "export-attributes" and not (tmp_path / "room.glb").exists()


def test_the_command_line(scene, tmp_path, capfd):
    blend = tmp_path / "kitchen.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    assert cli.main(["export", str(blend), str(tmp_path / "kitchen.glb")]) == 0
    output = capfd.readouterr()
    assert "kitchen.glb" in output.out and gltf_json(tmp_path / "kitchen.glb")["materials"]
    assert cli.main(["export", str(tmp_path / "none.blend"), str(tmp_path / "x.glb")]) == 1
    assert "does not exist" in capfd.readouterr().err
    blend.write_bytes(b"not a file of Blender")
    assert cli.main(["export", str(blend), str(tmp_path / "x.glb")]) == 1
    assert not (tmp_path / "x.glb").exists()
