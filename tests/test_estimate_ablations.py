# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's ablations: the effect of each option, and the disturbed mesh."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import accuracy, disturb
from fipt_blender.core.estimate.input import spread_views
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from samples.small_captures import (
    COLORS,
    PANEL_TRIANGLES,
    SmallCapture,
    panel_capture,
    run_here,
    write_run,
)
from samples.small_rooms import BOX, surface_points

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


def test_fewer_views_are_spread_over_the_capture() -> None:
    views = list("abcdefghij")
    assert spread_views(views, 1.0) == views
    assert spread_views(views, 0.3) == ["a", "d", "g"]
    assert spread_views(views, 1e-3) == ["a"]
    with pytest.raises(FiptError, match="at most 1"):
        make_settings("draft", {"view_share": 1.5})


def closed(triangles: np.ndarray) -> bool:
    """Whether each edge has a triangle on both sides."""
    edges = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    return sorted(map(tuple, edges)) == sorted(map(tuple, edges[:, ::-1]))


def test_a_disturbed_box_stays_closed_and_moves_by_sigma(tmp_path: Path) -> None:
    lines = [f"v {x} {y} {z}" for quad in BOX for x, y, z in quad]
    lines += [f"f {i + 1}/1 {i + 2} {i + 3}//2 {i + 4}" for i in range(0, 24, 4)]
    (tmp_path / "scene.obj").write_text("\n".join(lines))
    vertices, triangles = disturb.read_obj(tmp_path / "scene.obj")
    assert vertices.shape == (24, 3) and triangles.shape == (12, 3)
    same, welded = disturb.disturb(vertices, triangles, 0.0, 0)
    assert len(same) == 8 and closed(welded)
    disturb.disturb_obj(tmp_path / "scene.obj", tmp_path / "noise.obj", 0.02)
    moved, finer = disturb.read_obj(tmp_path / "noise.obj")
    assert closed(finer) and len(finer) > 1000
    corners = moved[finer]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    assert edges.max() < 1.5 * disturb.BUMP_WIDTH * 0.02
    floor = moved[(np.abs(moved[:, 2]) < 0.2) & (np.abs(moved[:, :2]) < 1.8).all(axis=1), 2]
    assert 0.015 < floor.std() < 0.025 and abs(floor.mean()) < 0.01
    # Smooth normals follow the bumps: off by some degrees on the floor.
    normals = disturb.smooth_normals(moved, finer)
    inner = (np.abs(moved[:, 2]) < 0.2) & (np.abs(moved[:, :2]) < 1.5).all(axis=1)
    assert 2.0 < np.degrees(np.arccos(np.abs(normals[inner, 2]))).mean() < 15.0


def test_only_an_obj_can_be_disturbed(tmp_path: Path) -> None:
    parsed = accuracy.make_parser().parse_args([str(tmp_path), "--mesh-noise", "0.01"])
    with pytest.raises(FiptError, match=r"scene\.obj"):
        accuracy.main_job_options(parsed, tmp_path / "run")
    (tmp_path / "scene.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    options = accuracy.main_job_options(parsed, tmp_path / "run")
    assert options[-2] == "--mesh" and Path(options[-1]).read_text().startswith("o disturbed")


def test_semantic_masks_instead_of_parts(capture: SmallCapture, tmp_path: Path) -> None:
    """Classes of several materials, here the two halves of each picture, have no closed-form guess."""
    room = replace(capture.room, parts="semantics")
    run = write_run(tmp_path / "run", replace(capture, room=room), rounds=0)
    classes = np.repeat([[3] * 24 + [9] * 24], 32, axis=0).astype(np.uint8)
    Image.fromarray(classes).save(run.images / "classes.png")
    data = json.loads(run.capture_json.read_text())
    for view in data["views"]:
        view["semantics"] = "images/classes.png"
    run.capture_json.write_text(json.dumps(data))
    run_here(run)
    (lamp,) = json.loads(run.emitters_json.read_text())["fixtures"]
    assert lamp["triangles"] == PANEL_TRIANGLES
    assert json.loads(run.statistics_json.read_text())["part_kind"] == "semantic"
