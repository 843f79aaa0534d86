# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Placing objects in the room: where and how, what is refused, and removing them."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from fipt_blender.blend import marks
from fipt_blender.blend.insert import placing, sample_objects, surfaces
from samples.rendered_rooms import VIEW, make_scene

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene(tmp_path):
    make_scene(tmp_path)
    return bpy.context.scene


def place(**options):
    return bpy.ops.fipt.insert_object("EXEC_DEFAULT", **options)


def lowest(*items):
    bpy.context.view_layer.update()
    return min((item.matrix_world @ vertex.co).z for item in items for vertex in item.data.vertices)


def add_cube(scene, name="Chair", size=0.2, location=(1.0, 0.5, 3.0)):
    bpy.ops.mesh.primitive_cube_add(size=size, location=location)
    bpy.context.object.name = name
    return bpy.context.object


def test_a_ball_stands_where_the_pixel_shows_the_floor(scene):
    assert place(kind="GREY_BALL", view=VIEW, pixel=(16.0, 12.0)) == {"FINISHED"}
    ball = bpy.data.objects["FIPT Gray Ball"]
    assert lowest(ball) == pytest.approx(0.0, abs=1e-4)
    place_of_ball = ball.matrix_world.translation.copy()
    assert place(kind="OBJECT", object_name=ball.name, view=VIEW, pixel=(16.0, 12.0)) == {"FINISHED"}
    assert (ball.matrix_world.translation - place_of_ball).length < 1e-5  # the ray skips the ball itself
    assert bpy.context.view_layer.objects.active == ball and ball.select_get()


def test_the_pixel_of_a_surface_agrees_with_the_camera(scene):
    from bpy_extras.object_utils import world_to_camera_view

    camera = bpy.data.objects[VIEW]
    place = surfaces.surface_at(scene, camera, 10.25, 13.5).position
    x, y, _ = world_to_camera_view(scene, camera, place)
    assert (x * 32, (1.0 - y) * 20) == (pytest.approx(10.25, abs=1e-3), pytest.approx(13.5, abs=1e-3))


def test_a_wall_tilts_objects_unless_upright(scene):
    cube = add_cube(scene)
    on_wall = {"kind": "OBJECT", "object_name": "Chair", "location": (0, 2, 1), "normal": (0, -1, 0)}
    assert place(align="NORMAL", **on_wall) == {"FINISHED"}
    assert (cube.matrix_world.to_3x3() @ Vector((0, 0, 1)) - Vector((0, -1, 0))).length < 1e-5
    assert cube.matrix_world.translation.y == pytest.approx(1.9, abs=1e-5)  # its bottom touches the wall
    assert place(align="UPRIGHT", **on_wall) == {"FINISHED"}
    assert cube.matrix_world.to_3x3().is_orthogonal and cube.matrix_world[2][2] == pytest.approx(1.0)
    assert tuple(cube.matrix_world.translation) == pytest.approx((0, 2, 1.1), abs=1e-5)


def test_rotation_scale_and_origin(scene):
    cube = add_cube(scene)
    options = {"kind": "OBJECT", "object_name": "Chair", "location": (0.5, 0, 0)}
    place(turn=math.radians(30), scale=2.0, drop=False, **options)
    assert tuple(cube.matrix_world.translation) == pytest.approx((0.5, 0, 0), abs=1e-6)
    assert cube.matrix_world.to_euler().z == pytest.approx(math.radians(30), abs=1e-5)
    assert tuple(cube.matrix_world.to_scale()) == pytest.approx((2, 2, 2), abs=1e-5)
    place(turn=0.0, scale=2.0, drop=True, **options)  # relative to the original size
    assert tuple(cube.matrix_world.to_scale()) == pytest.approx((2, 2, 2), abs=1e-5)
    assert lowest(cube) == pytest.approx(0.0, abs=1e-5)


def test_a_rotated_object_keeps_its_rotation_and_children(scene):
    cube = add_cube(scene)
    cube.rotation_euler = Euler((math.pi / 2, 0, 0))
    child = add_cube(scene, "Leg", 0.1, (1.0, 0.5, 2.7))
    bpy.context.view_layer.update()
    child.parent = cube
    child.matrix_parent_inverse = cube.matrix_world.inverted()
    bpy.context.view_layer.update()
    place(kind="OBJECT", object_name="Chair", location=(0, 0, 0))
    bpy.context.view_layer.update()
    assert lowest(cube, child) == pytest.approx(0.0, abs=1e-5) and lowest(cube) > 0.1
    assert cube.matrix_world.to_euler().x == pytest.approx(math.pi / 2, abs=1e-5)


def test_a_copy_does_not_move_the_original(scene):
    cube = add_cube(scene)
    before = cube.matrix_world.copy()
    place(kind="OBJECT", object_name="Chair", copy=True, location=(0, 0, 0))
    copy = bpy.data.objects["Chair.001"]
    assert copy.data == cube.data and cube.matrix_world == before
    assert [each.name for each in copy.users_collection] == ["Inserted"]
    place(kind="OBJECT", object_name="Floor", copy=True, location=(0, 0, 0))  # a part of the room, too
    assert "Floor.001" in scene.objects and "fipt_inserted" not in bpy.data.objects["Floor"]


