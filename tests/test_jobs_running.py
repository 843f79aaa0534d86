"""The running job beside the artist, with stand-in engines.

Timers never fire without a window: here `running.tick` is called by hand.
"""

from __future__ import annotations

import json
from typing import Annotated

import bpy
import pytest

import fipt_blender
from fipt_blender import machine
from fipt_blender.bridge.job import Job
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.step import Step
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.lock import holder
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import job_scene, run_job, running, runstate
from fipt_blender.jobs.tasks import Task
from fipt_blender.operators.action import action
from samples.child_processes import wait_for
from samples.refusals import error_of
from samples.stand_in_jobs import at_work, finish, make_job, tick_until


@pytest.fixture(autouse=True)
def registered(monkeypatch, tmp_path):
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(tmp_path / "data"))
    fipt_blender.register()
    yield
    fipt_blender.unregister()
    assert running.current() is None and not bpy.app.timers.is_registered(running.tick)


@pytest.fixture
def run(tmp_path) -> RunFolder:
    """The scene's run folder."""
    run = RunFolder(tmp_path / "run")
    run.create(make_settings("draft"))
    bpy.context.scene.fipt.run_folder = str(run.root)
    return run


def test_what_the_panel_shows_follows_the_engine(run):
    ended = []
    info = running.start(make_job(run), ended.append)
    assert running.current() is info and info.state == "running" and running.last("test") is None
    caught = error_of(running.start, make_job(run))
    assert caught.code == "job-running" and "Test" in caught.text
    assert running.current() is info and not bpy.ops.fipt.estimate.poll()
    tick_until(lambda: at_work(info))
    assert info.stage_text == "Baking" and 0.3 < info.fraction < 0.5 and info.memory_gb > 0.0
    assert info.pictures == [run.root / "stage" / "picture.png"]
    assert [warning["code"] for warning in info.warnings] == ["odd"] and not ended
    finish(run, info)
    assert info.state == "finished" and info.fraction == 1.0 and ended == [info]
    assert running.current() is None and running.last("test") is info is running.last()
    assert running.tick() is None


def test_a_function_gets_its_scene_whichever_is_shown(run):
    seen = []
    scene = bpy.context.scene
    bpy.data.scenes.new("Another")
    info = running.start(make_job(run, lambda: seen.append(bpy.context.scene.name), engine=False))
    scene.name = "Renamed"
    tick_until(lambda: info.state != "running")
    assert info.state == "finished" and seen == ["Renamed"]


def test_a_reload_that_forgets_the_run_folder_is_told_it_again(run, tmp_path):
    bpy.context.scene.fipt.run_folder = ""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.context.scene.fipt.run_folder = str(run.root)
    names = []
    info = running.start(make_job(run, lambda: names.append(bpy.context.scene.fipt.run_folder)))
    tick_until(lambda: at_work(info))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert not bpy.context.scene.fipt.run_folder
    finish(run, info)
    assert info.state == "finished" and names == [bpy.context.scene.fipt.run_folder] == [str(run.root)]


def test_undo_during_a_job_takes_nothing_away_that_it_goes_on_with(run, monkeypatch):
    notices = []
    monkeypatch.setattr(running, "show_notice", lambda text, level: notices.append(level))
    scene = bpy.context.scene
    scene.fipt.run_folder = ""
    room = bpy.data.collections.new("Room")
    scene.collection.children.link(room)
    scene.fipt.capture.room = room
    bpy.ops.ed.undo_push(message="before")
    room.objects.link(bpy.data.objects.new("wall", bpy.data.meshes.new("wall")))
    bpy.ops.ed.undo_push(message="room")
    scene.fipt.capture.views.add().name = "view"
    scene.fipt.run_folder = str(run.root)
    bpy.ops.ed.undo_push(message="job")
    info = running.start(make_job(run))
    tick_until(lambda: at_work(info))
    bpy.data.objects["wall"].location.x = 1.0
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.ed.undo()  # of what the job does not need
    running.tick()
    assert bpy.data.objects["wall"].location.x == 0.0 and not notices
    for steps in (1, 2):
        for _ in range(steps):
            bpy.ops.ed.undo()
        assert not bpy.context.scene.fipt.run_folder and ("wall" in bpy.data.objects) == (steps == 1)
        running.tick()
        fipt = bpy.context.scene.fipt
        assert fipt.run_folder == str(run.root) and len(fipt.capture.views) == 1
        assert "wall" in bpy.data.objects and notices == ["WARNING"] * steps
    finish(run, info)
    assert info.state == "finished"
    bpy.ops.ed.undo()  # after its end as ever
    assert not bpy.context.scene.fipt.run_folder


def test_while_a_job_runs_the_file_has_unsaved_changes_so_that_blender_asks_before_it_quits(run, monkeypatch):
    """Without a window Blender never takes a file for saved."""
    pushed, saved = [], [True]
    monkeypatch.setattr(running, "push_undo", lambda text: (pushed.append(text), saved.clear()))
    monkeypatch.setattr(running, "is_saved", lambda: bool(saved))
    info = running.start(make_job(run))
    tick_until(lambda: at_work(info))
    assert pushed == ["Test"]
    saved.append(True)
    running.tick()
    running.tick()
    assert pushed == ["Test"] * 2
    finish(run, info)


