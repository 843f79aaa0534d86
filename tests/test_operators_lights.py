"""Fixtures and lights as scripts drive them: switching, power, colour, conversion."""

from __future__ import annotations

import json
import math

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend.lights.color import blackbody, luminance, temperature_of
from fipt_blender.blend.marks import FIXTURE, INFERRED
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs import running
from samples.applied_rooms import RADIANCE, front, make_applied_scene, make_scene, use_fake_engine, world_strength
from samples.operator_calls import refused
from samples.spots import spot

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene(tmp_path, monkeypatch):
    return make_applied_scene(tmp_path / "run", monkeypatch)


@pytest.mark.parametrize("kelvin", [1200.0, 1900.0, 2700.0, 4000.0, 6504.0, 12000.0])
def test_black_bodies(kelvin):
    rgb = blackbody(kelvin)
    assert luminance(rgb) == pytest.approx(1.0) and min(rgb) >= 0.0
    # Below 1,900 K blue is clipped: the nearest black body is slightly hotter.
    assert temperature_of(rgb) == pytest.approx(kelvin, rel=0.003 if kelvin > 1800.0 else 0.03)


def test_black_body_agrees_with_blender_and_daylight():
    # D65's correlated temperature; the black body is slightly on the magenta side of it.
    assert temperature_of((1.0, 1.0, 1.0)) == pytest.approx(6504.0, rel=0.002)
    scene = bpy.context.scene
    world = scene.world = bpy.data.worlds.new("w")
    if world.node_tree is None:
        world.use_nodes = True
    nodes = world.node_tree.nodes
    node = nodes.new("ShaderNodeBlackbody")
    world.node_tree.links.new(node.outputs[0], nodes["Background"].inputs["Color"])
    for kelvin in (2000.0, 3200.0, 5000.0, 9000.0):
        node.inputs[0].default_value = kelvin
        theirs = spot((0, 0, 0), (0, 0, -1), 1).mean(axis=(0, 1))
        assert np.allclose(theirs / luminance(theirs), blackbody(kelvin), rtol=0.03, atol=0.01), kelvin


def test_power_in_stops_watts_and_radiance(scene):
    row = scene.fipt.lights.lights[0]
    assert (row.on, row.solo, row.stops) == (True, False, 0.0)
    # One square metre of radiance 8, 4, 2 sends out pi A L.
    assert row.watts == pytest.approx(math.pi * 8.0, rel=1e-5) and row.radiance == pytest.approx(8.0)
    row.stops = 1.5
    assert row.watts == pytest.approx(math.pi * 8.0 * 2.0**1.5, rel=1e-5)
    assert np.allclose(front(row.object), np.array(RADIANCE) * 2.0**1.5)
    for name in ("watts", "radiance"):
        row.stops = 0.0
        setattr(row, name, 0.25 * getattr(row, name))
        assert row.stops == pytest.approx(-2.0, abs=1e-5), name
    row.watts = 0.0  # a light is switched off by its switch
    assert row.stops == pytest.approx(-2.0, abs=1e-5)
    assert ops.reset_light() == {"FINISHED"}
    assert row.stops == 0.0 and np.allclose(front(row.object), RADIANCE)


def test_watts_are_those_of_the_blender_light_that_stands_for_a_fixture(scene):
    row = scene.fipt.lights.lights[0]
    ops.fixture_to_area_light()
    (light,) = [child for child in row.object.children if child.type == "LIGHT"]
    assert light.data.energy == pytest.approx(row.watts, rel=1e-4)
    ops.add_light(location=(0, 0, 3), size=1.0, power=50.0)
    added = scene.fipt.lights.active_light()
    assert added.watts == pytest.approx(50.0)
    added.object.data.type = "SUN"
    assert not added.has_power()


