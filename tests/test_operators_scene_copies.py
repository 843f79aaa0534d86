"""Full copies of a scene are rooms of their own; linked rooms are said and not changed."""

from __future__ import annotations

import itertools

import bpy
import pytest

from fipt_blender.blend import marks
from fipt_blender.blend.lights import light_state
from fipt_blender.blend.lights.fixture_nodes import is_emission_material, side_radiance
from fipt_blender.blend.results import adjust, dropped
from fipt_blender.panels import lights, path
from samples import artist
from samples.applied_rooms import RADIANCE, front
from samples.layouts import drawn_by
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


def full_copy(scene: bpy.types.Scene) -> bpy.types.Scene:
    before = set(bpy.data.scenes)
    with bpy.context.temp_override(scene=scene):
        bpy.ops.scene.new(type="FULL_COPY")
    (copy,) = set(bpy.data.scenes) - before
    return copy


def look(scene: bpy.types.Scene) -> dict[str, tuple]:
    """All that a scene shows: objects with their faces, materials' values and lights."""
    bpy.context.window.scene = scene
    bpy.context.view_layer.update()
    found = {}
    for item in scene.objects:
        materials = [slot.material for slot in item.material_slots]
        found[item.name] = (
            artist.faces(item) if item.type == "MESH" else None,
            [material and values_of(material) for material in materials],
            item.data.energy if item.type == "LIGHT" else None,
            [tuple(row) for row in item.matrix_world],
            item.hide_render,
        )
    background = scene.world.node_tree.nodes["FIPT Background"]
    found["world"] = (scene.world.name, background.inputs["Strength"].default_value)
    return found


def values_of(material: bpy.types.Material) -> tuple:
    if not (marks.MATERIAL in material or is_emission_material(material)):
        return (material.name,)
    nodes = material.node_tree.nodes
    images = [node.image.filepath for node in nodes if getattr(node, "image", None) is not None]
    surface = nodes["FIPT Output"].inputs["Surface"].links[0].from_node.name if "FIPT Output" in nodes else ""
    return side_radiance(material), adjust.read(material), images, surface


def change_part(scene, **values):
    part = next(row for row in scene.fipt.materials.parts if row.name == "Cube")
    for name, value in values.items():
        setattr(part, name, value)


def replace_part(scene):
    keys = [row.name for row in scene.fipt.materials.parts]
    scene.fipt.materials.active_part = keys.index("Cube")
    bpy.data.materials.new("velvet")
    ops.replace_part_material(material="velvet")


def finer(scene):
    scene.fipt.materials.texel_density = 48.0
    ops.apply_results()


ACTIONS = {
    "switch off": lambda scene: ops.switch_lights(on=False),
    "environment": lambda scene: setattr(scene.fipt.lights, "environment_on", False),
    "apply": lambda scene: ops.apply_results(),
    "apply finer": finer,
    "adjust": lambda scene: change_part(scene, roughness_offset=0.2, hue=0.1),
    "replace": replace_part,
    "show a map": lambda scene: ops.show_map(shown="ROUGHNESS"),
    "convert": lambda scene: ops.fixture_to_area_light(fixture="Fixture.001"),
    "revert": lambda scene: ops.revert(),
    "revert all": lambda scene: ops.revert(new_lights=True),
}


@pytest.mark.parametrize(("action", "in_copy"), list(zip(ACTIONS, itertools.cycle([True, False]))))
def test_what_is_done_in_one_scene_changes_nothing_in_its_copy(applied, action, in_copy):
    copy = full_copy(applied)
    acted, other = (copy, applied) if in_copy else (applied, copy)
    before, own = look(other), look(acted)
    bpy.context.window.scene = acted
    ACTIONS[action](acted)
    changed = look(acted) if marks.room_with_results(acted) else {}
    assert look(other) == before
    for shown in ("ROUGHNESS", "ESTIMATED"):  # which writes to all materials
        ops.show_map(shown=shown)
    assert look(other) == before or action == "show a map"
    assert changed != own or action == "apply"
    for scene in (applied, copy):  # both work afterwards
        bpy.context.window.scene = scene
        assert ops.apply_results() == {"FINISHED"}
        assert [item[marks.FIXTURE] for item in scene.objects if marks.is_fixture(item)] == ["Fixture.001"]
        assert len(scene.fipt.lights.lights) == 1
        assert ops.revert() == {"FINISHED"}
        assert not [item for item in scene.objects if marks.is_fixture(item)]


