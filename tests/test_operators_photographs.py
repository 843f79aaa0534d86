"""Photographs over the room: they hide results only where the artist wants to see them."""

from __future__ import annotations

import bpy
import pytest

from fipt_blender.blend.marks import VIEW

ops = bpy.ops.fipt


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def photographs(scene) -> list[bpy.types.Camera]:
    """Two views of the capture, each with its photograph over the room."""
    found = []
    for name in ("a", "b"):
        data = bpy.data.cameras.new(name)
        item = bpy.data.objects.new(name, data)
        scene.collection.objects.link(item)
        item[VIEW] = name
        data.background_images.new().image = bpy.data.images.new(name, 4, 4)
        view = scene.fipt.capture.views.add()
        view.name = view.camera = name
        found.append(data)
    ops.look_through(view="b")
    ops.look_through(view="a")
    return found


def test_photographs_cover_results_only_where_the_artist_switches_them_on(scene, photographs):
    def covering() -> list[bool]:
        return [data.show_background_images for data in photographs]

    capture = scene.fipt.capture
    assert covering() == [True, True]
    assert ops.apply_results("EXEC_DEFAULT") == {"FINISHED"}
    assert covering() == [False, False]
    ops.look_through(view="a")
    assert covering() == [False, False], "the results are what one looks at"
    scene.fipt.materials.shown = "ORIGINAL"
    assert covering() == [True, True]
    scene.fipt.materials.shown = "ROUGHNESS"
    assert covering() == [False, False]
    capture.photograph_over_results = True
    assert covering() == [True, False]
    ops.look_through(view="b")
    assert covering() == [True, True]
    capture.photograph_over_results = False
    scene.fipt.materials.shown = "METALLIC"
    assert covering() == [False, False]
    scene.fipt.materials.shown = "ESTIMATED"
    ops.set_backdrop(mode="PHOTOGRAPH")  # behind the room it hides nothing
    scene.fipt.materials.shown = "ROUGHNESS"
    assert covering() == [True, True]
    ops.set_backdrop(mode="ROOM")
    assert covering() == [False, False]
    ops.revert()
    assert covering() == [True, True]
