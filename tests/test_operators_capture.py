"""The buttons of the sections Capture and Parts as scripts press them: import, check, colours; bad inputs."""

from __future__ import annotations

import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from fipt_blender import api, machine
from fipt_blender.blend.capture import overlay
from fipt_blender.blend.capture.importing import find_alignment
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.conventions import UP_AXES, world_from_source
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs import running
from fipt_blender.panels.capture import draw_import
from samples import box_room
from samples.capture_files import make_samples, write_colmap, write_mesh, write_transforms
from samples.engine_here import engine_here
from samples.layouts import Layout

ops = bpy.ops.fipt
CORNERS = [Vector(corner) for corner in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))]

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(tmp_path / "data"))
    monkeypatch.setattr(machine.DEFAULTS, "device", "llvm")
    return bpy.context.scene


@pytest.fixture(scope="module")
def sample(tmp_path_factory) -> Path:
    """Ten views, and a mesh around them."""
    root = tmp_path_factory.mktemp("capture") / "kitchen"
    write_transforms(root, make_samples(10))
    corners = [(x, y, z) for x in (-3, 3) for y in (-3, 3) for z in (-3, 3)]
    faces = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]
    lines = ["v {} {} {}".format(*corner) for corner in corners]
    for index, face in enumerate(faces):
        lines += [f"usemtl side{index}", "f {} {} {} {}".format(*face)]
    (root / "scene.obj").write_text("\n".join(lines) + "\n")
    return root


def refused(operator, **arguments) -> str:
    """The words with which an operator refuses; nothing was added to the file."""
    before = sorted(item.name for item in bpy.data.objects)
    with pytest.raises(RuntimeError) as error:
        operator(**arguments)
    assert sorted(item.name for item in bpy.data.objects) == before
    return str(error.value)


@pytest.fixture
def here():
    with engine_here():
        yield


@pytest.fixture
def imported(here, scene, sample):
    assert ops.import_capture(filepath=str(sample)) == {"FINISHED"}
    return scene


def test_import_makes_a_run_and_everything_the_artist_sees(imported, sample, tmp_path):
    settings = imported.fipt.capture
    folder = Path(imported.fipt.run_folder)
    assert folder.parent == tmp_path / "data" / "runs" and folder.name.startswith("kitchen")
    assert (settings.train_count, settings.held_back_count, len(settings.views)) == (9, 1, 10)
    assert len(settings.room_objects(imported)) == 1
    assert all(view.camera_object().parent == settings.alignment for view in settings.views)
    image = settings.views[0].camera_object().data.background_images[0].image
    assert Path(image.filepath) == sample / "images" / "000_0001.exr"
    assert imported.camera is None  # nothing is looked through unasked
    running_job = running.last("capture")
    assert running_job.state == "finished" and running.current() is None


def test_fix_imports_again_with_the_correction_that_the_panel_offers(here, scene, tmp_path):
    samples = box_room.make_samples()
    wrong = [replace(each, pose=each.pose @ np.diag([1.0, -1.0, -1.0, 1.0])) for each in samples]
    write_transforms(tmp_path / "wrong", wrong)
    box_room.write_photographs(tmp_path / "wrong" / "images", samples)
    box_room.write_mesh(tmp_path / "wrong" / "scene.obj")
    assert "OpenCV" in refused(ops.import_capture, filepath=str(tmp_path / "wrong"))
    error = running.last("capture").error
    assert error["fix"] == "axes-opencv"
    layout = Layout()
    draw_import(layout, bpy.context)
    assert "fipt.fix_capture" in layout.drawn
    assert ops.fix_capture(correct=error["fix"]) == {"FINISHED"}
    settings = scene.fipt.capture
    place = settings.views[0].camera_object().matrix_world.translation
    np.testing.assert_allclose(place, samples[0].pose[:3, 3], atol=1e-5)
    settings.path = str(tmp_path / "other")  # which need not have that mistake
    assert settings.correct == ""


