"""The report on prepared photographs: complete, after reading alone, with hostile names."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.rig import Lens, Rig, RigView
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.prepare.command import STEPS, run_steps
from fipt_blender.prepare.lens import FULL_FRAME_DIAGONAL
from fipt_blender.prepare.preparation import PreparationFolder
from fipt_blender.prepare.report import make_plan, write_report
from samples import textured_room
from samples.camera_poses import look_at
from samples.pages import Page
from samples.photographs import exif, write_jpeg
from samples.prepared_captures import make_preparation, prepare, write_prepared
from samples.refusals import error_of
from samples.textured_room import FOCAL, HEIGHT, WIDTH

NASTY = "it's & é #1"


@pytest.fixture
def folder(tmp_path) -> PreparationFolder:
    return PreparationFolder(tmp_path / "kitchen & <b>co")


def test_the_page_shows_what_each_step_has_found(folder, tmp_path):
    preparation = make_preparation(tmp_path / "card", (NASTY, "IMG_4", "IMG_7"))
    write_prepared(folder, preparation)
    fractions = []
    page = Page(write_report(folder, preparation, fractions.append))
    assert fractions == sorted(fractions) and 0.0 < fractions[-1] <= 1.0
    assert NASTY in page.text and "kitchen & <b>co" in page.text
    for words in ("6 photographs in 2 groups", "1 of 2", "0.60 px", "1/100 s, 1/25 s, 1/6 s", "4.17 %", "not used"):
        assert words in " ".join(page.text.split()).replace("6photographs", "6 photographs"), words
    assert "1 of 2 views has no camera." in page.text and "It shares too few points." in page.text
    assert "2 %" in page.text  # of the response
    assert len(page.values("src")) == 2  # the single photograph is not used
    colors = np.asarray(Image.open(folder.report / page.values("src")[0]), np.float64)
    assert colors.shape == (16, 24, 3)
    corner, other = colors[1:3, 1:3].mean((0, 1)), colors[8:, 8:].mean((0, 1))
    assert corner[1] < 60 < 200 < corner[0] and abs(other[0] - other[1]) < 60


def test_the_page_is_written_although_a_step_fails(folder, tmp_path, monkeypatch):
    class Fails:
        @staticmethod
        def key(folder, preparation):
            return None

        @staticmethod
        def run(folder, preparation, reporter):
            raise FiptError.of("solve-few", "Two views are too few.", "Take more photographs.")

    monkeypatch.setitem(sys.modules, "fipt_blender.prepare.solve_step", Fails)
    preparation = make_preparation(tmp_path / "card")
    write_prepared(folder, preparation)
    write_json(folder.facts("report"), {"key": "of an earlier run", "messages": []})
    assert error_of(run_steps, folder, ["solve", "report"], Reporter()).code == "solve-few"
    page = Page(folder.report / "index.html")
    assert "Two views are too few." in page.text and "Take more photographs." in page.text
    assert len(page.values("src")) == 2 and not folder.facts("report").exists()
    assert not folder.facts("solve").exists()  # nor does the page show the cameras of an earlier run
    assert "views with a camera" not in page.text


def camera(name: str, place: tuple[float, float, float], forward: tuple[float, float, float]) -> RigView:
    """A view whose third axis is `forward`."""
    pose = np.eye(4)
    pose[:3, 2], pose[:3, 3] = forward, place
    return RigView(name, None, Path(name), 4, 4, Lens("PINHOLE", (1.0, 1.0, 2.0, 2.0)), pose)


def test_plan_shows_cameras_from_above():
    views = (camera("a", (0, 0, 1), (1, 0, 0)), camera("b", (4, 2, 3), (0, 1, 0)))
    plan = make_plan(Rig("colmap", views, None, None))
    (_, first, first_tip), (_, second, second_tip) = plan.arrows
    assert second[0] - first[0] == pytest.approx(2.0 * (first[1] - second[1]))  # Y points up on the page
    assert first_tip[0] > first[0] and first_tip[1] == pytest.approx(first[1])
    assert second_tip[1] < second[1] and second_tip[0] == pytest.approx(second[0])
    assert plan.length == 1.0 and plan.bar == pytest.approx((second[0] - first[0]) / 4.0)
    assert plan.height < plan.width
    assert make_plan(Rig("colmap", (), None, None)) is None


SHUTTERS = (1 / 125, 1 / 30)
VIEWS = 5


def poses() -> list[np.ndarray]:
    steps = np.linspace(-0.8, 0.8, VIEWS)
    return [
        look_at(
            np.array([2.0 + 1.1 * np.sin(step), 0.9, 1.2 + 0.2 * np.cos(4.0 * step)]),
            np.array([1.8 + 0.3 * step, 3.0, 1.1]),
        )
        for step in steps
    ]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> tuple[PreparationFolder, Reporter]:
    root = tmp_path_factory.mktemp("brackets")
    walls = textured_room.wall_textures(1)
    equivalent = round(FOCAL * FULL_FRAME_DIAGONAL / float(np.hypot(WIDTH, HEIGHT)))
    for number, pose in enumerate(poses()):
        radiance = textured_room.photograph(pose, walls)
        for index, shutter in enumerate(SHUTTERS):
            tags = exif(shutter, seconds=60.0 * number + index)
            tags.get_ifd(0x8769)[0xA405] = equivalent
            pixels = np.round(255.0 * srgb_encoded(np.clip(radiance * shutter / SHUTTERS[1], 0.0, 1.0)))
            write_jpeg(root / "card" / f"P{number}{index}.jpg", pixels.astype(np.uint8), tags)
    folder = PreparationFolder(root / "capture")
    settings = ("scale=mesh", "scale_matrix=1 0 0 0 0 1 0 0 0 0 1 0", "response=srgb", "align=false")
    return folder, prepare(root / "card", folder.root, ",".join(STEPS), *settings)


def test_every_step_leaves_its_facts(prepared: tuple[PreparationFolder, Reporter]) -> None:
    folder, reporter = prepared
    assert all(folder.facts(step).is_file() for step in STEPS)
    assert (folder.report / "index.html").is_file()
    found = json.loads(folder.facts("solve").read_text(encoding="utf-8"))
    assert len(found["registered"]) == VIEWS and found["reprojection_error"] < 1.0
    assert not {"solve-left-out", "solve-split"} & {item["code"] for item in reporter.warnings}


def test_ingest_takes_the_capture(prepared: tuple[PreparationFolder, Reporter], tmp_path: Path) -> None:
    folder, _ = prepared
    reporter = Reporter()
    ingest(folder.root, RunFolder(tmp_path / "run"), CaptureOptions(hold_back=0, up_axis="z"), reporter)
    capture = json.loads((tmp_path / "run" / "capture.json").read_text(encoding="utf-8"))
    assert capture["source"] == "colmap" and len(capture["views"]) == VIEWS
    found = np.array([view["camera_to_world"] for view in capture["views"]])[:, :3, 3]
    true = np.array([pose[:3, 3] for pose in poses()])
    lengths = [np.linalg.norm(places[1:] - places[0], axis=1) for places in (found, true)]
    ratios = lengths[0] / lengths[1]
    assert np.abs(ratios / np.median(ratios) - 1.0).max() < 0.03
