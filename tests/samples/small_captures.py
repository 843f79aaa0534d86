"""A lit box and its photographs as a run folder, made in a second: input for tests of full estimations."""

import argparse
import io
import json
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest

from benchmarks.tracer.environment import EnvironmentLight
from benchmarks.tracer.forward import LitRoom, RenderSettings, render_view
from benchmarks.tracer.surfaces import TriangleMaterials
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.estimate import command, training_stages
from fipt_blender.core.light import source_cells, unseen_light
from fipt_blender.core.material import training
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.run.contents import CapturedView, CapturedViews
from fipt_blender.core.run.kinds import as_matrix
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.surface.room import Room
from samples.camera_poses import look_at
from samples.small_rooms import BOX, area_lights, make_room, table, write_room

WIDTH, HEIGHT = 48, 32
PANEL = [[-0.7, -0.7, 2.9], [-0.7, 0.7, 2.9], [0.7, 0.7, 2.9], [0.7, -0.7, 2.9]]
PANEL_TRIANGLES = [12, 13]
PANEL_RADIANCE = [6.0, 5.0, 4.0]
# floor, ceiling, back, left, right, front
COLORS = [[0.5, 0.35, 0.2], [0.8, 0.8, 0.8], [0.6, 0.6, 0.7], [0.7, 0.2, 0.15], [0.2, 0.6, 0.25], [0.5, 0.5, 0.5]]
CAMERAS = [  # from, to
    [[-1.5, -1.6, 1.7], [1.0, 1.2, 1.0]],
    [[1.5, -1.5, 1.2], [-1.0, 1.0, 2.2]],
    [[1.4, 1.6, 1.6], [-1.2, -1.2, 0.6]],
    [[-1.5, 1.5, 1.0], [0.8, -0.8, 2.4]],
    [[0.0, -1.7, 2.4], [0.2, 1.2, 0.0]],
    [[-1.6, 0.0, 0.6], [1.2, 0.3, 2.4]],
]
# Every stage, in a few seconds.
QUICK = {
    "device": "auto", "rounds": 1, "voxel_resolution": 64, "roughness_levels": 4, "diffuse_spp": 16,
    "specular_spp": 4, "light_spp": 16, "refine_diffuse_spp": 16, "refine_specular_spp": 4,
    "refine_light_spp": 16, "training_steps": 60, "checkpoint_steps": 25,
    "batch_size": 1024, "hash_levels": 6, "hash_log2_size": 12,
    "environment_width": 64, "unseen_light": False,
}  # fmt: skip
# Where the noise of the baked light is not looked at.
FEW = {"diffuse_spp": 4, "light_spp": 4, "refine_diffuse_spp": 4, "refine_light_spp": 4, "voxel_resolution": 32}
# With `run_here(run, train=False)`, where what the networks learn is not looked at.
UNTRAINED = {"training_steps": 6}


@dataclass(frozen=True)
class SmallCapture:
    """A room and what its cameras see: images (H, W, 3) of `scale` times the usual size, and poses (4, 4)."""

    room: Room
    images: list[np.ndarray]
    poses: list[np.ndarray]
    scale: int = 1

    def scaled(self, length: float, radiance: float, shift: tuple[float, ...] = (0.0,) * 3) -> "SmallCapture":
        """The same capture in other units and shifted (`shift` in the new units)."""
        poses = [pose.copy() for pose in self.poses]
        for pose in poses:
            pose[:3, 3] = pose[:3, 3] * length + shift
        vertices = (self.room.vertices * np.float64(length) + shift).astype(np.float32)
        images = [image * np.float32(radiance) for image in self.images]
        return replace(self, room=replace(self.room, vertices=vertices), images=images, poses=poses)


def pinhole(pose: np.ndarray, scale: int = 1) -> SimpleNamespace:
    width, height, focal = WIDTH * scale, HEIGHT * scale, 26.0 * scale
    return SimpleNamespace(
        width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2, camera_to_world=pose
    )


def photograph(quads: list, colors: list, lamps: EmitterTable, outside: np.ndarray | None) -> SmallCapture:
    """Path-traced images of a room of matt quadrilaterals."""
    room = make_room(quads, parts="objects", objects=np.arange(len(quads)))
    environment = None if outside is None else EnvironmentLight(outside)
    return photograph_room(room, matt(np.repeat(np.array(colors), 2, axis=0)), lamps, environment)


def matt(colors: np.ndarray) -> TriangleMaterials:
    """Diffuse materials of base colours (T, 3)."""
    return TriangleMaterials(np.asarray(colors, float), np.ones(len(colors)), np.zeros(len(colors)))


