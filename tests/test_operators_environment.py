"""The environment, light groups, exposure, other lights, states of all lights and IES profiles."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from fipt_blender.blend import marks
from fipt_blender.blend.marks import has_light_groups
from fipt_blender.blend.pictures.image_files import LAYERED_IMAGE
from fipt_blender.jobs import running
from samples.applied_rooms import world_strength
from samples.operator_calls import refused
from samples.rendered_rooms import exr_layers
from samples.spots import spot

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered", "applied")


def test_light_groups_sum_to_the_image(scene, tmp_path):
    ops.add_light(location=(2.5, 0.5, 2.0), size=0.5, power=30.0)
    layer = bpy.context.view_layer
    layer.lightgroups.add(name="mine")
    assert ops.make_light_groups() == {"FINISHED"}
    names = ["Environment", "Panel", "New Lights"]
    assert sorted(group.name for group in layer.lightgroups) == sorted([*names, "mine"])
    camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
    scene.collection.objects.link(camera)
    camera.matrix_world = Matrix.Translation((3.5, 0.5, 3.0))
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    scene.cycles.sample_clamp_indirect = 0.0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 24, 16, 100
    for name, value in LAYERED_IMAGE.items():
        setattr(scene.render.image_settings, name, value)
    scene.render.filepath = str(tmp_path / "groups.exr")
    bpy.ops.render.render(write_still=True, scene=scene.name)
    layers = exr_layers(tmp_path / "groups.exr")
    whole = layers["ViewLayer.Combined"][..., :3]
    parts = [next(layers[key] for key in layers if key.endswith(f"Combined_{name}"))[..., :3] for name in names]
    assert all(part.max() > 0.0 for part in parts)
    assert np.allclose(sum(parts), whole, rtol=1e-3, atol=1e-4)
    assert ops.make_light_groups() == {"FINISHED"} and len(layer.lightgroups) == 4
    ops.add_light(location=(2.5, 0.5, 1.0), size=0.5, power=30.0)
    assert ops.apply_results() == {"FINISHED"}
    assert {row.object.lightgroup for row in scene.fipt.lights.lights} == {"Panel", "New Lights"}
    assert len(layer.lightgroups) == 4 and scene.world.lightgroup == "Environment"
    assert ops.remove_light_groups() == {"FINISHED"}
    assert [group.name for group in layer.lightgroups] == ["mine"] and not ops.remove_light_groups.poll()
    assert not has_light_groups(layer)
    assert {item.lightgroup for item in scene.objects} == {""}


def test_environment_strength_and_rotation(scene):
    settings = scene.fipt.lights
    assert settings.has_environment() and settings.environment_on and settings.environment_factor == 1.0
    settings.environment_factor = 2.5
    assert world_strength() == 2.5
    settings.environment_on = False
    assert world_strength() == 0.0
    settings.environment_on = True
    settings.environment_rotation = math.radians(30.0)
    ops.apply_results()  # keeps what the artist has set
    assert settings.environment_factor == 2.5 and world_strength() == 2.5
    assert settings.environment_rotation == pytest.approx(math.radians(30.0))


def test_the_environment_rotates_as_entered(scene, tmp_path):
    from fipt_blender.blend.lights.world import apply_environment
    from fipt_blender.core import conventions
    from fipt_blender.core.capture.images import write_exr
    from fipt_blender.core.run.runfolder import RunFolder

    run = RunFolder(tmp_path / "run")
    directions = conventions.equirect_pixel_directions(64, 32)
    write_exr(run.environment_exr, (directions * 0.5 + 0.5).astype(np.float32))
    apply_environment(run, scene)
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    turn = math.radians(50.0)
    scene.fipt.lights.environment_rotation = turn
    way = Vector((1.0, 0.3, 0.2)).normalized()
    seen = spot((0.0, 0.0, 0.0), way, ortho=0.01).mean(axis=(0, 1))
    # The environment is rotated by +50° about Z: what is visible there was 50° back.
    before = Matrix.Rotation(-turn, 3, "Z") @ way
    assert np.allclose(seen, np.array(before) * 0.5 + 0.5, atol=0.03)


def test_what_the_artist_sets_after_apply_stays_when_results_are_applied_again(scene):
    scene.fipt.materials.mute_lights = True
    scene.world = studio = bpy.data.worlds.new("Studio")
    scene.cycles.samples = 77
    lamp = bpy.data.objects.new("Key", bpy.data.lights.new("Key", "POINT"))
    scene.collection.objects.link(lamp)
    neon = bpy.data.materials.new("Neon")
    bpy.data.objects["Panel"].data.materials[0] = neon
    ops.apply_results()
    assert bpy.data.objects["Panel"].data.materials[0] == neon
    assert scene.world == studio and scene.cycles.samples == 77 and not lamp.hide_render
    assert "world-kept" in [message["code"] for message in running.last("materials").warnings]
    ops.revert()
    assert scene.world == studio
    ops.apply_results()
    assert scene.world != studio and marks.WORLD in scene.world and lamp.hide_render


def test_exposure_and_other_lights(scene):
    scene.view_settings.exposure = 3.0
    assert ops.match_exposure() == {"FINISHED"}
    assert scene.view_settings.exposure == pytest.approx(math.log2(0.18 / 0.36))
    scene.fipt.lights.median_shown = 0.72  # photographs that are not HDR show it brighter
    ops.match_exposure()
    assert scene.view_settings.exposure == pytest.approx(1.0)
    scene.fipt.lights.property_unset("median_shown")
    ops.show_map(shown="BASE_COLOR")
    scene.fipt.lights.median_radiance = 0.18
    ops.match_exposure()
    assert scene.view_settings.exposure == 0.0  # of the map
    ops.show_map(shown="ESTIMATED")
    assert scene.view_settings.exposure == pytest.approx(0.0, abs=1e-6)
    sun = bpy.data.objects["sun"]
    assert sun.hide_render
    assert ops.hide_other_lights(hide=False) == {"FINISHED"} and not sun.hide_render
    assert ops.hide_other_lights(hide=True) == {"FINISHED"} and sun.hide_viewport


def test_an_ies_profile_goes_into_the_node_of_a_blender_light(scene, tmp_path):
    path = tmp_path / "lamp.ies"
    path.write_text("IESNA\nTILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1 0 90 0 10 10", encoding="utf-8")
    assert "Convert to Blender Light" in refused(ops.set_ies_profile, filepath=str(path))
    ops.fixture_to_area_light()
    (light,) = scene.fipt.lights.lights[0].object.children
    assert "does not exist" in refused(ops.set_ies_profile, filepath=str(tmp_path / "none.ies"))
    assert ops.set_ies_profile(filepath=str(path)) == {"FINISHED"} and light.data.type == "POINT"
    path.unlink()
    assert ops.apply_results() == {"FINISHED"}  # the profile stays
    (light,) = scene.fipt.lights.lights[0].object.children
    (node,) = (node for node in light.data.node_tree.nodes if node.type == "TEX_IES")
    assert light.data.type == "POINT" and node.ies.lines[0].body == "IESNA" and node.outputs["Fac"].is_linked
    assert ops.area_light_to_fixture() == {"FINISHED"}