def test_colour_and_temperature_keep_the_luminance(scene):
    row = scene.fipt.lights.lights[0]
    assert row.tint == "ESTIMATED" and np.allclose(row.color, [1.0, 0.5, 0.25])
    assert row.kelvin == pytest.approx(temperature_of((1.0, 0.5, 0.25)))
    row.tint = "COLOR"  # starts from its present colour
    assert np.allclose(front(row.object), RADIANCE)
    row.color = (0.2, 0.4, 1.0)
    assert luminance(front(row.object)) == pytest.approx(luminance(RADIANCE), rel=1e-5)
    assert np.allclose(front(row.object) / front(row.object).max(), (0.2, 0.4, 1.0), rtol=1e-5)
    row.kelvin = 3000.0
    assert row.tint == "TEMPERATURE"
    expected = np.array(blackbody(3000.0)) * luminance(RADIANCE)
    assert np.allclose(front(row.object), expected, rtol=1e-5)
    row.color = (0.0, 0.0, 0.0)  # black has no colour: white
    assert np.allclose(front(row.object), luminance(RADIANCE))
    row.tint = "ESTIMATED"
    assert np.allclose(front(row.object), RADIANCE)


def test_on_solo_and_all(scene):
    ops.add_light(location=(0, 0, 3), size=1.0, power=50.0)
    lamp, new = scene.fipt.lights.lights
    energy = new.object.data.energy
    lamp.on = False
    assert not front(lamp.object).any() and new.object.data.energy == energy
    lamp.stops = 1.0  # a light that is off can be changed
    assert not front(lamp.object).any()
    lamp.solo = True
    assert np.allclose(front(lamp.object), np.array(RADIANCE) * 2.0)
    assert new.object.data.energy == 0.0 and world_strength() == 0.0
    lamp.solo = False
    assert not front(lamp.object).any() and new.object.data.energy == energy and world_strength() == 1.0
    assert ops.switch_lights(on=False) == {"FINISHED"}
    assert not front(lamp.object).any() and world_strength() == 0.0 and new.object.data.energy == 0.0
    assert not scene.fipt.lights.environment_on and not lamp.on and not new.on
    assert ops.switch_lights(on=True) == {"FINISHED"} and front(lamp.object).any()
    assert lamp.on and new.on and new.object.data.energy == energy and world_strength() == 1.0


def test_solo_switches_off_a_world_that_the_artist_has_chosen(scene):
    scene.world = bpy.data.worlds.new("my sky")
    layer, row = bpy.context.view_layer, scene.fipt.lights.lights[0]
    row.solo = True
    assert not layer.use_sky
    row.solo = False
    assert layer.use_sky
    row.solo = True
    assert ops.switch_lights(on=True) == {"FINISHED"} and layer.use_sky
    layer.use_sky = False  # hers stays
    row.solo = True
    row.solo = False
    assert not layer.use_sky


def test_strengths_entered_in_blenders_fields_become_settings(scene):
    ops.add_light(location=(0, 0, 3), size=1.0, power=50.0)
    lamp, new = scene.fipt.lights.lights
    lamp.object.data.materials[0].node_tree.nodes["FIPT Front"].inputs["Strength"].default_value = 32.0
    new.object.data.energy = 25.0
    lamp.color = (1.0, 1.0, 1.0)
    new.kelvin = 3000.0
    assert lamp.stops == pytest.approx(2.0) and new.stops == pytest.approx(-1.0)
    assert luminance(front(lamp.object)) == pytest.approx(4.0 * luminance(RADIANCE), rel=1e-4)


def test_settings_are_saved_and_copied_with_the_object(scene, tmp_path):
    row = scene.fipt.lights.lights[0]
    row.stops, row.kelvin, row.on = 2.0, 3000.0, False
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    row = bpy.context.scene.fipt.lights.lights[0]
    assert (row.stops, row.kelvin, row.on, row.tint) == (2.0, 3000.0, False, "TEMPERATURE")
    row.on = True
    expected = np.array(blackbody(3000.0)) * luminance(RADIANCE) * 4.0
    assert np.allclose(front(row.object), expected, rtol=1e-5)
    copy = row.object.copy()
    bpy.data.collections["Lamps"].objects.link(copy)
    ops.list_lights()
    assert [row.stops for row in bpy.context.scene.fipt.lights.lights] == [2.0, 2.0]
    bpy.data.collections["Lamps"].objects.unlink(copy)  # as the artist deletes
    assert [row.is_alive() for row in bpy.context.scene.fipt.lights.lights] == [True, False]
    bpy.data.objects.remove(copy)
    assert [row.is_here() for row in bpy.context.scene.fipt.lights.lights] == [True, False]