def test_import_again_and_of_another_capture(imported, sample, tmp_path):
    first = imported.fipt.run_folder
    assert api.import_capture(sample, options={"scale": 0.5}).run == Path(first)
    places = np.array([view.camera_object().location for view in imported.fipt.capture.views])
    assert np.abs(places).max() < 1.01
    imported.fipt.capture.up = "-x"
    other = tmp_path / "other"
    write_colmap(other, make_samples(3, model="OPENCV"), text=True)
    write_mesh(other / "scene.obj")
    assert ops.import_capture(filepath=str(other / "sparse" / "0" / "images.txt")) == {"FINISHED"}
    # It is not turned by the choice for the last one.
    assert imported.fipt.capture.up == imported.fipt.capture.imported_up
    np.testing.assert_allclose(np.array(imported.fipt.capture.alignment.matrix_world), np.eye(4), atol=1e-6)
    assert imported.fipt.run_folder != first and (Path(first) / "capture.json").exists()
    assert len(imported.fipt.capture.views) == 3
    assert all(Path(view.image).is_relative_to(imported.fipt.run_folder) for view in imported.fipt.capture.views)


def test_bad_captures_are_refused_in_words_and_change_nothing(imported, sample, tmp_path):
    run, views = imported.fipt.run_folder, len(imported.fipt.capture.views)
    assert "does not exist" in refused(ops.import_capture, filepath=str(tmp_path / "nowhere"))
    (tmp_path / "empty").mkdir()
    assert "neither photographs nor cameras" in refused(ops.import_capture, filepath=str(tmp_path / "empty"))
    (tmp_path / "empty" / "IMG_1.JPG").touch()
    told = refused(ops.import_capture, filepath=str(tmp_path / "empty"))
    assert "photographs without cameras" in told and "Make Capture" in told
    broken = tmp_path / "broken"
    shutil.copytree(sample, broken)
    (broken / "images" / "003_0001.exr").unlink()
    assert "003_0001.exr" in refused(ops.import_capture, filepath=str(broken))
    settings = imported.fipt.capture
    settings.mesh = str(tmp_path / "gone.obj")
    assert "gone.obj" in refused(ops.import_capture, filepath=str(sample))
    settings.mesh = ""
    settings.images = str(tmp_path / "gone")
    assert "gone" in refused(ops.import_capture, filepath=str(sample))
    assert imported.fipt.run_folder == run and len(settings.views) == views
    assert [each.name for each in (tmp_path / "data" / "runs").iterdir()] == [Path(run).name]
    assert running.current() is None


def test_a_panorama_is_placed_at_the_cursor(imported, tmp_path):
    """Imported again, it adds six views where the cursor was."""
    settings = imported.fipt.capture
    write_exr(tmp_path / "middle.exr", np.ones((16, 32, 3), np.float32))
    settings.panorama, settings.panorama_heading = str(tmp_path / "middle.exr"), np.radians(90.0)
    imported.cursor.location = (0.5, -0.25, 1.5)
    assert ops.place_panorama() == {"FINISHED"} and ops.import_capture() == {"FINISHED"}
    faces = [view for view in settings.views if view.name.startswith("middle@")]
    assert len(faces) == 6 and len(settings.views) == 16
    front = next(view for view in faces if view.name == "middle@front").camera_object()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(front.matrix_world.translation, (0.5, -0.25, 1.5), atol=1e-6)
    np.testing.assert_allclose(front.matrix_world.to_3x3() @ Vector((0.0, 0.0, -1.0)), (-1.0, 0.0, 0.0), atol=1e-6)