def test_reverting_a_copy_leaves_solid_shading_to_the_first_scene(scene):
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas]
    shading = next(area.spaces.active for area in areas if area.type == "VIEW_3D").shading
    shading.type, shading.color_type = "SOLID", "RANDOM"
    assert ops.apply_results() == {"FINISHED"}
    copy = full_copy(scene)
    bpy.context.window.scene = copy
    assert ops.revert() == {"FINISHED"} and shading.color_type == "TEXTURE"
    bpy.context.window.scene = scene
    assert ops.revert() == {"FINISHED"} and shading.color_type == "RANDOM"


def test_a_material_that_the_artist_edits_herself_changes_in_one_scene(applied):
    copy = full_copy(applied)
    assert bpy.app.timers.is_registered(dropped.own_copies)
    dropped.own_copies()
    for acted, other in ((copy, applied), (applied, copy)):
        before = look(other)
        bpy.context.window.scene = acted
        for item in acted.objects:
            for slot in item.material_slots:
                for node in slot.material.node_tree.nodes if slot.material else ():
                    if node.bl_idname == "ShaderNodeEmission":
                        node.inputs["Strength"].default_value += 3.0
                    elif "Hue" in node.inputs and node.bl_idname == "ShaderNodeGroup":
                        node.inputs["Hue"].default_value += 0.1
        assert look(other) == before


def test_a_scene_that_shares_some_objects_changes_no_materials(applied):
    lamp = bpy.data.objects["Panel"]
    room = [item for item in applied.objects if item.type == "MESH" and item != lamp]
    materials = [material for item in room for material in item.data.materials]
    lamp.data.materials.append(next(each for each in materials if each and marks.MATERIAL in each))
    other = applied.copy()  # as for a picture over the photograph
    for group in list(other.collection.children):
        other.collection.children.unlink(group)
    for item in room:
        other.collection.objects.link(item)
    dropped.own_copies()
    assert [material for item in room for material in item.data.materials] == materials


def test_a_copied_lamp_has_a_switch_of_its_own(applied):
    """Duplicated by Shift D, which shares the material."""
    lamp = bpy.data.objects["Panel"]
    other = lamp.copy()
    other.data = lamp.data.copy()
    lamp.users_collection[0].objects.link(other)
    before = side_radiance(lamp.data.materials[0])
    light_state.change(applied, other, {marks.ON: False})
    assert side_radiance(lamp.data.materials[0]) == before
    assert side_radiance(other.data.materials[0])[0] == (0.0, 0.0, 0.0)


@pytest.fixture(params=["link", "override", "instance"])
def shot(applied, request, tmp_path):
    """A shot file with the room's collections, linked, overridden, or shown by an empty, as Link does first."""
    run, room = applied.fipt.run_folder, str(tmp_path / "room.blend")
    bpy.ops.wm.save_as_mainfile(filepath=room)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(room, link=True) as (source, target):
        target.collections = source.collections
    scene = bpy.context.scene
    inner = {child for each in target.collections for child in each.children_recursive}
    rooms = [each for each in target.collections if each not in inner]
    for each in rooms:
        if request.param == "instance":
            empty = bpy.data.objects.new(each.name, None)
            empty.instance_type, empty.instance_collection = "COLLECTION", each
            scene.collection.objects.link(empty)
        else:
            scene.collection.children.link(each)
    if request.param == "override":
        layer = bpy.context.view_layer
        for each in rooms:
            each.override_hierarchy_create(scene, layer, do_fully_editable=True)
            scene.collection.children.unlink(each)
    scene.fipt.run_folder = run
    light_state.list_lights(scene)
    return scene


def test_a_linked_room_says_what_it_is_lists_its_lamps_and_is_not_changed(shot):
    assert [set(names) for names in marks.linked_lamps(shot).values()] == [{"Panel"}]
    assert not shot.fipt.lights.lights and path.has_lights(bpy.context)
    texts, _ = drawn_by(lights.FIPT_PT_lights)
    assert "Panel" in texts and "room.blend" in " ".join(texts)
    light_state.switch_all(False)
    assert front(bpy.data.objects["Panel"]).tolist() == RADIANCE
    for operator in (ops.apply_results, ops.revert, ops.export_room, ops.remove_from_room, ops.list_lights):
        assert not operator.poll() and "linked" in refused(operator)
