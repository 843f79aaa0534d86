"""The main job with a stand-in for the engine, and where it places the new light and the object."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils.bvhtree import BVHTree

import fipt_blender
from fipt_blender.blend.capture.view_geometry import ViewGeometry
from fipt_blender.blend.insert.support import choose_view, find_support
from fipt_blender.blend.lights.placement import find_light_place
from fipt_blender.bridge.interpreter import engine_environment
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.hints import Hint, read_hints, write_hints
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import main_job, run_job
from fipt_blender.jobs.main_job import make_main_job
from fipt_blender.jobs.options import MainJobOptions
from fipt_blender.jobs.room_steps import panel_state
from samples.camera_poses import look_at
from samples.engine_here import engine_here
from samples.refusals import error_of

ROOT = Path(main_job.__file__).resolve().parent.parent

# Writes the outputs of `estimate` and `textures` without computing anything.
STAND_IN = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv.pop(1))
import numpy as np
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder, write_json
command, run = sys.argv[1], RunFolder(sys.argv[2])
if command == "estimate":
    if "--anew" in sys.argv:
        for path in run.stage.iterdir():
            path.unlink()
    np.savez(run.fields_npz, base_color=np.zeros(3))
    fixture = {"name": "Fixture.001", "triangles": [0, 1], "radiance": [3.0, 3.0, 3.0]}
    fixture |= {"back_radiance": [0.0] * 3, "area": 20.0, "centroid": [0.0, 0.0, 2.5], "power": [9.0] * 3}
    write_json(run.emitters_json, {"fixtures": [fixture], "environment": None})
else:
    entries = []
    for image in read_document(run.atlas_json, dict)["images"]:
        entry = {"name": image["name"]}
        for key in ("base_color", "roughness", "metallic", "confidence"):
            path = run.textures / f"{image['name']}.{key}.exr"
            write_exr(path, np.full((8, 8, 3), 0.5, np.float32))
            entry[key] = str(path.relative_to(run.root))
        entries.append(entry)
    write_json(run.textures_json, {"images": entries})
print(json.dumps({"type": "done", "files": [], "data": {}}))
"""


