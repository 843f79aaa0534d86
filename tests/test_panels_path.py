"""The guided path: what the tab shows at each stage, how little of it at first, and what follows a job."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from fipt_blender import machine
from fipt_blender.blend import marks
from fipt_blender.bridge.job import Job
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.result_contents import QualityNote
from fipt_blender.jobs import running, runstate, session
from fipt_blender.panels import engine, estimate, manual, start
from samples.layouts import drawn_by, tab_count

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(autouse=True)
def no_jobs():
    """Jobs of other tests are forgotten."""
    running.forget()


@pytest.fixture
def ready(monkeypatch):
    """An engine that works."""
    monkeypatch.setattr(machine, "has_engine", lambda: True)


def add_capture(views: int = 3) -> None:
    """Views with cameras, and a cube as the room."""
    scene = bpy.context.scene
    settings = scene.fipt.capture
    for index in range(views):
        camera = bpy.data.objects.new(f"view {index}", bpy.data.cameras.new("camera"))
        scene.collection.objects.link(camera)
        view = settings.views.add()
        view.name = view.camera = camera.name
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    settings.count_views()


def test_a_fresh_install_shows_the_engine_alone(monkeypatch):
    monkeypatch.setattr(machine, "has_engine", lambda: False)
    count = tab_count()
    assert count.sections == ("Start",)
    assert "fipt.set_up_engine" in count.buttons and "fipt.try_example" not in count.buttons
    assert len(count.buttons) + len(count.settings) <= 5


@pytest.mark.usefixtures("ready")
def test_each_stage_shows_what_can_be_used_then():
    count = tab_count()
    assert count.sections == ("Start",) and {"fipt.try_example", "fipt.choose_capture"} <= set(count.buttons)
    assert len(count.buttons) + len(count.settings) <= 5
    bpy.context.scene.fipt.photographs.path = "/card"
    assert tab_count().sections == tab_count().opened == ("Photographs",)
    add_capture()
    count = tab_count()
    assert count.sections == ("Photographs", "Capture", "Estimate") and count.opened == ("Estimate",)
    bpy.context.scene.fipt.materials.object_count = 1
    count = tab_count()
    assert count.sections[-3:] == ("Materials", "Lights", "Render")
    assert "Capture" not in count.opened


@pytest.mark.usefixtures("ready")
def test_after_results_the_tab_shows_a_dozen_buttons(applied, monkeypatch):
    """Also with guide, photographs, and a lamp in doubt that was answered."""
    monkeypatch.setattr(manual, "SITE", "https://docs.example/")
    state = runstate.RunState(stages=5, results=True, finished=True, quality=QualityNote(27.1, 29.4))
    monkeypatch.setattr(runstate, "known", lambda folder: state)
    applied.fipt.photographs.path = "/card"
    applied.fipt.capture.views.add().name = "a view"
    lamp = applied.fipt.lights.lights[0].object
    lamp[marks.PROBABILITY] = 0.6
    assert bpy.ops.fipt.hint_on_lamp(light=lamp.name, emission="EMITS") == {"FINISHED"}
    count = tab_count()
    assert count.opened == ("Estimate", "Materials", "Lights", "Render")
    assert len(count.buttons) <= 12 and len(count.settings) <= 8 and len(count.texts) <= 15, count
    shown = {"fipt.pick_part", "fipt.switch_lights", "fipt.add_light", "fipt.final_picture", "fipt.hint_on_lamp"}
    assert shown <= set(count.buttons)


def test_online_access_is_explained_and_asked_for_where_it_is_needed(monkeypatch):
    monkeypatch.setattr(machine, "has_engine", lambda: False)
    monkeypatch.setattr(engine, "bpy", app := SimpleNamespace(app=SimpleNamespace(), context=bpy.context))
    drawn = {}
    for app.app.online_access in (False, True):
        drawn[app.app.online_access], properties = drawn_by(start.FIPT_PT_start)
        assert "use_online_access" in properties
    # The switch and the buttons keep their places under the pointer: what goes was below them.
    (*with_text,), without = drawn[False], drawn[True]
    assert with_text[: len(without)] == without and "may not use the internet" in " ".join(with_text)
    monkeypatch.setattr(machine.DEFAULTS, "wheel_folder", "/wheels")
    drawn, properties = drawn_by(start.FIPT_PT_start)
    assert "use_online_access" not in properties and "fipt.set_up_engine" in drawn


def test_without_an_engine_an_error_leads_to_its_set_up(tmp_path):
    scene = bpy.context.scene
    info = Job([], tmp_path / "log.txt", title="Example", kind="estimate", scene_name=scene.name)
    running.refuse(info, FiptError.of("engine-missing", "There is no engine.", "Set it up."))
    assert "fipt.set_up_engine" in drawn_by(estimate.FIPT_PT_estimate)[0]


@pytest.mark.usefixtures("ready")
def test_photographs_without_cameras_lead_to_make_capture(tmp_path):
    scene = bpy.context.scene
    scene.fipt.capture.path, scene.fipt.run_folder = str(tmp_path / "photos"), str(tmp_path / "run")
    info = Job([], tmp_path / "run" / "log.txt", title="Import Capture", kind="capture", scene_name=scene.name)
    error = FiptError.of("cameras-missing", "Photographs without cameras.", "Make a capture.")
    running.refuse(info, error)
    assert "fipt.photographs_of_capture" in drawn_by(start.FIPT_PT_start)[0]
    assert bpy.ops.fipt.photographs_of_capture() == {"FINISHED"}
    assert scene.fipt.photographs.path == str(tmp_path / "photos") and tab_count().sections == ("Photographs",)
    assert bpy.ops.fipt.leave_photographs() == {"FINISHED"}
    assert tab_count().sections == ("Start",)
    assert "Photographs without cameras." not in drawn_by(start.FIPT_PT_start)[0]
    # After an import they become a capture unasked, unless it failed for another reason.
    scene.fipt.capture.path = str(tmp_path / "photos")
    running.refuse(info, FiptError.of("other", "Another error.", "Another remedy."))
    session.after_job(info)
    assert not scene.fipt.photographs.path
    running.refuse(info, error)
    session.after_job(info)
    assert scene.fipt.photographs.path == str(tmp_path / "photos") and running.last("capture") is None
    assert tab_count().sections == ("Photographs",)


def test_without_a_mesh_the_next_step_is_to_bring_one(monkeypatch):
    monkeypatch.setattr(machine, "engine_python", lambda: pytest.fail("a process was started while drawing"))
    add_capture()
    assert "fipt.estimate" in drawn_by(estimate.FIPT_PT_estimate)[0]
    room = bpy.context.scene.fipt.capture.room_objects(bpy.context.scene)
    for item in room:
        bpy.data.objects.remove(item)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert "fipt.import_mesh" in drawn and "fipt.estimate" not in drawn


@pytest.mark.parametrize(
    ("state", "wanted", "mode", "applied"),
    [
        ("finished", True, "OBJECT", True),
        ("cancelled", True, "OBJECT", False),
        ("finished", False, "OBJECT", False),
        ("finished", True, "EDIT", False),
    ],
)
def test_results_of_an_estimation_are_applied_unless_the_artist_minds(scene, state, wanted, mode, applied):
    scene.fipt.estimate.apply_when_finished = wanted
    bpy.context.view_layer.objects.active = bpy.data.objects["cube"]
    bpy.ops.object.mode_set(mode=mode)
    folder = Path(scene.fipt.run_folder)
    job = Job([], folder / "log.txt", title="Estimate", kind="estimate", scene_name=scene.name, ended=True)
    job.cancelled = state == "cancelled"
    session.after_job(job)
    assert bool(scene.fipt.materials.object_count) is applied
    bpy.ops.object.mode_set(mode="OBJECT")