def photograph_room(
    room: Room,
    materials: TriangleMaterials,
    lamps: EmitterTable,
    environment: EnvironmentLight | None = None,
    cameras: list | None = None,
    scale: int = 1,
    spp: int = 256,
    denoise: bool = False,
) -> SmallCapture:
    """Path-traced images of any room."""
    lit = LitRoom(room, materials, area_lights(room, lamps), environment)
    poses = [look_at(*camera) for camera in cameras or CAMERAS]
    settings = RenderSettings(spp=spp, depth=10, denoise=denoise)
    images = [render_view(lit, pinhole(pose, scale), settings, stream) for stream, pose in enumerate(poses)]
    return SmallCapture(room, images, poses, scale)


@cache
def panel_capture() -> SmallCapture:
    """A closed box, each wall of its own colour, and a ceiling panel; nobody changes its arrays."""
    return photograph([*BOX, PANEL], [*COLORS, [0.0] * 3], table(PANEL_TRIANGLES, PANEL_RADIANCE), None)


def some_views(capture: SmallCapture, count: int = 4) -> SmallCapture:
    """The first of its views, where all would only take more time."""
    return replace(capture, images=capture.images[:count], poses=capture.poses[:count])


def window_capture(radiance: list[float]) -> SmallCapture:
    """The box without its right wall, lit from outside by constant radiance."""
    quads = [quad for index, quad in enumerate(BOX) if index != 4]
    colors = [color for index, color in enumerate(COLORS) if index != 4]
    outside = np.tile(np.array(radiance, np.float32), (8, 16, 1))
    return photograph(quads, colors, EmitterTable.empty(), outside)


def write_run(root: Path, capture: SmallCapture, **changes) -> RunFolder:
    """The run folder that import and ingest would have made."""
    run = RunFolder(root)
    run.create(make_settings("draft", {**QUICK, **changes}))
    views = []
    for index, (image, pose) in enumerate(zip(capture.images, capture.poses, strict=True)):
        path = run.images / f"{index:03d}.exr"
        write_exr(path, image)
        view = vars(pinhole(pose, capture.scale)) | {"camera_to_world": pose.tolist()}
        views.append(
            view
            | {"name": f"train/{index:03d}", "split": "train", "image": f"images/{path.name}"}
            | {"parts": None, "semantics": None}
        )
    head = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    run.capture_json.write_text(json.dumps({**head, "world_from_source": np.eye(4).tolist(), "views": views}))
    write_room(run.root, capture.room)
    return run


def write_views(run: RunFolder, views: list[View]) -> None:
    """Write capture.json."""
    names = {item.name for item in fields(CapturedView)}
    listed = []
    for view in views:
        files = {
            kind: path and str(path)
            for kind in ("image", "parts", "semantics", "mask")
            for path in [getattr(view, kind)]
        }
        given = {name: value for name, value in vars(view).items() if name in names}
        listed.append(CapturedView(**{**given, **files, "camera_to_world": as_matrix(view.camera_to_world)}))
    write_json(run.capture_json, CapturedViews("test", as_matrix(np.eye(4)), None, tuple(listed)))


def run_here(run: RunFolder, train: bool = True) -> list[dict]:
    """Estimate in this process, with few steps towards the closed form or hardly any; returns its messages."""
    stream = io.StringIO()
    steps = 80 if train else 4
    with ExitStack() as patches:
        for module in (training, training_stages):
            patches.enter_context(patch.object(module, "PRETRAINING_STEPS", steps))
        command.run(argparse.Namespace(run=run.root, cluster=None, anew=False), Reporter(stream))
    return [message for line in stream.getvalue().splitlines() if (message := parse_message(line))]


def few_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unseen light of fewer sources, compared at fewer points: on their numbers the time depends most."""
    monkeypatch.setattr(unseen_light, "MAX_SOURCES", 100)
    monkeypatch.setattr(source_cells, "MAX_DIVIDED", 100)
    monkeypatch.setattr(unseen_light, "MAX_POINTS", 2000)


def stages_of(messages: list[dict]) -> list[str]:
    """The stages that were done."""
    return [message["name"] for message in messages if message["type"] == "stage"]


def warnings_of(messages: list[dict]) -> list[str]:
    """The codes of all warnings."""
    return [message["code"] for message in messages if message["type"] == "warning"]


def fixtures_of(run: RunFolder) -> list[dict]:
    return json.loads(run.emitters_json.read_text())["fixtures"]


def outcome(run: RunFolder) -> dict[str, bytes]:
    """The results, bit for bit."""
    with np.load(run.fields_npz, allow_pickle=False) as data:
        found = {name: data[name].tobytes() for name in data.files}
    return found | {"emitters": run.emitters_json.read_bytes()}
