"""Other views' cameras are hidden while one is looked through, and are shown again as they were."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from fipt_blender.blend.capture import other_cameras
from fipt_blender.blend.capture.look import enter_camera, enter_room, stand_in_photograph, view_spaces
from fipt_blender.blend.marks import LOOKED_PAST, VIEW
from samples.rendered_rooms import make_scene

OTHER, HELD_BACK = "train/000", "val/000"


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bpy.types.Scene:
    """A room with four views, of which the artist has hidden one and selected another."""
    make_scene(tmp_path)
    scene = bpy.context.scene
    alignment = bpy.data.objects.new("alignment", None)
    scene.collection.objects.link(alignment)
    for name in ("selected", "hidden"):
        camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
        camera[VIEW], camera.parent = name, alignment
        scene.collection.objects.link(camera)
    bpy.data.objects["selected"].select_set(True)
    bpy.data.objects["hidden"].hide_set(True)
    # Without a window neither do timers run, nor does anything look through a camera unasked.
    monkeypatch.setattr(other_cameras, "watch", lambda scene: other_cameras.hidden_for.setdefault(scene.name, ""))
    yield scene
    other_cameras.hidden_for.clear()


def hidden() -> set[str]:
    return {item.name for item in bpy.context.scene.objects if item.type == "CAMERA" and item.hide_get()}


def orbit() -> None:
    """Leave the camera in all 3D views, as the artist does with the middle mouse button."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.spaces.active.region_3d.view_perspective = "PERSP"


def look(name: str) -> None:
    scene = bpy.context.scene
    scene.camera = bpy.data.objects[name]
    enter_camera(bpy.context, scene)
    other_cameras.watch(scene)
    assert other_cameras.tick() is not None


def test_other_cameras_are_hidden_while_one_looks_through_a_view(scene):
    look(HELD_BACK)
    assert hidden() == {OTHER, "selected", "hidden"}
    look(OTHER)
    assert hidden() == {HELD_BACK, "selected", "hidden"}
    orbit()
    assert other_cameras.tick() is None
    assert hidden() == {"hidden"} and bpy.data.objects["selected"].select_get()
    assert not any(LOOKED_PAST in item for item in scene.objects)


def test_what_the_artist_shows_stays_shown(scene):
    own = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    scene.collection.objects.link(own)
    look(HELD_BACK)
    bpy.data.objects[OTHER].hide_set(False)
    other_cameras.tick()
    assert hidden() == {"selected", "hidden"}
    scene.camera = own
    other_cameras.tick()
    assert hidden() == {"hidden"}
    look(HELD_BACK)
    other_cameras.unregister()  # the add-on is removed
    assert hidden() == {"hidden"}
    other_cameras.register()


def test_files_are_saved_with_all_cameras_and_opened_without_the_others(scene, tmp_path):
    look(HELD_BACK)
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    other_cameras.tick()
    assert hidden() == {OTHER, "selected", "hidden"}
    bpy.ops.wm.open_mainfile(filepath=path)
    assert hidden() == {"hidden"}  # as for a Blender without the add-on
    other_cameras.tick()  # the file looks through the view
    assert hidden() == {OTHER, "selected", "hidden"}


def test_undo_brings_the_cameras_back(scene):
    bpy.ops.ed.undo_push(message="before")
    look(HELD_BACK)
    bpy.ops.ed.undo_push(message="something else")
    bpy.ops.ed.undo()
    other_cameras.tick()
    assert hidden() == {OTHER, "selected", "hidden"}
    orbit()
    other_cameras.tick()
    bpy.ops.ed.redo()  # to the state with hidden cameras
    other_cameras.tick()
    assert hidden() == {"hidden"}


def test_the_room_is_entered_through_a_held_back_view_unless_the_artist_has_chosen_another(scene):
    views, (space, *_) = scene.fipt.capture.views, view_spaces(bpy.context, scene)
    space.shading.type, scene.render.engine = "SOLID", "CYCLES"
    views.move(list(views.keys()).index(OTHER), 0)
    stand_in_photograph(scene, bpy.context)
    assert scene.camera.name == OTHER
    enter_room(bpy.context, scene)
    assert scene.camera.name == HELD_BACK and space.shading.type == "RENDERED"
    space.shading.type = "WIREFRAME"  # now the artist's
    views.move(list(views.keys()).index(HELD_BACK), 0)
    look(OTHER)  # which is not the first view now
    enter_room(bpy.context, scene)
    assert scene.camera.name == OTHER
    orbit()
    enter_room(bpy.context, scene)
    assert scene.camera.name == HELD_BACK and space.shading.type == "WIREFRAME"