def test_new_light(scene):
    cursor = scene.cursor.location = Vector((1.0, 2.0, 2.5))
    assert ops.add_light() == {"FINISHED"}
    item = bpy.context.view_layer.objects.active
    assert (item.location - cursor).length < 1e-6 and item.users_collection[0].name == "Added Lights"
    assert (item.matrix_world.to_3x3() @ Vector((0, 0, -1)) - Vector((0, 0, -1))).length < 1e-6
    assert item.data.type == "AREA" and item.data.energy > 0.0 and 0.0 < item.data.size < 5.0
    ops.add_light(location=(0, 0, 1), direction=(1, 1, 0), size=0.5, power=12.0)
    item = bpy.context.view_layer.objects.active
    shines = item.matrix_world.to_3x3() @ Vector((0, 0, -1))
    assert shines.dot(Vector((1, 1, 0)).normalized()) == pytest.approx(1.0)
    assert (item.data.size, item.data.energy) == (0.5, 12.0)
    assert scene.fipt.lights.active_light().object == item
    bpy.ops.object.delete()
    assert scene.fipt.lights.active_light() is None and "No light is selected" in refused(ops.reset_light)
    ops.list_lights()
    assert len(scene.fipt.lights.lights) == 2
    assert "no direction" in refused(ops.add_light, direction=(0, 0, 0))


def test_a_converted_fixture_follows_its_settings(scene):
    row = scene.fipt.lights.lights[0]
    assert ops.fixture_to_area_light() == {"FINISHED"}
    (light,) = row.object.children
    watts = light.data.energy
    assert watts == pytest.approx(math.pi * 1.0 * max(RADIANCE), rel=1e-5)
    assert np.allclose(light.data.color, [1.0, 0.5, 0.25])
    row.stops = 1.0
    assert light.data.energy == pytest.approx(2.0 * watts)
    row.on = False
    assert light.data.energy == 0.0 and not front(row.object).any()
    row.on = True
    assert ops.fixture_to_area_light() == {"FINISHED"} and len(row.object.children) == 1
    assert ops.area_light_to_fixture() == {"FINISHED"}
    assert not row.object.children and np.allclose(front(row.object), np.array(RADIANCE) * 2.0)
    assert not [light for light in bpy.data.lights if light.name.startswith("Fixture")]


def test_lights_that_the_artist_has_changed_survive_another_apply(scene):
    row = scene.fipt.lights.lights[0]
    assert ops.fixture_to_area_light() == {"FINISHED"}
    (light,) = row.object.children
    light.location.z -= 0.5
    light.data.size, light.data.use_shadow = 0.3, False
    bpy.context.view_layer.update()
    name, place, datablocks = light.name, light.matrix_world.copy(), len(bpy.data.lights)
    row.stops, row.kelvin = 1.0, 2700.0
    watts = light.data.energy
    for _ in range(2):
        assert ops.apply_results() == {"FINISHED"}
        bpy.context.view_layer.update()
        row = scene.fipt.lights.lights[0]
        fixture = row.object
        (light,) = fixture.children
        assert row.stops == 1.0 and row.kelvin == 2700.0
        assert light.name == name and np.allclose(light.matrix_world, place, atol=1e-6)
        assert light.data.size == pytest.approx(0.3) and not light.data.use_shadow
        assert light.data.energy == pytest.approx(watts)
        assert len(bpy.data.lights) == datablocks
    assert ops.area_light_to_fixture() == {"FINISHED"}
    assert not fixture.children and front(fixture).any()
    assert not [item for item in bpy.data.objects if item.type == "LIGHT" and item.name.startswith("Fix")]


def estimate_again(scene, change) -> list[str]:
    """Apply results whose fixtures `change` has edited; returns the codes of warnings."""
    run = RunFolder(scene.fipt.run_folder)
    table = json.loads(run.emitters_json.read_text())
    change(table["fixtures"])
    run.emitters_json.write_text(json.dumps(table))
    run.fields_npz.write_text(json.dumps(table))  # by which results are told from others
    assert ops.apply_results("EXEC_DEFAULT", True) == {"FINISHED"}
    return [message["code"] for message in running.last("materials").warnings]