def test_mesh_and_room(imported, sample, tmp_path):
    settings = imported.fipt.capture
    assert "does not exist" in refused(ops.import_mesh, filepath=str(tmp_path / "gone.obj"))
    (tmp_path / "text.xyz").touch()
    assert "xyz" in refused(ops.import_mesh, filepath=str(tmp_path / "text.xyz"))
    write_mesh(tmp_path / "other.obj")
    assert ops.import_mesh(filepath=str(tmp_path / "other.obj")) == {"FINISHED"}
    (item,) = settings.room_objects(imported)
    assert len(item.data.polygons) == 1 and item.parent == settings.alignment
    assert "No mesh objects are selected" in refused(ops.set_room)
    assert "no collection" in refused(ops.set_room, collection="Nothing")
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    assert ops.set_room() == {"FINISHED"} and settings.room_objects(imported) == [cube]
    mine = bpy.data.collections.new("Mine")
    imported.collection.children.link(mine)
    mine.objects.link(item)
    assert ops.set_room(collection="Mine") == {"FINISHED"} and settings.room_objects(imported) == [item]


def test_what_is_left_out_of_the_room_is_named(imported, capfd):
    """Collection instances and curves among the selected objects, and in a collection that is chosen."""
    chairs = bpy.data.collections.new("Chairs")
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.context.collection.objects.unlink(cube)
    chairs.objects.link(cube)
    for name in ("chair 1", "chair 2"):
        instance = bpy.data.objects.new(name, None)
        instance.instance_type, instance.instance_collection = "COLLECTION", chairs
        imported.collection.objects.link(instance)
        instance.select_set(True)
    assert "Make Instances Real" in refused(ops.set_room)
    bpy.ops.mesh.primitive_plane_add()
    curve = bpy.data.objects.new("lamp cable", bpy.data.curves.new("cable", "CURVE"))
    imported.collection.objects.link(curve)
    for name in ("chair 1", "chair 2", "lamp cable", "Plane"):
        bpy.data.objects[name].select_set(True)
    capfd.readouterr()
    assert ops.set_room() == {"FINISHED"}
    told = capfd.readouterr().out
    assert "2 collection instances ('chair 1', 'chair 2')" in told and "Make Instances Real" in told
    assert "'lamp cable'" in told and "Convert" in told
    furniture = bpy.data.collections.new("Furniture")
    imported.collection.children.link(furniture)
    for name in ("chair 1", "Plane"):
        furniture.objects.link(bpy.data.objects[name])
    capfd.readouterr()
    assert ops.set_room(collection="Furniture") == {"FINISHED"}
    assert "1 collection instance ('chair 1')" in capfd.readouterr().out
    assert ops.check_views() == {"FINISHED"}
    (warning,) = (w for w in running.last("survey").warnings if w["code"] == "instances-left-out")
    assert "'chair 1'" in warning["text"]


def test_looking_through_views_and_ticking_them(imported):
    settings = imported.fipt.capture
    assert ops.look_through(view="images/003_0001") == {"FINISHED"}
    assert settings.active_view == 3 and imported.camera == settings.views[3].camera_object()
    assert (imported.render.resolution_x, imported.render.resolution_y) == (32, 48)
    ops.look_through(step=1)
    assert settings.active_view == 4 and imported.camera.name == settings.views[4].camera
    settings.active_view = 9  # a click in the list
    assert imported.camera.name == settings.views[9].camera
    ops.look_through(step=1)
    assert settings.active_view == 0
    settings.photograph_opacity = 0.0
    assert not imported.camera.data.show_background_images
    assert "no view" in refused(ops.look_through, view="nothing")
    bpy.data.objects.remove(settings.views[0].camera_object())
    assert "was deleted" in refused(ops.look_through)
    for action, count in (("NONE", 0), ("INVERT", 9), ("NONE", 0), ("ALL", 9)):
        ops.tick_views(action=action)
        assert settings.train_count + settings.held_back_count == count
    settings.views[2].warning = "bad"
    ops.tick_views(action="GOOD")
    assert [view.enabled for view in settings.views].count(False) == 1 and settings.warning_count == 0


