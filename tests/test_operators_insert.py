"""Balls that show the room's light: where they stand, how large they are."""

from __future__ import annotations

import math

import bpy
import pytest

from samples.rendered_rooms import make_scene

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene(tmp_path):
    make_scene(tmp_path)
    return bpy.context.scene


@pytest.mark.parametrize("kind", ["GRAY_BALL", "MIRROR_BALL"])
def test_a_ball_stands_on_the_cursor_and_suits_the_room(scene, kind):
    scene.cursor.location = (0.5, -0.25, 1.0)
    assert bpy.ops.fipt.add_ball(kind=kind) == {"FINISHED"}
    ball = bpy.context.view_layer.objects.active
    bpy.context.view_layer.update()
    corners = [ball.matrix_world @ vertex.co for vertex in ball.data.vertices]
    assert min(point.z for point in corners) == pytest.approx(1.0, abs=1e-5)
    assert tuple(ball.matrix_world.translation) == pytest.approx((0.5, -0.25, 1.0))
    diagonal = math.hypot(4.0, 4.0, 2.5)
    assert tuple(ball.dimensions) == pytest.approx([0.03 * diagonal] * 3, rel=0.01)
    assert ball.select_get() and [each.name for each in ball.users_collection] == ["Inserted"]


def test_the_diameter_can_be_chosen_and_balls_of_a_kind_share_a_material(scene):
    bpy.ops.fipt.add_ball(kind="GRAY_BALL", size=0.5)
    first = bpy.context.view_layer.objects.active
    bpy.ops.fipt.add_ball(kind="GRAY_BALL")
    second = bpy.context.view_layer.objects.active
    assert first.dimensions.z == pytest.approx(0.5) and second.dimensions.z < 0.3
    assert first.active_material == second.active_material
