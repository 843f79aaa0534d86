# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From JPEG brackets to a capture that `ingest` takes: all steps of `prepare` together."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.photographs import command
from fipt_blender.core.photographs.lens import FULL_FRAME_DIAGONAL
from fipt_blender.core.photographs.preparation import PreparationFolder
from fipt_blender.core.photographs.steps import STEPS
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder
from samples import textured_room
from samples.camera_poses import look_at
from samples.photographs import exif, write_jpeg
from samples.textured_room import FOCAL, HEIGHT, WIDTH

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


def srgb(values: np.ndarray) -> np.ndarray:
    encoded = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1.0 / 2.4) - 0.055)
    return np.round(255.0 * encoded).astype(np.uint8)


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
            pixels = srgb(np.clip(radiance * shutter / SHUTTERS[1], 0.0, 1.0))
            write_jpeg(root / "card" / f"P{number}{index}.jpg", pixels, tags)
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    settings = ["scale=mesh", "scale_matrix=1 0 0 0 0 1 0 0 0 0 1 0", "response=srgb", "align=false"]
    options = [word for setting in settings for word in ("--set", setting)]
    reporter = Reporter()
    folder = PreparationFolder(root / "capture")
    command.run(parser.parse_args([str(root / "card"), str(folder.root), *options]), reporter)
    return folder, reporter


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


def test_the_images_hold_radiance_on_one_scale(prepared: tuple[PreparationFolder, Reporter]) -> None:
    folder, _ = prepared
    walls = textured_room.wall_textures(1)
    ratios = []
    for image, pose in zip(sorted(folder.images.iterdir()), poses(), strict=True):
        ratio = read_radiance(image)[..., 1] / textured_room.photograph(pose, walls)[..., 1]
        ratios.append(float(np.median(ratio)))
        assert np.median(np.abs(ratio / ratios[-1] - 1.0)) < 0.03
    assert np.ptp(ratios) < 0.02 * np.mean(ratios)