def test_undo_takes_an_import_back_and_redo_brings_it_again(scene, sample):
    bpy.ops.ed.undo_push(message="before")
    assert ops.import_capture(filepath=str(sample)) == {"FINISHED"}
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert not scene.fipt.capture.views and not bpy.data.objects and scene.fipt.capture.alignment is None
    bpy.ops.ed.redo()
    scene = bpy.context.scene
    settings = scene.fipt.capture
    assert len(settings.views) == 10 and len(settings.room_objects(scene)) == 1
    assert all(view.camera_object() is not None for view in settings.views)
    assert settings.alignment.name in scene.objects


@pytest.fixture
def drawn(monkeypatch) -> list[list[overlay.Part]]:
    """The coloured triangles given to the overlay, in the order in which they were."""
    calls = []

    def show(scene, kind, parts, show=overlay.show):
        calls.append(parts)
        show(scene, kind, parts)

    monkeypatch.setattr(overlay, "show", show)
    return calls


def test_check_fills_the_list_and_colours_follow_the_ticks(imported, sample, drawn):
    settings, parts = imported.fipt.capture, imported.fipt.parts
    (sample / "images" / "002_0001.exr").rename(sample / "images" / "aside")
    settings.views[5].enabled = False
    bpy.data.objects.remove(settings.views[6].camera_object())
    try:
        assert ops.check_views() == {"FINISHED"}
    finally:
        (sample / "images" / "aside").rename(sample / "images" / "002_0001.exr")
    warnings = [view.warning for view in settings.views]
    assert settings.views[2].image_missing and "missing" in warnings[2] and "deleted" in warnings[6]
    assert settings.views[0].checked and settings.views[0].room_share == 1.0 and settings.views[5].checked
    assert settings.warning_count == 1 and settings.train_count + settings.held_back_count == 8
    assert settings.unseen_share == pytest.approx(1 / 3)  # level cameras see no floor and no ceiling
    assert parts.auto_source == "materials"
    assert json.loads(parts.counts) == {"materials": 6, "loose": 1}
    run = RunFolder(imported.fipt.run_folder)
    splits = [view["split"] for view in read_document(run.survey / "capture.json", dict)["views"]]
    assert splits.count("unused") == 1 and len(splits) == 9

    assert ops.show_coverage() == {"FINISHED"} and overlay.shown(imported) == "coverage"
    (part,) = drawn[-1]
    greens = part.colors.copy()
    assert len(part.positions) == 36
    ops.tick_views(action="NONE")
    assert settings.unseen_share == 1.0
    (part,) = drawn[-1]
    assert (part.colors[:, 0] > part.colors[:, 1]).all() and not np.array_equal(part.colors, greens)
    assert ops.show_parts() == {"FINISHED"} and overlay.shown(imported) == "parts"
    assert len(np.unique(drawn[-1][0].colors.round(3), axis=0)) >= 6
    parts.source = "objects"
    assert "a single object" in refused(ops.show_parts)
    parts.source = "loose"
    assert ops.show_parts() == {"FINISHED"}
    parts.source, parts.folder = "folder", str(sample)
    assert "Check the views again" in refused(ops.show_parts)
    other = bpy.data.scenes.new("other")
    assert overlay.shown(other) == ""  # the colours belong to one scene
    assert ops.show_parts(show=False) == {"FINISHED"} and overlay.shown(imported) == ""


