"""The buttons for what a scan lacks, as scripts press them: find it, keep or delete it, draw a surface."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender import machine
from fipt_blender.blend.capture import overlay
from fipt_blender.blend.capture.additions import added_surfaces, take_found
from fipt_blender.blend.capture.survey import write_survey_input
from fipt_blender.blend.marks import ADDED, FOUND
from fipt_blender.blend.room.mesh_arrays import world_bounds
from fipt_blender.core import conventions
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.run_files import CLOSING
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs.scene_steps import export_scene_room
from samples.engine_here import engine_here
from samples.lost_things import HIGH, LOW, photographed, with_box
from samples.operator_calls import refused
from samples.scans import scanned_box

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(scope="module")
def sample(tmp_path_factory) -> Path:
    """A capture whose scan lacks a box, and some triangles of the ceiling."""
    root = tmp_path_factory.mktemp("capture") / "lacking"
    (root / "images").mkdir(parents=True)
    rng = np.random.default_rng(3)
    scan, _ = scanned_box(cells=30, noise=0.003)
    frames = [
        {
            "file_path": f"images/{view.name}.exr",
            "transform_matrix": conventions.opencv_to_opengl_camera(view.camera_to_world).tolist(),
            **{"w": view.width, "h": view.height, "fl_x": view.fx, "fl_y": view.fy},
            **{"cx": view.cx, "cy": view.cy},
        }
        for view in photographed(root / "images", with_box(scan), rng)
    ]
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))
    holes = rng.choice(np.flatnonzero(scan.normals[:, 2] < -0.9), 20, replace=False)
    kept = np.delete(scan.triangles, holes, axis=0) + 1
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*vertex) for vertex in scan.vertices]
    lines += ["f {} {} {}".format(*triangle) for triangle in kept]
    (root / "scene.obj").write_text("\n".join(lines) + "\n")
    return root


@pytest.fixture
def imported(tmp_path, monkeypatch, sample):
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(tmp_path / "data"))
    monkeypatch.setattr(machine.DEFAULTS, "device", "llvm")
    scene = bpy.context.scene
    settings = scene.fipt.capture
    settings.up_axis, settings.hold_back = "z", 0
    scene.fipt.estimate.force = True  # of so few small views the poses can't be checked
    with engine_here():
        assert ops.import_capture(filepath=str(sample)) == {"FINISHED"}
    return scene


def exported(scene: bpy.types.Scene) -> tuple[dict, dict[str, np.ndarray]]:
    """room.json and room.npz as an estimation gets them."""
    run = RunFolder(scene.fipt.run_folder)
    for _ in export_scene_room(run):
        pass
    with np.load(run.room_npz) as arrays:
        return read_document(run.room_json, dict), dict(arrays)


def bounds(item: bpy.types.Object) -> np.ndarray:
    return np.array(world_bounds([item]))


def test_what_is_found_is_shown_and_what_is_deleted_stays_away(imported):
    settings = imported.fipt.capture
    assert "No surfaces were added" in refused(ops.select_added)
    assert exported(imported)[0].get("completed") is None
    settings.alignment.location = (5.0, 0.0, 0.0)  # cameras and mesh
    settings.alignment.rotation_euler = (0.0, 0.0, 0.5 * np.pi)
    bpy.context.view_layer.update()
    run = RunFolder(imported.fipt.run_folder)
    settings_before = run.run_json.read_bytes()
    imported.fipt.estimate.preset = "high"
    with engine_here():
        assert ops.find_missing_surfaces() == {"FINISHED"}
    assert run.run_json.read_bytes() == settings_before, "they are those of the last estimate"
    closing, box = sorted(added_surfaces(imported), key=lambda item: item.name, reverse=True)
    assert (closing.name, box[ADDED]) == (CLOSING, FOUND) and settings.completed
    bpy.context.view_layer.update()
    turned = np.array([[-HIGH[1], LOW[0], LOW[2]], [-LOW[1], HIGH[0], HIGH[2]]]) + [5.0, 0.0, 0.0]
    assert np.abs(bounds(box) - turned).max() < 0.1
    assert settings.unseen_share >= 0.0  # the views have been checked, too
    names, arrays = exported(imported)
    assert names["completed"] and len(names["objects"]) == 3
    exact = arrays["triangle_exact"]
    assert np.array_equal(exact, arrays["triangle_object"] == names["objects"].index(box.name))

    settings.alignment.location.x = 7.0  # they move with the scan
    bpy.context.view_layer.update()
    assert np.abs(bounds(box) - turned - [2.0, 0.0, 0.0]).max() < 0.1
    assert ops.select_added() == {"FINISHED"}
    assert set(bpy.context.view_layer.objects.selected) == {closing, box}

    bpy.data.objects.remove(box)
    names, arrays = exported(imported)
    assert names["completed"] and names["object_ids"][1:] == [CLOSING] and "triangle_exact" not in arrays
    settings.completed = False
    assert "completed" not in exported(imported)[0]
    # Looked for again, it is there again, once: the engine gets the scan alone.
    run = RunFolder(imported.fipt.run_folder)
    take_found(imported, run)
    assert sorted(item[ADDED] for item in added_surfaces(imported)) == ["closed", "found"]
    for search, objects in ((True, 1), (False, 3)):
        for _ in write_survey_input(run, search):
            pass
        assert len(read_document(RunFolder(run.survey).room_json, dict)["objects"]) == objects
    # The surfaces that were found belong to a scan, and leave with it.
    assert ops.import_mesh(filepath=str(Path(imported.fipt.capture.path) / "scene.obj")) == {"FINISHED"}
    assert not added_surfaces(imported) and not settings.completed


@pytest.mark.parametrize("shape", ["BOX", "CYLINDER", "PANEL"])
def test_a_drawn_surface_stands_at_the_cursor_before_the_views_are_checked(imported, shape):
    imported.cursor.location = (0.5, -0.5, 1.0)
    assert ops.add_surface(shape=shape) == {"FINISHED"}
    (item,) = added_surfaces(imported)
    assert bpy.context.view_layer.objects.active == item and item.select_get()
    bpy.context.view_layer.update()
    low, high = bounds(item)
    assert np.allclose(0.5 * (low + high)[:2], [0.5, -0.5], atol=1e-5)
    assert 0.2 < (high - low)[:2].min() and (high - low).max() < 1.0
    if shape != "PANEL":
        assert low[2] == pytest.approx(1.0) and high[2] > 1.2
    names, arrays = exported(imported)
    exact = arrays["triangle_exact"]
    assert exact.sum() == {"BOX": 12, "CYLINDER": 124, "PANEL": 2}[shape] and "completed" not in names
    corners = arrays["vertices"][arrays["triangles"][exact]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turn = (normals[:, None] * arrays["corner_normals"][exact]).sum(axis=2)
    assert turn.min() > (0.99 if shape == "CYLINDER" else 0.9999)  # smooth around, not over the caps' edges
    bpy.ops.ed.undo_push(message="drawn")
    copy = item.copy()
    imported.collection.objects.link(copy)
    assert copy[ADDED] == item[ADDED]


def test_a_drawn_surface_stands_where_the_photographs_disagree(imported):
    assert "Use Check Views first" in refused(ops.show_coverage)
    with engine_here():
        assert ops.check_views() == {"FINISHED"}
    assert ops.show_coverage() == {"FINISHED"} and overlay.shown(imported) == "coverage"
    assert ops.show_coverage(show=False) == {"FINISHED"} and overlay.shown(imported) == ""
    assert ops.add_surface(shape="BOX") == {"FINISHED"}
    (item,) = added_surfaces(imported)
    bpy.context.view_layer.update()
    low, high = bounds(item)
    # To the spacing of the points that were looked at.
    assert np.abs(low - LOW).max() < 0.25 and np.abs(high - HIGH).max() < 0.25
    assert ops.add_surface(shape="CYLINDER") == {"FINISHED"}
    _, second = added_surfaces(imported)
    bpy.context.view_layer.update()
    assert np.allclose(bounds(second)[0, 2], 0.0, atol=1e-5)  # at the 3D cursor: nothing else is lacking