COMMANDS = ["ingest", "estimate", "textures", "report"]
# Of a box; the first is the top.
FACES = [(4, 5, 7, 6), (0, 2, 3, 1), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def corners_of(low, high) -> list[list[float]]:
    return [[(low, high)[(i >> axis) & 1][axis] for axis in range(3)] for i in range(8)]


def box(low, high, name: str, offset: int) -> str:
    """A box as an OBJ object."""
    lines = [f"o {name}"] + ["v {} {} {}".format(*corner) for corner in corners_of(low, high)]
    lines += ["f " + " ".join(str(i + 1 + offset) for i in face) for face in FACES]
    return "\n".join(lines) + "\n"


@pytest.fixture
def capture(tmp_path) -> Path:
    """Four photographs (Z up) of a closed box with a crate on its floor."""
    folder = tmp_path / "capture"
    folder.mkdir()
    mesh = box((-2.0, -1.5, 0.0), (2.0, 1.5, 2.5), "walls", 0)
    (folder / "scene.obj").write_text(mesh + box((0.8, 0.5, 0.0), (1.4, 1.0, 0.7), "crate", 8))
    frames = []
    for index in range(4):
        write_exr(folder / f"{index}.exr", np.full((24, 32, 3), 0.2 + 0.1 * index, np.float32))
        pose = look_at(np.array([-1.6 + 0.2 * index, -1.2, 1.6]), np.array([0.2, 0.2, 0.4]))
        pose[:, 1:3] *= -1.0  # OpenGL axes
        frames.append({"file_path": f"{index}.exr", "transform_matrix": pose.tolist()})
    lens = {"w": 32, "h": 24, "fl_x": 24.0, "fl_y": 24.0, "cx": 16.0, "cy": 12.0}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return folder


class Ran(list):
    """The engine commands that were run; `failing` crashes."""

    failing = ""


@pytest.fixture
def engine(monkeypatch) -> Iterator[Ran]:
    """The engine with a stand-in for its long commands."""
    ran = Ran()
    real = run_job.engine_command

    def command(python, *arguments):
        ran.append(arguments[0])
        if arguments[0] == ran.failing:
            return [str(python), "-c", "import os; os.abort()"]
        if arguments[0] in ("estimate", "textures"):
            return [str(python), "-c", STAND_IN, str(ROOT), *arguments]
        return real(python, *arguments)

    launch = run_job.Launch(Path(sys.executable), engine_environment())
    monkeypatch.setattr(main_job, "find_launch", lambda explicit=None: launch)
    monkeypatch.setattr(run_job, "engine_command", command)
    with engine_here():
        yield ran


def run_main_job(options: MainJobOptions) -> list[dict]:
    messages: list[dict] = []
    job = make_main_job(options)
    with panel_state():
        job.run(messages.append)
    return messages


@pytest.fixture
def options(capture, tmp_path) -> MainJobOptions:
    settings = make_settings("draft", {"texture_size": 64})
    return MainJobOptions(
        capture=capture, output=tmp_path / "run", settings=settings, up_axis="z", hold_back=4, renders=False
    )


def panel_is_ready(options: MainJobOptions, blend: Path) -> None:
    """The file, opened with the add-on, shows views, lights and settings in the panel."""
    fipt_blender.register()
    try:
        bpy.ops.wm.open_mainfile(filepath=str(blend))
        state = bpy.context.scene.fipt
        assert Path(state.run_folder) == options.output and Path(state.capture.imported_path) == options.capture
        assert [(view.name, view.split) for view in state.capture.views] == [
            (view["name"], view["split"])
            for view in read_document(RunFolder(options.output).capture_json, dict)["views"]
        ]
        assert state.capture.train_count == 3 and state.capture.up_axis == "z" and state.capture.hold_back == 4
        assert [light.name for light in state.lights.lights] == ["Crate panel"]
        assert state.materials.object_count == 2 and state.materials.texture_size == "512"
        assert state.estimate.preset == "draft" and state.estimate.changes == ""
        assert not bpy.context.scene.camera.data.show_background_images, "the photograph hides no results"
        spaces = [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
        assert spaces and {space.region_3d.view_perspective for space in spaces} == {"CAMERA"}
        assert bpy.ops.fipt.revert() == {"FINISHED"} and bpy.ops.fipt.look_through(step=1) == {"FINISHED"}
    finally:
        fipt_blender.unregister()


def test_the_job_makes_a_blend_and_a_report_and_resumes(options, engine):
    messages = run_main_job(options)
    assert messages[-1]["type"] == "done", messages[-1]
    assert engine == COMMANDS
    files = [Path(name) for name in messages[-1]["data"] and messages[-1]["files"]]
    assert [path.name for path in files[:2]] == ["room.blend", "index.html"]
    assert all(path.is_file() for path in files)
    panel_is_ready(options, files[0])
    bpy.ops.wm.open_mainfile(filepath=str(files[0]))
    assert {"walls", "crate"} <= set(bpy.data.objects.keys())
    assert any("Crate panel" in name for name in bpy.data.objects.keys())
    assert sum(item.type == "CAMERA" for item in bpy.data.objects) == 4
    for image in bpy.data.images:
        if image.source == "FILE" and image.packed_file is None:
            assert image.filepath.startswith("//") and Path(bpy.path.abspath(image.filepath)).exists()

    run = RunFolder(options.output)

    def ran(again: MainJobOptions) -> list[str]:
        engine.clear()
        messages[:] = run_main_job(again)
        return engine

    def times() -> list[int]:
        return [path.stat().st_mtime_ns for path in (run.ingest_json, run.atlas_npz)]

    again, before = dataclasses.replace(options, resume=True), times()
    assert ran(again) == COMMANDS and messages[-1]["type"] == "done" and times() == before
    assert (run.root / "room_before.blend").is_file()
    finer = dataclasses.replace(again, settings=dataclasses.replace(options.settings, texel_density=64.0))
    assert ran(finer) == COMMANDS and times()[0] == before[0] and times()[1] > before[1]

    # An estimate that fails, resumed or begun anew, leaves the one before complete.
    checkpoint = run.stage / "checkpoint"
    checkpoint.touch()
    folders = run.results, run.textures, run.renders, run.report, run.root / "room.blend"
    paths = [path for folder in folders for path in (folder, *folder.rglob("*")) if path.is_file()]
    before = {path: path.read_bytes() for path in paths}
    assert {"room.blend", "fields.npz", "index.html"} <= {path.name for path in before}
    other = dataclasses.replace(finer, settings=dataclasses.replace(finer.settings, seed=5))
    for resume, failing in ((True, "estimate"), (True, "ingest"), (False, "ingest"), (False, "estimate")):
        (options.capture / "2.exr").touch()
        engine.failing = failing
        assert ran(dataclasses.replace(other, resume=resume))[-1] == failing
        assert messages[-1]["code"] == "engine-crashed"
        assert {path: path.read_bytes() for path in before} == before
    assert checkpoint.exists(), "of a resumed run the engine knows itself which still hold"
    engine.failing = ""
    assert ran(dataclasses.replace(other, resume=False)) == COMMANDS and messages[-1]["type"] == "done"
    assert not checkpoint.exists()


def code_of(options: MainJobOptions) -> str:
    return error_of(make_main_job, options).code


def test_wrong_paths_are_found_before_anything_is_written(options, engine, tmp_path):
    change = dataclasses.replace
    assert code_of(change(options, capture=tmp_path / "nowhere")) == "capture-missing"
    assert code_of(change(options, mesh=tmp_path / "nowhere.obj")) == "mesh-missing"
    assert code_of(change(options, output=options.capture)) == "output-inside-capture"
    assert code_of(change(options, output=options.capture / "0.exr")) == "run-foreign"
    assert not options.output.exists()
    foreign = tmp_path / "holiday"
    foreign.mkdir()
    (foreign / "photo.jpg").touch()
    assert code_of(change(options, output=foreign)) == "run-foreign"
    assert [path.name for path in foreign.iterdir()] == ["photo.jpg"]


def test_hints_of_a_file_go_to_the_run(options, engine, tmp_path):
    """A resumed run keeps its hints and takes those of an estimate again; a new run keeps neither."""
    change = dataclasses.replace
    assert code_of(change(options, hints=tmp_path / "nowhere.json")) == "hints-missing"
    (tmp_path / "bad.json").write_text("{}")
    assert code_of(change(options, hints=tmp_path / "bad.json")) == "file-damaged"
    assert not options.output.exists()
    files = [tmp_path / "one.json", tmp_path / "two.json"]
    hints = [[Hint(((0.0, 0.0, 0.0),), name, material="metal")] for name in ("one", "two")]
    for path, told in zip(files, hints, strict=True):
        write_hints(path, told)
    run = RunFolder(options.output)
    make_main_job(change(options, hints=files[0]))
    assert read_hints(run.hints_json) == hints[0] and not run.hints_again_json.exists()
    make_main_job(change(options, resume=True, hints_again=files[1]))
    assert read_hints(run.hints_json) == hints[0] and read_hints(run.hints_again_json) == hints[1]
    make_main_job(options)
    assert not run.hints_json.exists() and not run.hints_again_json.exists()


def test_a_capture_without_a_mesh_says_where_a_room_can_come_from(capture, engine, tmp_path) -> None:
    (capture / "scene.obj").unlink()
    last = run_main_job(MainJobOptions(capture=capture, output=tmp_path / "run"))[-1]
    assert (last["type"], last["code"]) == ("error", "mesh-missing") and "estimate" not in engine
    for remedy in ("--mesh", "depth images", "model the room"):
        assert remedy in last["remedy"]


def boxes(*bounds):
    """Ray casting against axis-aligned boxes, from inside or outside."""
    corners = [corner for low, high in bounds for corner in corners_of(low, high)]
    faces = [[i + 8 * box for i in face] for box in range(len(bounds)) for face in FACES]
    tree = BVHTree.FromPolygons(corners, faces)

    def cast(origin, direction):
        point, normal = tree.ray_cast(origin + 1e-6 * direction, direction)[:2]
        return None if point is None else (np.array(point), np.array(normal))

    return cast


ROOM = (np.array([-2.0, -1.5, 0.0]), np.array([2.0, 1.5, 2.5]))
VIEW = ViewGeometry(
    look_at(np.array([-1.8, -1.3, 1.6]), np.array([0.0, 0.0, 0.4])), 320, 240, 240.0, 240.0, 160.0, 120.0
)


def test_the_light_hangs_below_the_ceiling_in_the_middle_or_beside_a_lamp_that_hangs_there():
    for scale in (0.01, 1.0):
        low, high = ROOM[0] * scale, ROOM[1] * scale
        center, size = find_light_place(boxes((low, high)), low, high, 1.5 * scale)
        np.testing.assert_allclose(center[:2], 0.0, atol=1e-6 * scale)
        assert 2.3 * scale < center[2] < 2.5 * scale and size == pytest.approx(0.6 * scale)
    lamp = (np.array([-0.2, -0.2, 1.7]), np.array([0.2, 0.2, 2.0]))
    center, size = find_light_place(boxes(ROOM, lamp), *ROOM, 1.5)
    assert center[2] > 2.3
    assert 0.2 - 1e-6 < np.max(np.abs(center[:2])) - 0.5 * size < 1.5 - size


@pytest.mark.parametrize("scale", [0.01, 1.0])
def test_the_object_stands_on_free_floor_in_view(scale):
    crate = (np.array([-0.3, -0.3, 0.0]) * scale, np.array([0.3, 0.3, 0.6]) * scale)
    cast = boxes((ROOM[0] * scale, ROOM[1] * scale), crate)
    pose = VIEW.camera_to_world.copy()
    pose[:3, 3] *= scale
    support = find_support(cast, dataclasses.replace(VIEW, camera_to_world=pose))
    assert support is not None
    point, radius = support.point / scale, support.radius / scale
    assert abs(point[2]) < 1e-6 or abs(point[2] - 0.6) < 1e-6
    if point[2] < 0.3:  # clear of the crate
        assert np.max(np.abs(point[:2]) - 0.3) > radius
    pixel = np.linalg.inv(pose) @ np.append(support.point + [0, 0, support.radius], 1.0)
    u, v = 240.0 * pixel[0] / pixel[2] + 160.0, 240.0 * pixel[1] / pixel[2] + 120.0
    assert 0 < u < 320 and 0 < v < 240
    assert 240.0 * 2.0 * support.radius / pixel[2] == pytest.approx(0.18 * 240, rel=0.3)


def test_a_view_without_floor_is_not_chosen():
    wall = look_at(np.array([0.0, 0.0, 1.5]), np.array([2.0, 0.0, 2.4]))
    walls = dataclasses.replace(VIEW, camera_to_world=wall)
    cast = boxes(ROOM)
    assert find_support(cast, walls) is None
    assert choose_view(cast, [("walls", walls), ("floor", VIEW)])[0] == "floor"
    assert choose_view(cast, [("walls", walls)]) == ("walls", None)
