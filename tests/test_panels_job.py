"""How sections draw their jobs: the way on first, then warnings; and what the section Capture tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from fipt_blender.bridge.job import Job
from fipt_blender.bridge.step import Step
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.jobs import running, runstate
from fipt_blender.operators import estimate as operators
from fipt_blender.panels import capture, estimate, progress
from samples.layouts import Layout, drawn_by

pytestmark = pytest.mark.usefixtures("registered")

WARNINGS = [{"code": code, "text": f"The {code} is odd.", "remedy": f"Mend the {code}."} for code in ("lamp", "wall")]


def new_job(title: str, kind: str, folder: Path, **more) -> Job:
    return Job([], folder / "log.txt", title=title, kind=kind, scene_name=bpy.context.scene.name, **more)


def set_running(monkeypatch, kind: str, title: str, folder: Path) -> Job:
    """Let a job of a kind run."""
    job = new_job(title, kind, folder, fraction=0.42)
    monkeypatch.setattr(running, "current", lambda: job)
    return job


@pytest.fixture
def finished(monkeypatch, tmp_path) -> None:
    """An estimation with two warnings has ended in the scene's run folder."""
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    job = new_job("Estimate", "estimate", tmp_path, ended=True)
    job.warnings += WARNINGS
    monkeypatch.setattr(running, "last", lambda kind: job if kind == "estimate" else None)
    monkeypatch.setattr(runstate, "known", lambda folder: runstate.RunState(stages=5, results=True, finished=True))


@pytest.mark.usefixtures("finished")
def test_after_an_estimation_the_way_on_comes_before_its_warnings():
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert drawn == ["fipt.apply_results", "Estimate Again", "2 warnings"]


def test_results_of_the_estimate_before_can_be_applied_while_a_new_one_is_stopped(monkeypatch, tmp_path):
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    monkeypatch.setattr(runstate, "known", lambda folder: runstate.RunState(stages=2, results=True))
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert {"fipt.resume", "fipt.apply_results"} <= set(drawn)


def test_a_forecast_is_a_range_beside_the_time_that_has_passed(monkeypatch, tmp_path):
    job = set_running(monkeypatch, "estimate", "Estimate", tmp_path)
    job.started -= 190.0
    shown = {
        30.0: "less than 1 min",
        100.0: "1 to 2 min",
        290.0: "2 to 5 min",
        3500.0: "40 to 60 min",
        7300.0: "2 to 3 h",
    }
    for job.remaining_seconds, text in shown.items():
        assert f"{text} left   3 min so far" in drawn_by(estimate.FIPT_PT_estimate)[0]
        assert progress.status_text(job) == f"Estimate: 42%, {text} left"


def test_a_job_of_another_file_says_of_which(monkeypatch, tmp_path):
    set_running(monkeypatch, "estimate", "Estimate", tmp_path)
    bpy.context.scene.fipt.run_folder = str(tmp_path / "another")
    monkeypatch.setattr(running, "other_file", lambda: "kitchen.blend")
    assert "Running for 'kitchen.blend'" in " ".join(drawn_by(estimate.FIPT_PT_estimate)[0])


def test_a_key_never_stops_a_job_without_a_question(monkeypatch, tmp_path):
    """Not even in its first minute: it may have been meant for a text field, or for Blender."""
    job = set_running(monkeypatch, "estimate", "Estimate", tmp_path)
    asked = []
    manager = SimpleNamespace(invoke_confirm=lambda *_, **texts: asked.append(texts["title"]) or {"RUNNING_MODAL"})
    context = SimpleNamespace(window_manager=manager, screen=None)
    for name, more in (("cancel", {"by_key": True}), ("quit_during_job", {})):
        button = SimpleNamespace(execute=lambda _: asked.append("done"), **more)
        assert getattr(operators, name).operator.invoke(button, context, None) == {"RUNNING_MODAL"}
    assert asked == ["Stop 'Estimate'?", "Quit and stop 'Estimate'?"] and not job.cancelled
    monkeypatch.setattr(running, "current", lambda: None)
    assert not bpy.ops.fipt.quit_during_job.poll()  # Blender's own Ctrl Q


def test_a_result_says_how_good_it_is(monkeypatch, tmp_path):
    # As an earlier version has written them.
    cause = {"name": "lamps", "share": 0.6, "remedy": "Look at them."}
    figures = {"held_back_db": 27.14, "projection_db": 29.4, "causes": [cause], "views": []}
    write_json(tmp_path / "results" / "quality.json", figures)
    state = runstate.RunState(results=True, finished=True, quality=runstate.look(RunFolder(tmp_path)).quality)
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    monkeypatch.setattr(runstate, "known", lambda folder: state)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    wanted = "Differs from unseen photographs by 4.4% of white (27.1 dB)"
    assert wanted in " ".join(drawn)  # in lines of the panel's width
    assert "misses" not in " ".join(drawn)


