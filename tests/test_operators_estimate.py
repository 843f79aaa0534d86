"""The section Estimate as scripts press it, with the real engine on a tiny room: faults at every stage."""

from __future__ import annotations

import json
import os
import re
import signal
from pathlib import Path

import bpy
import pytest

from fipt_blender import api, machine
from fipt_blender.api import estimating
from fipt_blender.api.estimating import scene_settings
from fipt_blender.bridge import interpreter
from fipt_blender.bridge.job import Job
from fipt_blender.core.run import settings as settings_module
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.lock import holder
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import run_job, running, runstate
from fipt_blender.jobs.scene_steps import camera_step, estimation_steps
from fipt_blender.operators.estimate import smaller_preset_of
from fipt_blender.properties.estimate import CHOICES
from samples.child_processes import wait_for
from samples.engine_here import engine_here, hardly_training
from samples.operator_calls import refused
from samples.small_captures import FEW, PANEL, QUICK, SmallCapture, panel_capture, some_views, write_run
from samples.small_rooms import BOX
from samples.stand_in_jobs import tick_until

ops = bpy.ops.fipt
posix = pytest.mark.skipif(os.name == "nt", reason="signals")
ROOM = ["cleaning", "relation", "completion", "linking", "outlines"]
STAGES = [
    *("pixels", "checks", "unmixing", "outside", "shadings", "estimate-0"),
    *("reflection-1", "refinement-1", "estimate-1", "training"),
]


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    return some_views(panel_capture())


@pytest.fixture
def run(tmp_path, capture) -> RunFolder:
    """A capture whose room still has to come from the scene."""
    run = write_run(tmp_path / "run", capture)
    run.room_npz.unlink()
    run.room_json.unlink()
    return run


@pytest.fixture
def scene(run, tmp_path, monkeypatch):
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(tmp_path / "data"))
    monkeypatch.setattr(machine.DEFAULTS, "device", "llvm")
    scene = bpy.context.scene
    room = bpy.data.collections.new("FIPT Room")
    scene.collection.children.link(room)
    scene.fipt.capture.room = room
    for index, quad in enumerate([*BOX, PANEL]):
        mesh = bpy.data.meshes.new("quad")
        mesh.from_pydata(quad, [], [(0, 1, 2, 3)])
        room.objects.link(bpy.data.objects.new(f"wall {index}", mesh))
    scene.fipt.estimate.preset = "draft"
    scene.fipt.run_folder = str(run.root)
    return scene


@pytest.fixture
def quick(monkeypatch) -> dict:
    """Settings below those that the panel offers, for a run of seconds."""
    changes = {**QUICK, **FEW, "device": "llvm", "training_steps": 20}
    monkeypatch.setattr(estimating, "scene_settings", lambda *_: make_settings("draft", changes))
    return changes


def start(resume: bool) -> Job:
    """What the button does in a window, where a timer would call `running.tick`."""
    scene = bpy.context.scene
    settings = estimating.scene_settings(scene)
    run = estimating.run_for(scene, resume)
    run.create(settings)
    steps = [camera_step(run), *estimation_steps(run, settings, resume)]
    job = run_job.open_job(run, steps)
    job.title, job.kind, job.scene_name = "Estimate", "estimate", scene.name
    return running.start(job)


def worked(run: RunFolder) -> list[str]:
    """The stages that the engine began in its last run; none while it starts."""
    path = run.messages("estimate")
    lines = path.read_text().splitlines() if path.exists() else []
    return [json.loads(line)["name"] for line in lines if line.startswith('{"type": "stage"')]


def done(run: RunFolder) -> list[str]:
    return list(read_document(run.stages_json, dict)["stages"])


