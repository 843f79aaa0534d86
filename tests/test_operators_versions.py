# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Versions, the command line's versions and the Python API, on a room with two estimates."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender import api, cli
from fipt_blender.blend.pictures.image_files import read_pixels
from fipt_blender.core.run import versions
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.replacing import keep_inputs
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.textures import bake
from fipt_blender.jobs import run_job, running, runstate
from samples.applied_rooms import ConstantFields, make_scene
from samples.operator_calls import refused
from samples.refusals import error_of

ops = bpy.ops.fipt
pytestmark = pytest.mark.usefixtures("registered")


def write_estimate(run: RunFolder, gray: float, key: str, hinted: str = "") -> str:
    """New results whose base colour is gray, as an engine writes them; returns their version."""
    keys = {"training": key, **({"hinted-training": hinted} if hinted else {})}
    write_json(run.stages_json, {"keys": keys, "stages": {k: {} for k in keys}, "warnings": {}, "values": {}})
    with versions.new_results(run) as new:
        for path in (run.emitters_json, run.statistics_json, run.doubts_json):
            if path.exists():
                shutil.copy(path, new.results / path.name)
        new.fields_npz.write_text(str(gray))
        keep_inputs(new, new.results)
        versions.note_version(new.results)
    return versions.present_version(run)


class GrayFields(ConstantFields):
    def __init__(self, run: RunFolder) -> None:
        self.base_color = (float(run.fields_npz.read_text()),) * 3


@pytest.fixture
def works(monkeypatch) -> list[str]:
    """The commands of an engine in this process, which estimates a base colour of 0.75."""
    done: list[str] = []
    real = run_job.open_job

    def fake(step, run):
        def work():
            done.append(step.command[0])
            if step.command[0] == "textures":
                bake.bake(run.estimated(), GrayFields(run))
            else:
                write_estimate(run, 0.75, "light", hinted="told")

        return replace(step, command=None, function=work) if step.command else step

    def open_job(run, steps, **options):
        options["launch"] = run_job.Launch(Path(sys.executable), {})
        return real(run, [fake(step, run) for step in steps], **options)

    monkeypatch.setattr(run_job, "open_job", open_job)
    monkeypatch.setattr(run_job, "find_launch", lambda *_: None)
    return done


@pytest.fixture
def scene(tmp_path, works) -> bpy.types.Scene:
    """An artist's room with two estimates, of which the last one is applied."""
    scene = make_scene(tmp_path / "run", environment=False)
    run = RunFolder(scene.fipt.run_folder)
    run.fields_npz.unlink()
    write_estimate(run, 0.25, "first")
    api.apply()
    write_estimate(run, 0.5, "light")
    api.apply()
    works.clear()
    return scene


def shown(scene: bpy.types.Scene) -> float:
    """The base colour of the room's first texture."""
    material = bpy.data.objects["cube"].data.materials[0]
    image = material.node_tree.nodes["FIPT Base Color"].image
    return float(np.median(np.array(image.pixels[:]).reshape(-1, 4)[:, 0]))


def ids(scene: bpy.types.Scene) -> tuple[str, str]:
    """The present version and the one before."""
    first, second = (version.id for version in api.versions(scene))
    return first, second


def test_a_version_is_used_and_applied_without_baking_it_again(scene, works):
    newest, oldest = ids(scene)
    assert shown(scene) == pytest.approx(0.5, abs=1e-3)
    for version, gray in ((oldest, 0.25), (newest, 0.5)):
        assert ops.use_version(version=version) == {"FINISHED"}
        assert shown(scene) == pytest.approx(gray, abs=1e-3) and works == []
        assert scene.fipt.materials.applied_version == version == api.versions(scene)[0].id
        assert scene.fipt.run_folder and RunFolder(scene.fipt.run_folder).fields_npz.read_text() == str(gray)
    state = runstate.look(RunFolder(scene.fipt.run_folder))
    assert state.finished and state.continues and not state.earlier and len(state.versions) == 2


def test_an_earlier_version_is_no_stopped_run_and_can_not_be_continued(scene):
    ops.use_version(version=ids(scene)[1])
    state = runstate.look(RunFolder(scene.fipt.run_folder))
    assert state.earlier and not state.finished and not state.continues
    assert not ops.resume.poll() and not ops.reestimate.poll()
    with pytest.raises(FiptError, match="stages of this version are gone"):
        api.reestimate()


def test_undo_and_a_reloaded_file_show_what_they_had(scene, tmp_path):
    newest, oldest = ids(scene)
    bpy.ops.ed.undo_push(message="before")
    ops.use_version(version=oldest)
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    settings = bpy.context.scene.fipt.materials
    assert settings.applied_version == newest  # the disk has no undo: the panel says that they differ
    assert api.versions()[0].id == oldest and shown(bpy.context.scene) == pytest.approx(0.5, abs=1e-3)
    api.apply()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert bpy.context.scene.fipt.materials.applied_version == oldest == api.versions()[0].id
    assert shown(bpy.context.scene) == pytest.approx(0.25, abs=1e-3)


