"""Captures imported and exported: exact cameras, also with a moved alignment; ticks, splits, chosen rooms."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender import machine
from fipt_blender.blend.capture import cameras, importing
from fipt_blender.blend.capture.exporting import export_capture
from fipt_blender.core import conventions
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import run_job, runstate
from fipt_blender.panels import start
from samples.at_once import at_once
from samples.camera_views import points_before, projections, random_views
from samples.layouts import drawn_by
from samples.refusals import error_of

ALIGNED = Matrix.LocRotScale((1.5, -2.0, 0.3), Euler((0.2, -0.1, 1.1)), (0.4,) * 3)


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene():
    return bpy.context.scene


@pytest.fixture
def ingested(tmp_path, scene):
    """A run folder whose capture is not yet imported."""
    folder = RunFolder(tmp_path / "run")
    folder.create(make_settings())
    views = random_views()
    mesh = tmp_path / "scene.obj"
    mesh.write_text("o room\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    world = conventions.world_from_source("y", 2.0)
    data = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": str(mesh), "views": views}
    write_json(folder.ingest_json, {**data, "world_from_source": world.tolist()})
    scene.fipt.run_folder = str(folder.root)
    return folder


def bring_in(run: RunFolder, path: str = "somewhere") -> list:
    return at_once(importing.import_capture)(run, path)


@pytest.fixture
def run(ingested):
    """A run folder with its imported capture."""
    bring_in(ingested)
    return ingested


def entries(run: RunFolder) -> dict[str, dict]:
    return {entry["name"]: entry for entry in read_document(run.capture_json, dict)["views"]}


def test_unmoved_cameras_keep_their_poses_to_the_bit(run, scene):
    scene.fipt.capture.views[0].camera_object().name = "Hero"
    assert scene.fipt.capture.views[0].camera_object().name == "Hero" and export_capture(scene, run) == 5
    before = {entry["name"]: entry for entry in read_document(run.ingest_json, dict)["views"]}
    assert entries(run) == before
    bpy.context.view_layer.update()
    time = run.capture_json.stat().st_mtime_ns
    export_capture(scene, run)
    assert run.capture_json.stat().st_mtime_ns == time  # nothing changed, so that a run can resume
    run.ingest_json.unlink()
    assert error_of(export_capture, scene, run).code == "capture-missing"


def test_blender_renders_what_the_pinhole_sees(run, scene):
    for view in read_document(run.ingest_json, dict)["views"]:
        width, height = view["width"], view["height"]
        camera = cameras.find_camera(view["name"], scene)
        cameras.use_view(scene, camera)
        bpy.context.view_layer.update()
        render = scene.render
        assert (render.resolution_x, render.resolution_y) == (width, height)
        lens = camera.calc_matrix_camera(
            bpy.context.evaluated_depsgraph_get(), x=width, y=height,
            scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y,
        )  # fmt: skip
        matrix = np.array(lens, np.float64) @ np.linalg.inv(np.array(camera.matrix_world, np.float64))
        points = points_before(view)
        clip = np.column_stack([points, np.ones(len(points))]) @ matrix.T
        found = (clip[:, :2] / clip[:, 3:] * [0.5, -0.5] + 0.5) * [width, height]
        # Blender keeps single precision: 1e-4 pixels is two parts in a million of the width.
        assert clip[:, 3].min() > 0.0 and np.abs(found - projections(view, points)).max() < 1e-4


@pytest.mark.parametrize("evaluated", [True, False])
def test_round_trip_with_a_moved_rotated_and_scaled_alignment(run, scene, evaluated):
    """Moving the room with its cameras does not change what a view shows at a pixel."""
    settings = scene.fipt.capture
    settings.alignment.matrix_basis = ALIGNED
    if evaluated:
        bpy.context.view_layer.update()
    else:  # Blender does not evaluate hidden collections
        scene.view_layers[0].layer_collection.children["Room"].children["Photographs"].hide_viewport = True
    export_capture(scene, run)
    move = np.array(ALIGNED, np.float64)
    for before in read_document(run.ingest_json, dict)["views"]:
        after = entries(run)[before["name"]]
        points = points_before(before)
        expected = projections(before, points)
        found = projections(after, points @ move[:3, :3].T + move[:3, 3])
        assert np.abs(found - expected).max() < 1e-4
        turn = np.array(after["camera_to_world"])[:3, :3]
        assert np.abs(turn.T @ turn - np.eye(3)).max() < 1e-12


def test_the_mesh_follows_the_alignment_and_the_capture_s_axes(run, scene):
    (room,) = scene.fipt.capture.room_objects(scene)
    scene.fipt.capture.alignment.matrix_basis = ALIGNED
    bpy.context.view_layer.update()
    world = np.array([room.matrix_world @ vertex.co for vertex in room.data.vertices])
    source = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
    expected = conventions.transform_points(np.array(ALIGNED) @ conventions.world_from_source("y", 2.0), source)
    assert np.abs(np.sort(world, axis=0) - np.sort(expected, axis=0)).max() < 1e-5


def test_a_camera_moved_by_hand_is_exported(run, scene):
    camera = scene.fipt.capture.views[1].camera_object()
    camera.location.x += 0.25
    export_capture(scene, run)
    before = np.array(read_document(run.ingest_json, dict)["views"][1]["camera_to_world"])
    after = np.array(entries(run)["train/off-centre"]["camera_to_world"])
    assert (after - before)[0, 3] == pytest.approx(0.25, abs=1e-6)
    assert camera.name in scene.objects and np.allclose(after[:3, :3], before[:3, :3], atol=1e-6)


def test_an_uneven_alignment_is_refused(run, scene):
    for scale in ((1, 1, 2), (-1, 1, 1), (0, 0, 0)):
        scene.fipt.capture.alignment.scale = scale
        assert error_of(export_capture, scene, run).code == "alignment-uneven"
        assert not run.capture_json.exists()


def test_ticks_splits_and_deleted_cameras(run, scene):
    settings = scene.fipt.capture
    assert (settings.train_count, settings.held_back_count) == (4, 1)
    settings.views["train/portrait"].enabled = False
    settings.views["train/plain"].split = "train"
    settings.views["train/fx > fy"].split = "held_back"
    assert (settings.train_count, settings.held_back_count) == (3, 1)
    bpy.data.objects.remove(settings.views["train/fx < fy"].camera_object())
    assert export_capture(scene, run) == 3
    splits = {name: entry["split"] for name, entry in entries(run).items()}
    assert splits == {"train/plain": "train", "train/off-centre": "train", "train/fx > fy": "held_back"}
    settings.views["train/portrait"].enabled = True  # leaving it out lost nothing
    assert export_capture(scene, run) == 4
    settings.views["train/plain"].enabled = settings.views["train/off-centre"].enabled = False
    before = run.capture_json.read_bytes()
    error = error_of(export_capture, scene, run)
    assert error.code == "views-few" and run.capture_json.read_bytes() == before
    assert error.text.startswith("Only 1 of 5 views") and "those of 1 were deleted" in error.text


def test_importing_again_keeps_ticks_and_alignment_and_adds_nothing(run, scene):
    settings = scene.fipt.capture
    settings.views[2].enabled = False
    settings.alignment.location.x = 3.0
    count = len(bpy.data.objects)
    bring_in(run)
    assert len(bpy.data.objects) == count and not settings.views[2].enabled
    assert settings.alignment.location.x == 3.0


def test_another_capture_removes_the_cameras_and_hides_the_mesh_of_the_first(run, scene, tmp_path):
    (old,) = scene.fipt.capture.room_objects(scene)
    own = bpy.data.objects.new("Artist's", bpy.data.cameras.new("Artist's"))
    scene.collection.objects.link(own)
    data = read_document(run.ingest_json, dict)
    other = tmp_path / "other.obj"
    other.write_text(Path(data["mesh"]).read_text())
    data["views"] = [{**view, "name": f"b/{index}"} for index, view in enumerate(data["views"][:3])]
    write_json(run.ingest_json, {**data, "mesh": str(other)})
    bring_in(run, "elsewhere")
    names = sorted(item.name for item in scene.objects if item.type == "CAMERA")
    assert names == ["Artist's", "b/0", "b/1", "b/2"] and len(scene.fipt.capture.views) == 3
    (new,) = scene.fipt.capture.room_objects(scene)
    assert new != old and [each.name for each in old.users_collection] == ["Earlier Rooms"]
    assert old.users_collection[0].hide_viewport and old.users_collection[0].hide_render


def test_chosen_objects_stay_the_room_and_are_not_changed(ingested, scene):
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    before = (cube.parent, cube.matrix_basis.copy(), [each.name for each in cube.users_collection])
    importing.set_room(scene, [cube])
    warnings = bring_in(ingested)
    assert [message["code"] for message in warnings] == ["mesh-kept"]
    assert scene.fipt.capture.room_objects(scene) == [cube]
    assert (cube.parent, cube.matrix_basis) == before[:2]
    assert {each.name for each in cube.users_collection} == {*before[2], "Parts"}
    plane = bpy.data.objects.new("plane", cube.data)
    scene.collection.objects.link(plane)
    importing.set_room(scene, [plane])
    assert scene.fipt.capture.room_objects(scene) == [plane]
    assert cube.name in scene.objects  # only unlinked from the collection


def test_start_up_objects_are_hidden_and_shown_again(ingested, scene):
    bpy.ops.mesh.primitive_cube_add()
    light, camera = bpy.data.lights.new("Light", "POINT"), bpy.data.cameras.new("Camera")
    for data, place in ((light, (4.076, 1.005, 5.904)), (camera, (7.359, -6.926, 4.958))):
        item = bpy.data.objects.new(data.name, data)
        item.location = place
        scene.collection.objects.link(item)
    names = ("Cube", "Light", "Camera")
    assert bring_in(ingested) == []
    assert all(scene.objects[name].hide_render and scene.objects[name].hide_viewport for name in names)
    bpy.ops.fipt.hide_startup_objects(hide=False)
    assert not any(scene.objects[name].hide_render for name in names)
    scene.objects["Light"].location.z += 0.1  # the artist's from now on
    bpy.ops.fipt.hide_startup_objects()
    assert [scene.objects[name].hide_render for name in names] == [True, False, True]


def test_start_offers_a_run_that_no_file_knows(ingested, scene, tmp_path, monkeypatch):
    """As after a crash; until a file that uses it is saved."""
    monkeypatch.setattr(machine, "data_folder", lambda: tmp_path)
    monkeypatch.setattr(machine, "has_engine", lambda: True)
    monkeypatch.setattr(run_job, "find_launch", lambda: run_job.Launch(Path(sys.executable), {}))
    run = RunFolder(tmp_path / "runs" / "kitchen-20260101-101112")
    run.root.parent.mkdir()
    ingested.root.rename(run.root)
    write_json(run.stages_json, {"keys": {"a": "", "b": ""}, "stages": {"a": {}}, "warnings": {}})
    scene.fipt.run_folder = ""
    assert runstate.unsaved_runs() == ()  # of the command line, or in a file
    run.unsaved.write_text(str(tmp_path / "kitchen"), encoding="utf-8")
    (offered,) = runstate.unsaved_runs()
    scene.fipt.run_folder = str(run.root)
    assert runstate.unsaved_runs() == ()
    scene.fipt.run_folder = ""
    assert (offered.name, offered.stages, offered.finished) == ("kitchen", 1, False)
    assert "fipt.open_run" in drawn_by(start.FIPT_PT_start)[0]
    assert bpy.ops.fipt.open_run(folder=str(run.root)) == {"FINISHED"}
    assert scene.fipt.run_folder == str(run.root) and scene.fipt.capture.imported_path == str(tmp_path / "kitchen")
    assert len(scene.fipt.capture.views) == 5 and scene.fipt.capture.room_objects(scene)
    assert bpy.ops.fipt.resume.poll()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"), copy=True)
    assert run.unsaved.exists()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"))
    assert not run.unsaved.exists()


def test_masks_of_a_folder(run, scene, tmp_path):
    parts, folder = scene.fipt.parts, tmp_path / "masks"
    parts.source = "folder"
    for problem in ("", str(folder)):
        parts.folder = problem
        error = error_of(export_capture, scene, run)
        assert error.code == "parts-folder"
    (folder / "train").mkdir(parents=True)
    assert "plain.png" in error_of(export_capture, scene, run).remedy
    (folder / "train" / "Plain.PNG").touch()
    (folder / "off-centre.exr.png").touch()
    export_capture(scene, run)
    found = {name: entry["parts"] for name, entry in entries(run).items()}
    assert found["train/plain"] == str(folder / "train" / "Plain.PNG")
    assert found["train/off-centre"] == str(folder / "off-centre.exr.png") and not found["train/portrait"]
    (folder / "val").mkdir()
    (folder / "val" / "portrait.png").touch()
    export_capture(scene, run)
    assert entries(run)["train/portrait"]["parts"] is None  # it is that of another view
    assert parts.engine_source == "masks"
    parts.source = "auto"
    export_capture(scene, run)
    assert not any(entry["parts"] for entry in entries(run).values())
