"""Lights in viewports: rows that follow the selection, aiming, and the set-up for EEVEE."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend import render_settings
from fipt_blender.blend.capture.cameras import use_view
from fipt_blender.blend.lights import calibration, eevee, new_lights
from fipt_blender.blend.marks import PIXEL_ASPECT, RESOLUTION, VIEW, VISIBILITY, light_probe
from fipt_blender.blend.render_settings import changed_by_artist
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.applied_rooms import make_applied_scene
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene(tmp_path, monkeypatch):
    return make_applied_scene(tmp_path / "run", monkeypatch)


def test_a_light_is_aimed_and_its_beam_ends_on_the_room():
    bpy.ops.mesh.primitive_plane_add(size=10.0)
    ops.add_light(location=(1.0, 0.0, 3.0))
    light, scene = bpy.context.object, bpy.context.scene
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    assert (new_lights.beam_end(scene, graph, light, 2.0) - Vector((1, 0, 0))).length < 1e-5
    assert ops.aim_light(target=(-2.0, 1.0, 0.0)) == {"FINISHED"}
    bpy.context.view_layer.update()
    assert (light.location - Vector((1, 0, 3))).length < 1e-6
    assert (new_lights.beam_end(scene, graph, light, 2.0) - Vector((-2, 1, 0))).length < 1e-4
    ops.aim_light(target=(1.0, 0.0, 9.0))
    bpy.context.view_layer.update()
    assert (new_lights.beam_end(scene, graph, light, 2.0) - Vector((1, 0, 5))).length < 1e-4
    assert "at this point" in refused(ops.aim_light, target=(1.0, 0.0, 3.0))
    bpy.context.view_layer.objects.active = bpy.data.objects["Plane"]
    assert not ops.aim_light.poll()


def test_the_room_is_set_up_for_eevee_and_reverted(scene):
    assert scene.render.engine == "CYCLES" and not scene.fipt.lights.needs_cycles()
    assert not scene.fipt.lights.needs_probe()
    scene.fipt.lights.median_radiance = 0.0018
    settings = {name: getattr(scene.eevee, name) for name in ("use_raytracing", "light_threshold")}
    assert not settings["use_raytracing"]
    assert ops.prepare_eevee() == {"FINISHED"}
    assert scene.eevee.use_raytracing
    assert scene.eevee.light_threshold == pytest.approx(1e-4)  # of a hundredth of a usual exposure
    assert "EEVEE" in scene.render.engine and not scene.fipt.lights.needs_cycles()
    assert scene.fipt.lights.needs_probe()  # it can't be baked here
    (fixture,) = [row.object for row in scene.fipt.lights.lights]
    assert VISIBILITY in fixture and len(fixture.children) == 1
    volume = light_probe(scene)
    bpy.context.view_layer.update()
    corners = np.array([volume.matrix_world @ Vector(sign) for sign in ((-1, -1, -1), (1, 1, 1))])
    # EEVEE fades the volume into the world before its border: the walls are one sample within it.
    data = volume.data
    spacing = (corners[1] - corners[0]) / (data.resolution_x, data.resolution_y, data.resolution_z)
    assert np.allclose(corners[0] + spacing, (-1, 0, -1), atol=1e-5)
    assert np.allclose(corners[1] - spacing, (5, 6, 1), atol=1e-5)
    assert np.allclose(corners.mean(axis=0), (2, 3, 0), atol=1e-5)
    assert tuple(eevee.resolution(np.array([0.1, 4.0, 100.0]))) == (4, 10, 32)
    assert ops.prepare_eevee() == {"FINISHED"} and len(bpy.data.lightprobes) == 1
    assert "only in a window" in refused(ops.bake_probe)
    ops.revert()
    assert not bpy.data.lightprobes and not ops.bake_probe.poll() and not ops.prepare_eevee.poll()
    assert settings == {name: getattr(scene.eevee, name) for name in settings}


@pytest.mark.parametrize("engine", ["CYCLES", "BLENDER_WORKBENCH"])
def test_revert_restores_the_artists_engine_however_often_it_was_switched(scene, engine):
    ops.revert()
    keys = set(scene.keys())
    scene.render.engine = engine
    ops.apply_results()
    for switch in (ops.prepare_eevee, ops.use_cycles, ops.prepare_eevee, ops.use_cycles):
        assert switch() == {"FINISHED"}
    ops.revert()
    assert scene.render.engine == engine and set(scene.keys()) == keys
    ops.apply_results()
    ops.prepare_eevee()
    scene.render.engine = "BLENDER_WORKBENCH"  # the artist's choice, from which we switch again
    ops.use_cycles()
    ops.revert()
    assert scene.render.engine == "BLENDER_WORKBENCH"


def test_a_file_opened_without_a_denoiser_renders_without_unless_the_artist_has_chosen(scene, tmp_path, monkeypatch):
    """Cycles ends with an error where it shall denoise but can't."""
    monkeypatch.setattr(render_settings, "can_denoise", lambda: True)
    ops.apply_results()
    own = scene.copy()
    own.name, own.use_fake_user, own.cycles.samples = "Own", True, 99
    assert scene.cycles.use_denoising and own.cycles.use_denoising
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    monkeypatch.setattr(render_settings, "can_denoise", lambda: False)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    found = [(each.cycles.use_denoising, each.cycles.samples) for each in (bpy.context.scene, bpy.data.scenes["Own"])]
    assert found == [(False, render_settings.MOST_UNDENOISED), (False, 99)]
    # Fireflies, which the denoiser would remove, are clamped far above the picture's white.
    scene = bpy.context.scene
    white = 2.0**-scene.view_settings.exposure
    clamp = scene.cycles.sample_clamp_indirect
    assert clamp == pytest.approx(render_settings.CLAMPED_UNDENOISED * white, rel=1e-4) and clamp > 4.0 * white
    calibration.scale_light(scene, 100.0)
    assert scene.cycles.sample_clamp_indirect == pytest.approx(100.0 * clamp, rel=1e-4)
    ops.revert()
    assert scene.cycles.sample_clamp_indirect == 10.0  # Blender's own