def test_keyframes_of_the_power_of_a_blender_light_survive_another_apply(scene):
    assert ops.fixture_to_area_light(fixture="Fixture.001") == {"FINISHED"}
    (light,) = scene.fipt.lights.lights[0].object.children
    power = light.data.energy
    light.data.keyframe_insert("energy", frame=1)
    light.data.energy = 4.0 * power
    light.data.keyframe_insert("energy", frame=11)
    scene.frame_set(1)
    assert ops.apply_results() == {"FINISHED"}
    (light,) = scene.fipt.lights.lights[0].object.children
    for frame, factor in ((11, 4.0), (1, 1.0)):
        scene.frame_set(frame)
        assert light.data.energy == pytest.approx(factor * power, rel=1e-4)


def test_changed_lamps_survive_another_estimate(scene):
    """It has another radiance, other numbers of fixtures, and one more lamp."""
    row = scene.fipt.lights.lights[0]
    row.object.name = "Window"
    row.stops, row.kelvin, row.on = -1.5, 2700.0, False

    def again(fixtures: list) -> None:
        (first,) = fixtures
        first |= {"radiance": [1.01 * value for value in RADIANCE], "name": "Fixture.002", "centroid": [2.6, 0.5, 0.0]}
        beside = [triangle - 2 for triangle in first["triangles"]]
        fixtures.insert(0, first | {"name": "Fixture.001", "triangles": beside, "radiance": [2.0, 2.0, 2.0]})

    assert "lamps-unplaced" not in estimate_again(scene, again)
    rows = {row.object[FIXTURE]: row for row in scene.fipt.lights.lights}
    row, other = rows["Fixture.002"], rows["Fixture.001"]
    assert (row.object.name, row.stops, row.kelvin, row.on) == ("Window", -1.5, 2700.0, False)
    assert other.on and other.stops == 0.0 and not front(row.object).any()
    row.on, row.stops, row.tint = True, 0.0, "ESTIMATED"
    assert np.allclose(front(row.object), 1.01 * np.array(RADIANCE))


def test_aimed_lights_survive_another_estimate(scene):
    assert ops.fixture_to_area_light() == {"FINISHED"}
    (light,) = scene.fipt.lights.lights[0].object.children
    light.rotation_euler.x += 0.5
    bpy.context.view_layer.update()
    place, watts = light.matrix_world.copy(), light.data.energy

    def brighter(fixtures: list) -> None:
        fixtures[0] |= {"radiance": [2.0 * value for value in RADIANCE], "name": "Fixture.007"}

    assert "lamps-unplaced" not in estimate_again(scene, brighter)
    bpy.context.view_layer.update()
    (light,) = scene.fipt.lights.lights[0].object.children
    assert np.allclose(light.matrix_world, place, atol=1e-6) and light.data.energy == pytest.approx(2.0 * watts)


def test_what_finds_no_lamp_is_named_and_comes_back(scene):
    row = scene.fipt.lights.lights[0]
    assert ops.fixture_to_area_light() == {"FINISHED"}
    (light,) = row.object.children
    light.location.z -= 0.5
    row.object.name, row.stops = "Window", 1.0
    fixtures: list = []

    def without(table: list) -> None:
        fixtures.extend(table)
        table.clear()

    assert "lamps-unplaced" in estimate_again(scene, without)
    (row,) = scene.fipt.lights.lights  # what she has aimed, for her to switch on
    assert row.object == light and not row.on and light.data.energy == 0.0
    row.on = True
    assert light.data.energy > 0.0
    assert "lamps-unplaced" not in estimate_again(scene, lambda table: table.extend(fixtures))
    (row,) = [row for row in scene.fipt.lights.lights if FIXTURE in row.object]
    assert row.object.name == "Window" and row.stops == 1.0


