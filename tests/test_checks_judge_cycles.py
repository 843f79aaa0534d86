"""The judge renders what Blender is handed over: its figure is that of Cycles' renders of the applied results."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender.blend import outliner
from fipt_blender.blend.capture.cameras import add_camera, find_camera
from fipt_blender.blend.pictures.cycles import RenderOptions, render_exr
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.checks.quality import Display, judge
from fipt_blender.core.checks.rerender import Estimate, Renderer
from fipt_blender.core.estimate.results import write_results
from fipt_blender.core.light.emitters import Fixture
from fipt_blender.core.light.environment import Environment
from fipt_blender.core.optics.brdf import set_masking
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.pixels.store import create_pixels, fill_pixels, trace_view
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.result_contents import MissingLamp
from fipt_blender.core.run.run_files import read_capture
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.surface.room import load_room
from samples.applied_rooms import use_fake_engine
from samples.at_once import export_room
from samples.camera_poses import look_at
from samples.small_captures import CAMERAS, COLORS, PANEL, PANEL_RADIANCE, PANEL_TRIANGLES, pinhole
from samples.small_rooms import BOX

pytestmark = pytest.mark.usefixtures("registered")

SCALE = 0.5  # the captures' median radiance
AGREE = 0.5  # dB
FLOOR_LAMP = MissingLamp((0.9, 0.8, 0.9), 0.2, (9.0, 8.0, 6.0), True)
# Before the first camera's lens, facing the room.
DISC = MissingLamp((0.0, -2.6, 1.5), 0.9, (6.0, 6.5, 7.0), True, (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class Surfaces:
    """Base colours (Q, 3) and roughness of quadrilaterals, as the estimate that is judged and baked."""

    colors: np.ndarray
    roughness: float

    def query(self, positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(triangles)
        return self.colors[np.asarray(triangles) // 2], np.full(count, self.roughness), np.zeros(count)

    def confidence(self, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        return np.ones((len(triangles), 3))

    def save(self, run: RunFolder) -> None:
        run.fields_npz.write_bytes(b"estimated")


def sky() -> np.ndarray:
    """(8, 16, 3) an environment that is brighter on one side."""
    across = np.linspace(0.2, 2.0, 16, dtype=np.float32)
    return np.broadcast_to(across[None, :, None] * np.array([0.8, 0.9, 1.0], np.float32), (8, 16, 3)).copy()


def outside(image: np.ndarray, *lamps: dict) -> Environment:
    return Environment(image, 0.3, np.ones(image.shape[:2], bool), lamps=lamps)


PANEL_LIGHT = [
    Fixture(np.array(PANEL_TRIANGLES), np.array(PANEL_RADIANCE), np.zeros(3), 1.96, np.array([0, 0, 2.9]), 0.6)
]
FROM_OUTSIDE = [
    [[0.0, -4.0, 1.5], [0.1, 2.0, 1.2]],
    [[1.0, -3.6, 2.2], [-0.4, 2.0, 0.6]],
    [[-1.2, -3.8, 1.0], [0, 2, 1]],
]
CAPTURES = {
    "lamp of the mesh": ([*BOX, PANEL], PANEL_LIGHT, None, CAMERAS[:3], 1.0),
    "inferred lamp in the picture": (BOX, [], outside(np.zeros((8, 16, 3), np.float32), FLOOR_LAMP), CAMERAS[:3], 0.35),
    "cameras outside of the mesh": ([BOX[0], BOX[2], BOX[3]], [], outside(sky(), DISC), FROM_OUTSIDE, 0.6),
}


def write_capture(run: RunFolder, cameras: list) -> list[View]:
    """capture.json of black photographs, of which the first is held back."""
    views = []
    for index, camera in enumerate(cameras):
        lens = vars(pinhole(look_at(*camera)))
        write_exr(run.images / f"{index}.exr", np.zeros((lens["height"], lens["width"], 3), np.float32))
        lens["camera_to_world"] = lens["camera_to_world"].tolist()
        split = "train" if index else "held_back"
        names = {"name": str(index), "split": split, "image": f"images/{index}.exr", "parts": None, "semantics": None}
        views.append({**lens, **names})
    head = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    run.capture_json.write_text(json.dumps({**head, "world_from_source": np.eye(4).tolist(), "views": views}))
    capture = load_capture(run)
    return [*capture.held_back, *capture.train]


@pytest.mark.parametrize("name", CAPTURES)
def test_the_judge_and_cycles_agree(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quads, fixtures, environment, cameras, roughness = CAPTURES[name]
    run = RunFolder(tmp_path / "run")
    run.create(make_settings("draft"))
    set_masking(run.read().masking)
    held_back, *training = write_capture(run, cameras)
    items = []
    for index, quad in enumerate(quads):
        mesh = bpy.data.meshes.new(f"wall {index}")
        mesh.from_pydata(quad, [], [(0, 1, 2, 3)])
        items.append(bpy.data.objects.new(mesh.name, mesh))
        outliner.collection(bpy.context.scene, outliner.ROOM).objects.link(items[-1])
    bpy.context.view_layer.update()
    export_room(items, run)
    room = load_room(run)
    true = Surfaces(np.array([*COLORS, [0.5] * 3])[: len(quads)], roughness)
    wrong = replace(true, colors=true.colors * np.array([0.6, 0.8, 1.1]))

    # The photographs are of the true surfaces, the results have the wrong ones.
    table = EmitterTable.from_fixtures(fixtures)
    truth = Renderer(Estimate(room, true.query, table, environment), 1)
    for number, view in enumerate((held_back, *training)):
        write_exr(view.image, truth.render(view, number) * SCALE)
    pixels = create_pixels(tmp_path / "pixels", training)
    fill_pixels(pixels, room, lambda done: None)
    quality = judge(pixels, [held_back], Estimate(room, wrong.query, table, environment), {}, SCALE, 0)
    assert quality is not None

    write_results(run, wrong, fixtures, environment, SCALE, Reporter(io.StringIO()))  # type: ignore[arg-type]
    write_json(run.statistics_json, {"radiance_scale": SCALE})
    use_fake_engine(monkeypatch, wrong)
    scene = bpy.context.scene
    scene.fipt.run_folder = str(run.root)
    scene.fipt.materials.texel_density = 8.0
    for view in read_capture(run.capture_json).views:
        add_camera(scene, run, view, photograph=False)
    assert bpy.ops.fipt.apply_results() == {"FINISHED"}
    camera = find_camera(held_back.name, scene)
    render_exr(scene, tmp_path / "cycles.exr", RenderOptions(64), camera)
    cycles = read_radiance(tmp_path / "cycles.exr") / SCALE
    photograph, render, _ = quality.views[0].pictures
    display = Display()
    shown = display.shown(cycles, held_back, display.factor(photograph, cycles, held_back))
    assert quality.held_back_db == pytest.approx(psnr(shown - photograph), abs=AGREE)
    assert 12.0 < quality.held_back_db < 35.0, "the surfaces are wrong, and no more"
    on_mesh = trace_view(room, held_back).triangle.reshape(photograph.shape[:2]) >= 0
    assert quality.on_mesh_share == pytest.approx(on_mesh.mean())
    assert quality.on_mesh_db == pytest.approx(psnr((render - photograph)[on_mesh]), abs=0.2)  # with its noise
    assert on_mesh.all() != (name == "cameras outside of the mesh")


def psnr(error: np.ndarray) -> float:
    return float(-10.0 * np.log10((error**2).mean()))