def test_versions_are_named_compared_and_deleted(scene, capfd):
    newest, oldest = ids(scene)
    assert ops.rename_version(version=oldest, name="with curtains") == {"FINISHED"}
    assert api.versions()[1].title == "with curtains"
    assert ops.compare_versions(version=oldest) == {"FINISHED"}
    assert "present results" in refused(ops.delete_version, version=newest)
    assert ops.delete_version(version=oldest) == {"FINISHED"}
    assert [version.id for version in api.versions()] == [newest]
    assert "no version" in refused(ops.use_version, version=oldest)
    assert running.last("materials").error["code"] == "version-missing"


def test_re_estimate_applies_its_results_and_asks_nothing_twice(scene, works):
    run = RunFolder(scene.fipt.run_folder)
    numbers = dict.fromkeys(("share", "roughness", "metallic", "roughness_error", "metallic_error"), 0.2)
    entry = {"name": "cube", "text": "?", "view": "v", "point": [0.0, 5.0, 1.0], "pixels": 5, **numbers}
    entry |= {"box": [0, 0, 1, 1], "picture": "01.png"}
    doubts = [{**entry, "question": question} for question in ("gloss", "metal")]
    write_json(run.doubts_json, {"format": "fipt-doubts", "version": 1, "doubts": doubts})
    ops.read_doubts()
    ops.answer_doubt(index=0, answer="MATT")
    ops.read_doubts()
    assert [doubt.answered for doubt in scene.fipt.hints.doubts] == [True, False]
    assert ops.reestimate.poll() and ops.reestimate() == {"FINISHED"}
    assert works == ["estimate", "textures"] and shown(scene) == pytest.approx(0.75, abs=1e-3)
    assert [doubt.answered for doubt in scene.fipt.hints.doubts] == [True, False]
    newest = api.versions()[0]
    assert scene.fipt.materials.applied_version == newest.id and len(api.versions()) == 3
    assert ops.apply_results() == {"FINISHED"} and works == ["estimate", "textures"]  # nothing is baked again
    # Its stages are those of the estimate before, too: that one can be continued.
    ops.use_version(version=api.versions()[1].id)
    assert shown(scene) == pytest.approx(0.5, abs=1e-3) and ops.reestimate.poll()


def test_the_command_line_lists_and_uses_versions(scene, capsys, tmp_path):
    run = Path(scene.fipt.run_folder)
    newest, oldest = ids(scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(run / "room.blend"))

    def fipt(*arguments: str) -> dict:
        assert cli.main(["versions", str(run), *arguments, "--json"]) == 0
        return json.loads(capsys.readouterr().out.splitlines()[-1])["data"]

    assert [entry["id"] for entry in fipt()["versions"]] == [newest, oldest]
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert fipt("--use", oldest, "--name", oldest, "mine")["versions"][0]["name"] == "mine"
    bpy.ops.wm.open_mainfile(filepath=str(run / "room.blend"))
    assert shown(bpy.context.scene) == pytest.approx(0.25, abs=1e-3)
    assert fipt("--compare", oldest, newest)["comparison"][0] == ["Version", "mine", api.versions()[1].title]
    assert cli.main(["versions", str(run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"* {oldest}  mine") and lines[-1].strip().endswith("in all")
    assert len(fipt("--delete", newest)["versions"]) == 1
    assert cli.main(["versions", str(run), "--use", newest]) == 1
    assert cli.main(["versions", str(tmp_path)]) == 1


def test_a_script_relights_and_exports_by_the_api_alone(scene, tmp_path):
    """The recipes of docs/api.md on a finished run."""
    (lamp,) = api.fixtures()
    camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
    camera.location = (2.5, 0.5, 6.0)
    scene.collection.objects.link(camera)
    scene.camera, scene.render.resolution_x, scene.render.resolution_y = camera, 16, 8
    brightness = []
    for stops in (0.0, 1.0):
        lamp.stops = stops
        path = api.render(tmp_path / f"{stops}.exr", samples=4)
        brightness.append(read_pixels(path).mean())
    assert brightness[1] == pytest.approx(2.0 * brightness[0], rel=0.01) and brightness[0] > 0.0
    part = next(part for part in api.materials() if part.name == "cube" or api.blender_materials(part))
    part.roughness_offset = -0.2
    assert part.roughness_offset == pytest.approx(-0.2)
    assert api.export(tmp_path / "room.glb") is not None and (tmp_path / "room.glb").stat().st_size > 0
    for wrong in (
        lambda: api.render(tmp_path / "a.png"),
        lambda: api.import_capture(tmp_path / "nothing"),
        lambda: api.import_capture(tmp_path, options={"no_such": 1}),
        lambda: api.estimate(preset="best"),
        lambda: api.estimate(settings={"no_such": 1}),
        lambda: api.use_version("no such"),
    ):
        assert error_of(wrong).remedy