def test_deleted_lights_stay_deleted_and_others_are_made_anew(scene):
    assert ops.fixture_to_area_light() == {"FINISHED"}
    (light,) = scene.fipt.lights.lights[0].object.children
    bpy.data.objects.remove(light)
    assert ops.apply_results() == {"FINISHED"}
    fixture = scene.fipt.lights.lights[0].object
    assert not fixture.children and not fixture.visible_diffuse
    assert ops.fixture_to_area_light() == {"FINISHED"} and len(fixture.children) == 1
    assert ops.apply_results() == {"FINISHED"}
    assert len(scene.fipt.lights.lights[0].object.children) == 1


def test_light_that_nothing_shows_is_there_with_the_results(tmp_path, monkeypatch):
    use_fake_engine(monkeypatch)
    scene = make_scene(tmp_path / "run")
    path = tmp_path / "run" / "results" / "emitters.json"
    table = json.loads(path.read_text())
    ball = {"position": [0.5, 0.25, 2.0], "radius": 0.1, "inferred": True, "share": 0.25}

    def applied(radiance: list[float]) -> bpy.types.Object:
        path.write_text(json.dumps({**table, "missing": [{**ball, "radiance": radiance}]}))
        assert ops.apply_results() == {"FINISHED"}
        (item,) = [row.object for row in scene.fipt.lights.lights if row.object.type == "LIGHT"]
        return item

    item = applied([30.0, 20.0, 10.0])
    assert item.name == "Unseen Light" and item[INFERRED] == 0.25
    power = item.data.energy * np.array(item.data.color)
    assert power == pytest.approx(4.0 * math.pi**2 * 0.01 * np.array([30.0, 20.0, 10.0]), rel=1e-4)
    assert applied([30.0, 20.0, 10.0]) == item
    scene.fipt.lights.lights["Unseen Light"].stops = 1.0
    ball["position"] = [0.5, 0.25, 1.9]  # another estimate of the same one
    item = applied([3.0, 2.0, 1.0])
    assert item.location.z == pytest.approx(1.9) and scene.fipt.lights.lights["Unseen Light"].stops == 1.0
    assert item.data.energy == pytest.approx(2.0 * 4.0 * math.pi**2 * 0.01 * 3.0, rel=1e-4)
    assert ops.reset_light(light="Unseen Light") == {"FINISHED"}
    ball["position"] = [1.0, 0.25, 2.0]  # other results replace it
    assert tuple(applied([3.0, 2.0, 1.0]).location) == (1.0, 0.25, 2.0)
    ball |= {"position": [2.0, 0.25, 2.0], "facing": [0.0, 0.0, -1.0]}
    disc = applied([30.0, 20.0, 10.0])
    assert (disc.data.type, disc.data.shape, disc.data.size) == ("AREA", "DISK", pytest.approx(0.2))
    assert disc.matrix_world.to_3x3() @ Vector((0.0, 0.0, -1.0)) == Vector((0.0, 0.0, -1.0))
    power = disc.data.energy * np.array(disc.data.color)
    assert power == pytest.approx(math.pi**2 * 0.01 * np.array([30.0, 20.0, 10.0]), rel=1e-4)


def test_names_of_fixtures_stay_on_another_apply_and_so_do_the_artists(scene):
    row = scene.fipt.lights.lights[0]
    assert row.object.name == "Panel" and row.object.data.name == "Panel"
    assert ops.apply_results() == {"FINISHED"}
    assert [row.object.name for row in scene.fipt.lights.lights] == ["Panel"]
    scene.fipt.lights.lights[0].object.name = "Window"
    assert ops.apply_results() == {"FINISHED"}
    assert [row.object.name for row in scene.fipt.lights.lights] == ["Window"]
    assert ops.reset_light(light="Fixture.001") == {"FINISHED"}  # scripts also use the run's name


@pytest.mark.parametrize("transparent", [False, True])
def test_revert_leaves_no_shadow_catchers(scene, transparent):
    scene.render.film_transparent = transparent
    before = {item.name for item in scene.objects if item.is_shadow_catcher}
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    assert scene.objects["cube"].is_shadow_catcher and scene.render.film_transparent
    assert ops.revert() == {"FINISHED"}
    assert {item.name for item in scene.objects if item.is_shadow_catcher} == before
    assert scene.render.film_transparent is transparent and scene.fipt.insert.backdrop == "ROOM"