def test_looking_through_a_view_shows_the_room_as_bright_as_its_photograph(scene):
    exposures = {"a": 1.5, "b": -0.5}
    for name in exposures:
        camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
        scene.collection.objects.link(camera)
        camera[VIEW] = name
        view = scene.fipt.capture.views.add()
        view.name = view.camera = name
    run, median = RunFolder(scene.fipt.run_folder), scene.view_settings.exposure
    photometry = {"views": {"a": {"shown_ev": exposures["a"]}}}
    write_json(run.statistics_json, {"radiance_scale": 0.36, "photometry": photometry})
    held_back = {"held_back_db": 20.0, "projection_db": 22.0, "exposures": {"b": exposures["b"]}}
    write_json(run.quality_json, held_back)  # the estimation has not seen it

    def shown(name: str) -> float:
        ops.look_through(view=name)
        return scene.view_settings.exposure - median

    assert ops.apply_results() == {"FINISHED"} and scene.view_settings.exposure == pytest.approx(median)
    assert [shown(name) for name in "aba"] == pytest.approx([1.5, -0.5, 1.5])
    assert ops.apply_results() == {"FINISHED"} and scene.view_settings.exposure == pytest.approx(median + 1.5)
    scene.view_settings.exposure += 1.0  # what the artist adds stays
    assert [shown(name) for name in "ba"] == pytest.approx([0.5, 2.5])
    ops.match_exposure()
    assert scene.view_settings.exposure - median == pytest.approx(1.5)
    ops.show_map(shown="ROUGHNESS")
    assert shown("b") == pytest.approx(-median)  # a map has none
    ops.show_map(shown="ESTIMATED")
    render_settings.follow_exposure(scene, 0.0)  # a free view
    assert scene.view_settings.exposure == pytest.approx(median)
    assert ops.revert() == {"FINISHED"} and scene.fipt.capture.shown_exposure == 0.0


def test_render_settings_are_set_once_and_what_the_artist_changes_survives(scene):
    ops.revert()
    scene.view_settings.view_transform, scene.cycles.samples, scene.cycles.max_bounces = "AgX", 4096, 7
    scene.render.resolution_x, scene.render.resolution_y = 640, 360
    ops.apply_results()
    assert (scene.render.engine, scene.view_settings.view_transform) == ("CYCLES", "Standard")
    assert scene.cycles.use_adaptive_sampling and scene.cycles.samples < 4096
    assert (scene.render.resolution_x, scene.render.resolution_y) == (1920, 1080)
    ours = scene.cycles.adaptive_threshold
    scene.cycles.samples, scene.view_settings.exposure = 77, 3.0
    scene.render.resolution_x, scene.render.resolution_y = 800, 450
    assert changed_by_artist(scene) == ["cycles.samples", "view_settings.exposure"]
    scene.fipt.lights.median_radiance *= 2.0  # another estimate
    ops.apply_results()
    camera = bpy.data.objects.new("View", bpy.data.cameras.new("View"))
    camera[RESOLUTION], camera[PIXEL_ASPECT] = [300, 200], [1.0, 1.0]
    use_view(scene, camera)
    assert scene.cycles.samples == 77 and scene.view_settings.exposure == 3.0
    assert (scene.render.resolution_x, scene.render.resolution_y) == (800, 533)
    assert ops.set_rendering() == {"FINISHED"} and not changed_by_artist(scene)
    assert scene.cycles.samples != 77 and scene.cycles.adaptive_threshold == ours
    scene.cycles.max_bounces = 3
    ops.revert()  # to what was last the artist's
    assert scene.view_settings.view_transform == "AgX" and scene.view_settings.exposure == 3.0
    assert (scene.cycles.samples, scene.cycles.max_bounces) == (77, 3)