def test_estimate_works_on_the_scene_as_it_is_and_starts_anew_unless_stages_are_to_be_kept(scene, run, quick):
    with engine_here(), hardly_training():
        assert ops.estimate() == {"FINISHED"}
        assert done(run) == STAGES and worked(run) == [*ROOM, *STAGES]
        assert read_document(run.room_json, dict)["objects"] == [f"wall {index}" for index in range(7)]
        assert read_document(run.emitters_json, dict)["fixtures"][0]["triangles"] == [12, 13]
        assert run.read().training_steps == 20 and run.read().device == "llvm"
        job = running.last("estimate")
        assert job.state == "finished" and all(path.is_file() for path in job.pictures)
        assert [path.name for path in job.pictures] == ["training-base_color.png", "training-emission.png"]
        assert not ops.resume.poll()  # it is finished

        quick["training_steps"] = 12
        outcome = api.estimate(keep_stages=True)
        assert outcome.run == run.root and worked(run) == ["training"]
        bpy.data.objects["wall 0"].location.x += 0.01
        api.estimate(keep_stages=True)
        assert worked(run) == [*ROOM, *STAGES], "settings alone do not tell whether something has changed"
        assert run.read().training_steps == 12 and done(run) == STAGES
        before = run.emitters_json.read_bytes()
        run.ingest_json.write_bytes(run.capture_json.read_bytes())
        assert ops.estimate() == {"FINISHED"} and run.emitters_json.read_bytes() == before
        new = RunFolder(scene.fipt.run_folder)
        assert new.root.parent == run.root.parent and worked(new) == [*ROOM, *STAGES]
        assert {version.folder for version in api.versions()} == {run.root, new.root}


def stop(stage: str, killed: bool) -> RunFolder:
    """Start an estimate in a process, or resume the one that is to be killed; stop it when it has begun a stage."""
    RunFolder(bpy.context.scene.fipt.run_folder).messages("estimate").unlink()
    info = start(resume=killed)
    run = RunFolder(info.run_folder)
    tick_until(lambda: stage in worked(run) or running.current() is None)
    if killed:
        os.kill(holder(run).pid, signal.SIGKILL)
    else:
        ops.cancel()
        assert info.state == "running" and info.stopping
    tick_until(lambda: running.current() is None)
    assert info.state == ("failed" if killed else "cancelled") and ops.resume.poll()
    if killed:
        assert info.error["code"] == "out-of-memory" and info.error["remedy"]
    else:
        assert info.error is None
        wait_for(lambda: holder(run) is None)
    assert done(run) == STAGES[: STAGES.index(stage)]
    return run


@posix
def test_an_estimate_that_is_killed_or_cancelled_resumes_and_leaves_the_first_one_usable(scene, run, quick):
    with engine_here(), hardly_training():
        scene.fipt.materials.texel_density = 10.0
        assert ops.estimate() == {"FINISHED"} and ops.apply_results() == {"FINISHED"}
    before = {path: path.read_bytes() for path in run.root.rglob("*") if path.is_file()}
    del before[run.messages("estimate")]
    bpy.data.objects["wall 0"].location.x += 5.0  # the next estimate has another room and other settings
    quick |= {"hash_levels": 4, "training_steps": 5000}
    for stage, killed, samples in (("shadings", False, 2048), ("training", True, 4)):
        quick["diffuse_spp"] = samples  # long enough to be met
        new = stop(stage, killed)
        assert {path: path.read_bytes() for path in before} == before
        state = runstate.look(new)
        assert not state.results and not state.finished and state.stages == STAGES.index(stage)
        assert not ops.reestimate.poll()
    quick["training_steps"] = 20
    with engine_here(), hardly_training():
        assert ops.resume() == {"FINISHED"} and worked(new) == ["training"]
    assert done(new) == STAGES and new.read_estimated().hash_levels == 4

    bpy.data.objects["wall 0"].location.x -= 5.0
    scene.fipt.run_folder, scene.fipt.materials.texel_density = str(run.root), 20.0
    with engine_here():  # the textures are baked again, from the first results
        assert ops.apply_results() == {"FINISHED"}
    assert run.read_estimated().hash_levels == QUICK["hash_levels"]

    # A run that goes on with another room has no results of the one before.
    bpy.data.objects["wall 0"].location.x += 5.0
    assert runstate.look(run).results
    with engine_here(), hardly_training():
        assert api.estimate(keep_stages=True).run == run.root
    assert run.read_estimated().hash_levels == 4


