"""The unit of light by one lamp or one lux meter: the flux of a surface, linearity, what stays, undo."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend.lights.calibration import calibrate_by_lux, exposure_value
from fipt_blender.blend.pictures.cycles import RenderOptions, render_exr
from fipt_blender.blend.pictures.image_files import read_pixels
from samples.applied_rooms import RADIANCE, front, world_strength
from samples.refusals import error_of

ops = bpy.ops.fipt
pytestmark = pytest.mark.usefixtures("registered", "applied")
# 683 lm/W times pi A times the luminance of the radiance; the lamp is a square of 1 m².
FLUX = 683.0 * math.pi * float(np.dot(RADIANCE, (0.2126, 0.7152, 0.0722)))


@pytest.fixture
def lamp(scene):
    return next(row for row in scene.fipt.lights.lights if row.object.name == "Panel")


def view(scene, path):
    """Mean (3,) of a small picture of the room by the add-on, in the unit of the photographs."""
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.matrix_world = Vector((0.0, 0.0, 1.0)).to_track_quat("Z", "Y").to_matrix().to_4x4()
    camera.location = (3.5, 0.5, 3.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.resolution_percentage = 100
    bpy.context.view_layer.update()
    render_exr(scene, path, RenderOptions(256, denoise=False))
    return read_pixels(path).mean(axis=(0, 1))[:3]


def test_one_lamp_decides_for_all_and_pictures_stay(scene, lamp, tmp_path):
    assert lamp.lumens == pytest.approx(FLUX, rel=1e-4)
    bpy.data.objects["sun"].data.energy = 3.0
    before = view(scene, tmp_path / "a.exr")
    watts, world, bright = lamp.watts, world_strength(), exposure_value(scene)
    assert ops.calibrate_light(lumens=0.01 * FLUX, light="Panel") == {"FINISHED"}
    assert lamp.lumens == pytest.approx(0.01 * FLUX, rel=1e-4) and lamp.stops == 0.0
    assert np.allclose(front(lamp.object), 0.01 * np.array(RADIANCE), rtol=1e-4)
    assert lamp.watts == pytest.approx(0.01 * watts) and world_strength() == pytest.approx(0.01 * world)
    assert bpy.data.objects["sun"].data.energy == pytest.approx(0.03)
    assert exposure_value(scene) == pytest.approx(bright + math.log2(0.01))
    assert np.allclose(view(scene, tmp_path / "b.exr"), before, rtol=0.01)
    # What Cycles itself shows is as bright as before.
    assert scene.cycles.film_exposure == pytest.approx(100.0)
    ops.calibrate_light(lumens=0.03 * FLUX, light="Panel")
    assert world_strength() == pytest.approx(0.03 * world, rel=1e-5)
    assert scene.cycles.film_exposure == pytest.approx(100.0 / 3.0)


def test_new_results_and_edits_keep_the_unit_and_revert_removes_it(scene, lamp):
    film, sun = scene.cycles.film_exposure, bpy.data.objects["sun"].data.energy
    ops.calibrate_light(lumens=0.5 * FLUX, light="Panel")
    lamp.lumens = 0.25 * FLUX
    assert lamp.stops == pytest.approx(-1.0)
    assert ops.apply_results() == {"FINISHED"}
    again = next(row for row in scene.fipt.lights.lights if row.object.name == "Panel")
    assert again.lumens == pytest.approx(0.25 * FLUX, rel=1e-4) and world_strength() == pytest.approx(0.5)
    assert np.allclose(front(again.object), 0.25 * np.array(RADIANCE), rtol=1e-3)
    ops.revert()
    assert "fipt_unit" not in scene and scene.cycles.film_exposure == pytest.approx(film)
    assert bpy.data.objects["sun"].data.energy == pytest.approx(sun)
    assert ops.apply_results() == {"FINISHED"} and world_strength() == pytest.approx(1.0)


def test_lux_of_a_lamp_above_a_place(scene):
    for item in (*scene.objects,):
        item.hide_render = True
    scene.world = None
    light = bpy.data.lights.new("Bulb", "POINT")
    light.energy, light.shadow_soft_size = 20.0, 0.0
    item = bpy.data.objects.new("Bulb", light)
    item.location = (0.0, 0.0, 2.02)
    scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    lux = 683.0 * 20.0 / (4.0 * math.pi * 4.0)  # watts over 4 pi d²
    factor = calibrate_by_lux(scene, (0.0, 0.0, 0.0), 2.0 * lux, samples=4)
    assert factor == pytest.approx(2.0, rel=2e-3) and light.energy == pytest.approx(20.0 * factor)
    assert "Probe" not in bpy.data.objects and scene.render.engine == "CYCLES"
    light.energy = 0.0
    assert error_of(calibrate_by_lux, scene, (0.0, 0.0, 0.0), 300.0, 4).code == "calibration-dark"


def test_it_can_be_undone(scene):
    film = scene.cycles.film_exposure
    bpy.ops.ed.undo_push(message="before")
    ops.calibrate_light(lumens=2.0 * FLUX, light="Panel")
    bpy.ops.ed.undo_push(message="calibrated")
    assert world_strength() == pytest.approx(2.0)
    bpy.ops.ed.undo()
    assert world_strength() == pytest.approx(1.0) and "fipt_unit" not in bpy.context.scene
    assert bpy.context.scene.cycles.film_exposure == pytest.approx(film)