def test_in_another_file_the_engine_goes_on_but_functions_touch_nothing(run, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    touched = []
    info = running.start(make_job(run, lambda: touched.append(1)))
    tick_until(lambda: at_work(info))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    running.tick()
    assert info.state == "running" and not bpy.context.scene.fipt.run_folder
    finish(run, info)
    assert info.state == "failed" and info.error["code"] == "scene-gone" and not touched
    assert "Open" in info.error["remedy"] and "resume" in info.error["remedy"]
    # The engine's part is finished for the scene that names the folder.
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert job_scene.find_scene("Scene", run.root) is not None


def test_disabling_stops_the_engine(run):
    info = running.start(make_job(run))
    tick_until(lambda: at_work(info))
    fipt_blender.unregister()  # the engine would never end by itself
    assert info.state == "cancelled" and running.current() is None
    wait_for(lambda: holder(run) is None)  # killed, but the system may not have got to it
    fipt_blender.register()


def test_a_bug_in_a_timer_ends_the_job_with_words(run, monkeypatch, capsys):
    info = running.start(make_job(run))
    tick_until(lambda: at_work(info))
    poll = EngineProcess.poll

    def fail_once(engine):
        monkeypatch.setattr(EngineProcess, "poll", poll)
        raise ZeroDivisionError

    monkeypatch.setattr(EngineProcess, "poll", fail_once)
    assert running.tick() is None
    assert info.state == "failed" and "ZeroDivisionError" in info.error["text"]
    assert holder(run) is None and "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(("raised", "code"), [(FiptError.of("x", "X.", "Y."), "x"), (KeyError("k"), None)])
def test_a_failure_at_the_end_is_the_jobs(run, raised, code, capsys):
    def end(info):
        raise raised

    info = running.start(make_job(run, lambda: None, engine=False), end)
    tick_until(lambda: info.state != "running")
    assert info.state == "failed" and info.error["code"] == (code or "blender-step-failed")


def test_the_state_of_a_run_folder(run):
    assert runstate.known("") == runstate.RunState() == runstate.look(run)
    messages = run.messages("estimate")
    messages.parent.mkdir()
    messages.write_text(
        '{"type": "progress", "fraction": 0.5}\nstray\n'
        '{"type": "progress", "fraction": 0.6, "files": ["stage/a.png"]}\n'
        '{"type": "warning", "code": "w", "text": "W.", "remedy": "R."}\n'
        '{"type": "error", "code": "disk-full", "text": "F.", "remedy": "R."}\n'
    )
    stages = {"keys": {}, "stages": {"pixels": {}, "shadings": {}}, "warnings": {}, "values": {}}
    (run.stage / "stages.json").write_text(json.dumps(stages))
    state = runstate.look(run)
    assert (state.stages, state.finished) == (2, False)
    assert state.error["code"] == "disk-full" and [each["code"] for each in state.warnings] == ["w"]
    assert state.pictures == (run.root / "stage" / "a.png",)
    for path in (run.statistics_json, run.emitters_json, run.fields_npz):
        path.touch()
    assert runstate.look(run).finished
    for quality, found in (('{"held_back_db": 30.5, "projection_db": 31}', 30.5), ('{"views": []}', None)):
        run.quality_json.write_text(quality)
        note = runstate.look(run).quality
        assert (note if note is None else note.held_back_db) == found


ended: list[str] = []


@action("Try")
def try_job(scene: bpy.types.Scene, mode: Annotated[str, "How it ends"] = "") -> Task:
    """For the test below."""
    error = FiptError.of("bad", "It went wrong.", "Try again.")

    def work():
        yield
        if mode == "fail":
            raise error

    def make(scene):
        if mode == "refuse":
            raise error
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        return run_job.open_job(run, [Step("work", "Working", 1.0, function=work)])

    return Task("Trying", "try", make, lambda scene, run: ended.append(f"{scene.name} {run.root.name}"))


def test_an_operators_job_runs_to_its_end_for_scripts_and_its_failure_is_an_error(run):
    bpy.utils.register_class(try_job.operator)
    try:
        operator = bpy.ops.fipt.try_job
        assert operator() == {"FINISHED"} == operator("INVOKE_DEFAULT")
        assert ended == ["Scene run"] * 2 and running.last("try").state == "finished"
        for mode in ("refuse", "fail"):
            bpy.context.scene.fipt.run_folder = str(run.root)
            with pytest.raises(RuntimeError, match=r"It went wrong\. Try again"):
                operator(mode=mode)
            assert len(ended) == 2 and running.current() is None
            job = running.last("try")
            assert (job.state, job.error["text"], job.error["remedy"]) == ("failed", "It went wrong.", "Try again.")
            assert running.belongs_to(job, bpy.context.scene)
            bpy.context.scene.fipt.run_folder = "elsewhere"
            assert not running.belongs_to(job, bpy.context.scene)
    finally:
        bpy.utils.unregister_class(try_job.operator)


def test_a_job_that_starts_at_the_end_of_another_is_advanced_by_the_same_timer(run):
    """Blender removes a timer whose function returns None, even if it was registered again meanwhile."""
    following = []

    def follow(info: Job) -> None:
        if not following:
            following.append(running.start(make_job(run, lambda: None, engine=False)))

    running.register(follow)
    info, delays = running.start(make_job(run, lambda: None, engine=False)), []
    while not following:
        delays.append(running.tick())
    assert info.state == "finished" and running.current() is following[0] and None not in delays
    tick_until(lambda: following[0].state == "finished")
    assert running.tick() is None