def test_a_result_is_shown_where_it_is_worst(monkeypatch, tmp_path):
    good, bad = (
        {"name": name, "errors": [[error] * 3, [0.001] * 3]}
        | {kind: f"{name}-{kind}.png" for kind in ("photograph", "render", "projection")}
        for name, error in (("000", 0.002), ("001", 0.01))
    )
    figures = {"held_back_db": 12.0, "projection_db": 29.4, "on_mesh_db": 20.0, "on_mesh_share": 0.93}
    write_json(tmp_path / "results" / "quality.json", {**figures, "views": [good, bad]})
    found = runstate.look(RunFolder(tmp_path))
    assert [path.name for path in found.worst] == ["001-photograph.png", "001-render.png", "001-projection.png"]
    state = replace(found, results=True, finished=True)
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    monkeypatch.setattr(runstate, "known", lambda folder: state)
    monkeypatch.setattr(estimate.estimate_pictures, "icon", lambda path: 1)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    line = "Differs from unseen photographs by 10.0% of white (20.0 dB) on the mesh, which misses 7% of them"
    assert line in " ".join(drawn)
    assert "Worst View" in drawn and "Photograph" not in drawn
    monkeypatch.setattr(Layout, "panel", lambda layout, *name, **options: (layout, layout), raising=False)  # opened
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert drawn[drawn.index("Worst View") + 1 :][:3] == ["Photograph", "Render", "Projection"]


def test_estimate_says_for_what_it_waits_and_how_to_stop_that(monkeypatch, tmp_path):
    set_running(monkeypatch, "survey", "Check Views", tmp_path)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert drawn.index("fipt.estimate") < drawn.index("Check Views: 42%") < drawn.index("fipt.cancel")
    with pytest.raises(RuntimeError, match=r"Check Views is running\. Wait for its end, or stop it with Esc"):
        bpy.ops.fipt.estimate()


@pytest.fixture
def notices(monkeypatch) -> list[tuple[str, str]]:
    """The notices that jobs show."""
    shown: list[tuple[str, str]] = []
    monkeypatch.setattr(running, "show_notice", lambda text, level: shown.append((text, level)))
    return shown


def do_job(tmp_path: Path, function) -> Job:
    return running.run(Job([Step("one", "One", 1.0, function=function)], tmp_path / "log.txt", title="Check Views"))


def test_a_failure_is_told_with_its_reason(tmp_path, notices):
    def fail():
        raise FiptError.of("odd", "There is no mesh.", "Import one.")

    assert do_job(tmp_path, fail).state == "failed"
    # In the status bar, without a popup: the section shows it with its remedy.
    assert notices == [("Check Views failed: There is no mesh.", "WARNING")]


def test_a_warning_goes_once_its_remedy_was_followed(tmp_path):
    info = new_job("Import Capture", "capture", tmp_path)
    info.warnings += [{"code": "mesh-missing"}, {"code": "images-not-hdr"}]
    running.refuse(info, FiptError.of("odd", "The file is odd.", "Export it again."))
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    assert info.warnings == [{"code": "images-not-hdr"}]


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("format", "-Y is up by the format"),
        ("option", "-Y is up by the import settings"),
        ("planes", "10.3° from -Y is up by the planes of the room"),
        ("cameras", "10.3° from -Y is up by the cameras"),
    ],
)
def test_what_is_up_is_told_with_a_choice_of_the_others(source, told):
    settings = bpy.context.scene.fipt.capture
    assert "up" not in drawn_by(capture.FIPT_PT_capture)[1]
    settings.imported_up, settings.up_source, settings.up_angle = "-y", source, 10.3
    texts, properties = drawn_by(capture.FIPT_PT_capture)[:2]
    assert told in " ".join(texts) and "up" in properties


def test_what_is_not_known_of_another_version_is_left_out():
    settings = bpy.context.scene.fipt
    settings.capture.imported_up, settings.capture.up_source = "z", "gravity"
    texts, properties = drawn_by(capture.FIPT_PT_capture)[:2]
    assert "up" in properties and not any("is up" in text for text in texts)
    settings.parts.auto_source = "colors"
    assert "Automatic uses: colors" in drawn_by(estimate.FIPT_PT_parts)[0]
