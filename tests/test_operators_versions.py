"""The panel Versions and the Python API, on a room with two estimates."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender import api
from fipt_blender.blend.pictures.image_files import read_pixels
from fipt_blender.core.run import versions
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.textures import bake
from fipt_blender.jobs import run_job, running, runstate
from samples.applied_rooms import ConstantFields, make_scene
from samples.operator_calls import refused
from samples.refusals import error_of

ops = bpy.ops.fipt
pytestmark = pytest.mark.usefixtures("registered")


def write_estimate(run: RunFolder, gray: float, key: str, hinted: str = "") -> None:
    """Results whose base colour is gray, as an engine writes them."""
    keys = {"training": key, **({"hinted-training": hinted} if hinted else {})}
    write_json(run.stages_json, {"keys": keys, "stages": {k: {} for k in keys}, "warnings": {}, "values": {}})
    run.fields_npz.write_text(str(gray))
    shutil.copy(run.stages_json, run.results)


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
            made = bake.textures_made(run)
            if step.command[0] == "textures":
                if made.kept() is None:
                    done.append("textures")
                    with made.making():
                        bake.bake(run, GrayFields(run))
            else:
                done.append("estimate")
                write_estimate(run, 0.75, "light", hinted="told")

        return replace(step, command=None, function=work) if step.command else step

    def open_job(run, steps, *_, **options):
        return real(run, [fake(step, run) for step in steps], run_job.Launch(Path(sys.executable), {}), **options)

    monkeypatch.setattr(run_job, "open_job", open_job)
    monkeypatch.setattr(run_job, "find_launch", lambda *_: None)
    return done


@pytest.fixture
def scene(tmp_path, works) -> bpy.types.Scene:
    """An artist's room with two estimates, of which the last one is applied."""
    scene = make_scene(tmp_path / "run", environment=False)
    first = RunFolder(scene.fipt.run_folder)
    first.ingest_json.write_text("{}")
    second = RunFolder(shutil.copytree(first.root, tmp_path / "second"))
    for run, gray, key in ((first, 0.25, "first"), (second, 0.5, "light")):
        scene.fipt.run_folder = str(run.root)
        write_estimate(run, gray, key)
        api.apply()
    works.clear()
    return scene


def shown(scene: bpy.types.Scene) -> float:
    """The base colour of the room's first texture."""
    material = bpy.data.objects["cube"].data.materials[0]
    image = material.node_tree.nodes["FIPT Base Color"].image
    return float(np.median(np.array(image.pixels[:]).reshape(-1, 4)[:, 0]))


def test_another_version_is_applied_without_baking_it_again(scene, works):
    newest, oldest = api.versions()
    assert newest.current and shown(scene) == pytest.approx(0.5, abs=1e-3)
    for version, gray in ((oldest, 0.25), (newest, 0.5)):
        assert ops.use_version(version=version.folder.name) == {"FINISHED"}
        assert shown(scene) == pytest.approx(gray, abs=1e-3) and works == []
        assert Path(scene.fipt.run_folder) == version.folder
        state = runstate.look(RunFolder(version.folder))
        assert state.finished and len(state.versions) == 2


def test_undo_and_a_reloaded_file_have_the_run_that_they_show(scene, tmp_path):
    newest, oldest = api.versions()
    bpy.ops.ed.undo_push(message="before")
    ops.use_version(version=oldest.folder.name)
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert Path(bpy.context.scene.fipt.run_folder) == newest.folder
    assert shown(bpy.context.scene) == pytest.approx(0.5, abs=1e-3)
    bpy.ops.ed.redo()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert Path(bpy.context.scene.fipt.run_folder) == oldest.folder
    assert shown(bpy.context.scene) == pytest.approx(0.25, abs=1e-3)


def test_other_versions_are_deleted_but_not_the_one_of_a_scene(scene):
    newest, oldest = api.versions()
    other = bpy.data.scenes.new("other")
    other.fipt.run_folder = str(oldest.folder)
    assert "Apply another one first" in refused(ops.delete_version, version=newest.folder.name)
    assert "Apply another one first" in refused(ops.delete_version, version=oldest.folder.name)
    other.fipt.run_folder = ""
    assert ops.delete_version(version=oldest.folder.name) == {"FINISHED"} and not oldest.folder.exists()
    assert [version.folder for version in api.versions()] == [newest.folder]
    assert "no estimate" in refused(ops.use_version, version=oldest.folder.name)
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
    assert scene.fipt.materials.applied_version == versions.results_id(run) and len(api.versions()) == 2
    assert ops.apply_results() == {"FINISHED"} and works == ["estimate", "textures"]  # nothing is baked again
    assert ops.reestimate.poll()


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