def test_no_engine_is_said_before_anything_is_made(scene, tmp_path, monkeypatch):
    scene.fipt.run_folder = ""
    scene.fipt.capture.views.add().name = "train/000"
    monkeypatch.setenv(interpreter.PYTHON_VARIABLE, str(tmp_path / "nowhere"))
    assert "no such file" in refused(ops.estimate)
    assert scene.fipt.run_folder == "" and not (tmp_path / "data").exists()


@posix
@pytest.mark.parametrize("script", ["exit 3", "echo 'Fatal Python error' >&2; kill -ABRT $$"])
def test_an_interpreter_that_breaks_at_work(scene, run, tmp_path, monkeypatch, script):
    broken = tmp_path / "python"
    broken.write_text(f"#!/bin/sh\n{script}\n")
    broken.chmod(0o755)
    launch = run_job.Launch(broken, dict(os.environ))
    monkeypatch.setattr(run_job, "find_launch", lambda explicit=None: launch)
    with pytest.raises(RuntimeError, match=r"log\.txt"):
        ops.estimate()
    assert running.last("estimate").error["code"] == "engine-crashed"

    broken.chmod(0o644)
    assert "can't be started" in refused(ops.estimate)
    assert running.last("estimate").error["code"] == "engine-missing"


# ------------------------------------------------------------------------------- settings and polls


def test_only_changed_settings_leave_the_preset(scene):
    settings = scene.fipt.estimate
    settings.reset()
    settings.preset = "high"
    assert scene_settings(scene) == make_settings("high", {"device": "llvm"})
    assert settings.roughness_levels == make_settings("high").roughness_levels and settings.changes == ""
    settings.training_steps = 123
    settings.diffuse_samples = 7
    settings.denoise = False
    settings.reject_views = settings.correct_exposure = False
    settings.preset = "draft"
    made = scene_settings(scene)
    assert (made.training_steps, made.diffuse_spp, made.refine_diffuse_spp, made.denoise) == (123, 7, 7, False)
    assert not made.reject_views and not made.correct_exposure
    assert made.batch_size == make_settings("draft").batch_size
    settings.light_pixels = 0.25  # millions: small captures are told in fractions
    assert scene_settings(scene).light_pixels == pytest.approx(0.25)
    assert settings.is_changed("denoise") and not settings.is_changed("rounds")
    assert ops.reset_setting(setting="diffuse_samples") == {"FINISHED"}
    assert scene_settings(scene).diffuse_spp == make_settings("draft").diffuse_spp
    assert settings.training_steps == 123
    ops.reset_setting()
    assert scene_settings(scene) == make_settings("draft", {"device": "llvm"})
    settings.device = "cuda"  # before the one of the preferences
    assert scene_settings(scene).device == "cuda"
    settings.changes = "nonsense"
    assert settings.rounds == 1


def test_settings_that_messages_name_are_in_the_panel():
    core = Path(settings_module.__file__).parent.parent
    text = "".join(path.read_text(encoding="utf-8") for path in core.rglob("*.*") if path.suffix in (".py", ".toml"))
    named = set(re.findall(r"--set ([a-z_]+)=", text))
    assert named and named <= {field for choice in CHOICES.values() for field in choice}


def test_smaller_presets(scene, monkeypatch):
    assert tuple(map(smaller_preset_of, ("high", "medium", "draft"))) == ("medium", "draft", None)
    scene.fipt.estimate.preset = "draft"
    assert not ops.smaller_preset.poll()
    scene.fipt.estimate.preset = "medium"
    scene.fipt.estimate.rounds = 5
    assert ops.smaller_preset.poll()
    monkeypatch.setattr(run_job, "find_launch", lambda explicit=None: run_job.Launch(Path("nowhere"), {}))
    with pytest.raises(RuntimeError):
        ops.smaller_preset()
    assert scene.fipt.estimate.preset == "draft" and scene.fipt.estimate.rounds == 1


def test_without_a_room_or_a_capture_it_says_what_is_missing(scene, run):
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    with pytest.raises(RuntimeError, match=r"no room.*section Capture"):
        ops.estimate()
    run.capture_json.unlink()
    assert "capture" in refused(ops.estimate)
    assert not holder(run)