def test_an_object_of_another_scene_is_copied(scene):
    mesh = bpy.data.meshes.new("asset")
    mesh.from_pydata([(0, 0, 1), (1, 0, 1), (0, 1, 2)], [], [(0, 1, 2)])
    asset = bpy.data.objects.new("Asset", mesh)
    place(kind="OBJECT", object_name="Asset", location=(0, 0, 0))
    assert "Asset" not in scene.objects and lowest(scene.objects["Asset.001"]) == pytest.approx(0.0, abs=1e-6)
    assert asset.matrix_world == Matrix()


def test_a_collection_is_placed_as_an_instance(scene):
    cube = add_cube(scene, location=(0, 0, 5))
    group = bpy.data.collections.new("Set")
    group.objects.link(cube)
    scene.collection.objects.unlink(cube)
    assert place(kind="COLLECTION", collection_name="Set", location=(0, 0, 0)) == {"FINISHED"}
    item = scene.objects["Set"]
    assert item.instance_collection == group
    assert item.matrix_world.translation.z == pytest.approx(-4.9, abs=1e-5)  # its lowest point is at 4.9


def test_without_a_location_a_free_spot_is_found(scene):
    assert place(kind="BALLS") == {"FINISHED"}
    root = scene.objects["FIPT balls"]
    balls = list(root.children)
    assert len(balls) == 2 and lowest(*balls) == pytest.approx(0.0, abs=1e-4)
    bpy.context.view_layer.update()
    across = balls[0].matrix_world.translation - balls[1].matrix_world.translation
    assert abs(across.x) > 0.1 and abs(across.y) < 1e-5  # side by side as the camera sees them
    diagonal = math.hypot(4.0, 4.0, 2.5)
    assert sample_objects.ball_size(scene.fipt.capture.room_objects(scene)) == pytest.approx(0.03 * diagonal)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kind": "OBJECT"}, "No object is selected"),
        ({"kind": "OBJECT", "object_name": "nothing"}, "no object 'nothing'"),
        ({"kind": "COLLECTION", "collection_name": "nothing"}, "no collection 'nothing'"),
        ({"kind": "OBJECT", "object_name": "Floor", "location": (0, 0, 0)}, "part of the room"),
        ({"kind": "GREY_BALL", "view": "val/999"}, "no camera for the view"),
        ({"kind": "GREY_BALL", "view": VIEW, "pixel": (-4000.0, -4000.0)}, "no surface"),
        ({"kind": "GREY_BALL", "location": (0, 0, 0), "normal": (0, 0, 0)}, "no length"),
    ],
)
def test_impossible_placements_are_explained_and_leave_nothing(scene, options, words):
    before = {item.name for item in bpy.data.objects}
    with pytest.raises(RuntimeError, match=words):
        place(**options)
    assert {item.name for item in bpy.data.objects} == before and not marks.inserted_objects(scene)


def test_the_collection_of_inserted_objects_cannot_be_placed(scene):
    place(kind="GREY_BALL", location=(0, 0, 0))
    with pytest.raises(RuntimeError, match="contains the inserted objects"):
        place(kind="COLLECTION", collection_name="Inserted", location=(1, 0, 0))


def test_removing_restores_everything(scene):
    cube = add_cube(scene)
    before = cube.matrix_world.copy()
    meshes, materials = len(bpy.data.meshes), len(bpy.data.materials)
    for kind in ("GREY_BALL", "BALLS", "MIRROR_BALL"):
        place(kind=kind, location=(0, 0, 0))
    place(kind="OBJECT", object_name="Chair", location=(0, 1, 0))
    place(kind="OBJECT", object_name="Chair", location=(1, 1, 0))
    place(kind="OBJECT", object_name="Chair", copy=True, location=(1, 1, 0))
    assert bpy.ops.fipt.remove_inserted() == {"FINISHED"}
    assert cube.matrix_world == before and "fipt_inserted_from" not in cube
    assert (len(bpy.data.meshes), len(bpy.data.materials)) == (meshes, materials)
    assert not list(bpy.data.collections["Inserted"].objects)
    assert bpy.ops.fipt.remove_inserted() == {"CANCELLED"}


def test_cancelling_leaves_no_trace(scene):
    cube = add_cube(scene)
    names = sorted(item.name for item in bpy.data.objects)
    before = cube.matrix_world.copy()
    surface = surfaces.Surface(Vector((0, 0, 0)), Vector((0, 0, 1)))
    for placement in (
        placing.begin_placing(scene, cube),
        placing.begin_placing(scene, cube, copy=True),
        sample_objects.make_balls(scene, ("gray_ball", "mirror_ball"), 0.2),
    ):
        placing.place(placement, surface, placing.Stance(scale=3.0))
        placing.cancel_placing(placement)
    assert sorted(item.name for item in bpy.data.objects) == names
    assert np.allclose(cube.matrix_world, before) and not marks.inserted_objects(scene)


def test_cancelling_a_second_placement_keeps_the_first(scene):
    add_cube(scene)
    place(kind="OBJECT", object_name="Chair", location=(0, 0, 0))
    cube = bpy.data.objects["Chair"]
    first = cube.matrix_world.copy()
    placement = placing.begin_placing(scene, cube)
    placing.place(placement, surfaces.Surface(Vector((1, 1, 1)), Vector((1, 0, 0))), placing.Stance())
    placing.cancel_placing(placement)
    assert np.allclose(cube.matrix_world, first) and marks.inserted_objects(scene) == [cube]