def test_own_cameras_become_the_capture(here, scene, sample, tmp_path):
    collection = bpy.data.collections.new("Matchmove")
    scene.collection.children.link(collection)
    scene.render.resolution_x, scene.render.resolution_y = 160, 90  # not the shape of the photographs
    for number in (0, 2, 4):
        item = bpy.data.objects.new(f"Shot.{number:03d}", bpy.data.cameras.new("Shot"))
        collection.objects.link(item)
        item.location, item.rotation_euler = (0.1 * number, 0.0, 1.0), (1.5, 0.0, number)
        image = bpy.data.images.load(str(sample / "images" / f"{number:03d}_0001.exr"))
        item.data.background_images.new().image = image
    bare = bpy.data.objects.new("Bare", bpy.data.cameras.new("Bare"))
    collection.objects.link(bare)
    scene.fipt.capture.hold_back = 0
    before = {item.name: item.matrix_basis.copy() for item in collection.objects}
    assert ops.use_scene_cameras() == {"FINISHED"}
    imported = RunFolder(scene.fipt.run_folder).ingest_json.read_bytes()
    settings = scene.fipt.capture
    assert [view.camera for view in settings.views] == ["Shot.000", "Shot.002", "Shot.004"]
    assert "Bare" in running.last("capture").warnings[0]["text"]
    assert {item.name: item.matrix_basis for item in collection.objects} == before
    assert len(bpy.data.cameras) == 4
    ops.look_through(view=settings.views[1].name)
    assert scene.camera.name == "Shot.002" and scene.render.resolution_x == 48
    first = scene.fipt.run_folder
    assert ops.use_scene_cameras() == {"FINISHED"} and scene.fipt.run_folder == first
    assert RunFolder(first).ingest_json.read_bytes() == imported
    bpy.data.images[0].filepath = str(tmp_path / "photo.jpg")
    assert "not a file on disk" in refused(ops.use_scene_cameras)
    assert len(settings.views) == 3


def places(scene) -> np.ndarray:
    """Axes and places of the cameras and corners of the mesh in the world."""
    bpy.context.view_layer.update()
    settings = scene.fipt.capture
    cameras = [view.camera_object().matrix_world @ corner for view in settings.views for corner in CORNERS]
    (room,) = settings.room_objects(scene)
    return np.array([*cameras, *(room.matrix_world @ vertex.co for vertex in room.data.vertices)])


@pytest.mark.parametrize(("first", "axis"), [("auto", "y"), ("auto", "-z"), ("-y", "z"), ("x", "-x")])
def test_the_panel_turns_the_capture_as_another_import_does(here, scene, sample, first, axis):
    """Also when the artist has moved it; neither an import again nor one of another axis turns it twice."""
    settings = scene.fipt.capture
    assert api.import_capture(sample, options={"up_axis": first})
    assert settings.up == settings.imported_up == ("z" if first == "auto" else first)
    assert settings.up_source == ("format" if first == "auto" else "option")
    untouched = places(scene)
    moved = Matrix.Translation((1.0, 2.0, 0.5)) @ Matrix.Rotation(0.4, 4, "Z") @ Matrix.Scale(2.0, 4)
    settings.alignment.matrix_basis = moved
    settings.up = axis
    assert settings.up == axis
    turned = places(scene)
    assert api.import_capture(sample, options={"up_axis": first})
    assert settings.up == axis
    np.testing.assert_allclose(places(scene), turned, atol=1e-4)
    assert api.import_capture(sample, options={"up_axis": axis})
    assert settings.up == settings.imported_up == axis
    np.testing.assert_allclose(places(scene), turned, atol=1e-4)
    settings.alignment.matrix_basis = Matrix.Identity(4)
    assert api.import_capture(sample, options={"up_axis": first})
    np.testing.assert_allclose(places(scene), untouched, atol=1e-4)


def test_each_direction_can_be_chosen_and_taken_back(scene):
    settings = scene.fipt.capture
    moved = Matrix.LocRotScale((1.0, 2.0, 3.0), Euler((0.1, -0.2, 2.0)), (0.5, 0.5, 0.5))
    for imported_up, axis in itertools.product(UP_AXES, UP_AXES):
        find_alignment(scene).matrix_basis = moved
        settings.imported_up = imported_up
        assert settings.up == imported_up
        settings.up = axis
        assert settings.up == axis
        before = np.array(moved) @ world_from_source(axis)
        after = np.array(settings.alignment.matrix_basis) @ world_from_source(imported_up)
        np.testing.assert_allclose(after, before, atol=1e-5)
        settings.up = imported_up
        np.testing.assert_allclose(np.array(settings.alignment.matrix_basis), np.array(moved), atol=1e-5)
