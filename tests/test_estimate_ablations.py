# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's ablations: the effect of each option."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.run.runfolder import RunFolder
from samples.small_captures import COLORS, PANEL_TRIANGLES, UNTRAINED, SmallCapture, panel_capture, run_here, write_run
from samples.small_rooms import surface_points

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    return panel_capture()


def finished(root: Path, capture: SmallCapture, **changes) -> tuple[RunFolder, list[dict]]:
    run = write_run(root / "run", capture, **changes)
    run_here(run)
    return run, json.loads(run.emitters_json.read_text())["fixtures"]


def wall_error(run: RunFolder, capture: SmallCapture) -> float:
    """Mean absolute error of kd over the box."""
    points, _, triangle = surface_points(capture.room, 100, np.random.default_rng(0), np.arange(12))
    color, _, metallic = RoomFields.load(run).query(points, triangle)
    return float(np.abs(color * (1 - metallic[:, None]) - np.array(COLORS)[triangle // 2]).mean())


def test_paths_without_a_cache_still_find_materials(capture: SmallCapture, tmp_path: Path) -> None:
    run, (lamp,) = finished(tmp_path, capture, refine_cache=False)
    assert lamp["triangles"] == PANEL_TRIANGLES
    assert wall_error(run, capture) < 0.1


def test_semantic_masks_instead_of_parts(capture: SmallCapture, tmp_path: Path) -> None:
    """Classes of several materials, here the two halves of each picture, have no closed-form guess."""
    room = replace(capture.room, parts="semantics")
    run = write_run(tmp_path / "run", replace(capture, room=room), rounds=0, **UNTRAINED)
    classes = np.repeat([[3] * 24 + [9] * 24], 32, axis=0).astype(np.uint8)
    Image.fromarray(classes).save(run.images / "classes.png")
    data = json.loads(run.capture_json.read_text())
    for view in data["views"]:
        view["semantics"] = "images/classes.png"
    run.capture_json.write_text(json.dumps(data))
    run_here(run, train=False)
    (lamp,) = json.loads(run.emitters_json.read_text())["fixtures"]
    assert lamp["triangles"] == PANEL_TRIANGLES
    assert json.loads(run.statistics_json.read_text())["part_kind"] == "semantic"
