# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""benchmarks/ldr.py: captures of photographs that are not HDR, and how their runs are scored."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import ldr
from benchmarks.metrics import Maps
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.images import file_exposure, read_radiance
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import View
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.capture_files import level_pose, write_fipt_synthetic

RNG = np.random.default_rng(11)


@pytest.fixture
def source(tmp_path):
    poses = [level_pose(RNG, np.array([0.0, 1.0, 0.0])) for _ in range(3)]
    write_fipt_synthetic(tmp_path / "hdr", {"train": poses[:2], "val": poses[2:]})
    return tmp_path / "hdr"


def test_a_capture_is_readable_and_its_truth_apart(tmp_path, source):
    camera = ldr.make_capture(source, tmp_path / "out", seed=3, exif="rounded")
    rig = read_rig(tmp_path / "out", "auto", CaptureOptions())
    assert [view.image.suffix for view in rig.views] == [".jpg"] * 3
    assert all(view.image.is_file() for view in rig.views)
    truth = json.loads((tmp_path / "out" / ldr.TRUTH).read_text())
    assert (
        set(truth["views"]) == {view.name for view in rig.views} and truth["camera"]["gamma"] == camera.gamma
    )
    gain = truth["views"][rig.views[0].name]["gains"][1]
    exposure = file_exposure(rig.views[0].image)
    first = truth["views"][rig.views[1].name]["gains"][1] / gain
    second = file_exposure(rig.views[1].image) / exposure
    assert abs(np.log2(second / first)) <= 1.0 / 3.0 + 1e-3
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*.jpg")}
    ldr.make_capture(source, tmp_path / "again", seed=3, exif="rounded")
    for path, content in before.items():
        assert (tmp_path / "again" / path.relative_to(tmp_path / "out")).read_bytes() == content


def test_exact_exposures_are_exact(tmp_path, source):
    ldr.make_capture(source, tmp_path / "out", seed=3, exif="exact")
    views = read_rig(tmp_path / "out", "auto", CaptureOptions()).views
    truth = json.loads((tmp_path / "out" / ldr.TRUTH).read_text())["views"]
    ratio = [file_exposure(view.image) / truth[view.name]["gains"][1] for view in views]
    assert np.array(ratio) / ratio[0] == pytest.approx(1.0, abs=1e-4)


def test_the_photographs_of_a_bracket_are_views_of_one_pose(tmp_path, source):
    ldr.make_capture(source, tmp_path / "one", seed=3, exif="exact")
    ldr.make_capture(source, tmp_path / "out", seed=3, exif="exact", bracket=ldr.Bracket(3, 1.5))
    single, views = (read_rig(tmp_path / name, "auto", CaptureOptions()).views for name in ("one", "out"))
    assert [view.name for view in views] == [f"train/{number:03d}" for number in range(6)] + ["val/000"]
    for number, view in enumerate(views[:6]):
        before = single[number // 3]
        assert np.allclose(view.camera_to_world, before.camera_to_world)
        ratio = file_exposure(view.image) / file_exposure(before.image)
        assert ratio == pytest.approx(2.0 ** (1.5 * (number % 3 - 1)), rel=1e-3)
        assert (view.parts is None) == (before.parts is None)
        if view.parts:
            assert view.parts.resolve() == before.parts.resolve()
    truth = json.loads((tmp_path / "out" / ldr.TRUTH).read_text())["views"]
    assert set(truth) == {view.name for view in views}


@pytest.mark.parametrize("exif", ["none", "exact"])
def test_photographs_without_adjustment_are_decoded_codes(tmp_path, source, exif):
    ldr.make_capture(source, tmp_path / "jpg", seed=3, suffix=".png", exif=exif)
    ldr.make_capture(source, tmp_path / "exr", seed=3, suffix=".exr", exif=exif)
    truth = json.loads((tmp_path / "exr" / ldr.TRUTH).read_text())["views"]
    views = [read_rig(tmp_path / name, "auto", CaptureOptions()).views for name in ("jpg", "exr")]
    for encoded, plain in zip(*views, strict=True):
        exposure = truth[plain.name]["gains"][1] if exif == "exact" else 1.0
        expected = read_radiance(encoded.image) / exposure
        assert read_radiance(plain.image) == pytest.approx(expected, rel=2e-3, abs=1e-4)


def test_responses_increase_and_clip(tmp_path):
    for seed in range(20):
        camera = ldr.draw_camera(np.random.default_rng(seed), ".png", "none")
        values = camera.respond(np.linspace(0.0, 2.0, 2001))
        assert values[0] == 0.0 and values[1000:] == pytest.approx(1.0) and np.diff(values[:1001]).min() > 0.0


def view_of(folder, values: np.ndarray, camera: ldr.Camera) -> View:
    path = folder / "a.png"
    ldr.write_photograph(path, values, replace(camera, suffix=".png"), 1.0)
    height, width = values.shape[:2]
    return View(
        "val/000",
        "held_back",
        path,
        width,
        height,
        20.0,
        20.0,
        width / 2,
        height / 2,
        np.eye(4),
        encoded=True,
    )


def statistics(run: RunFolder, camera: ldr.Camera, exposure_ev: float) -> None:
    light = np.geomspace(1e-6, 1.0, 5000)
    curve = np.interp(np.arange(256) / 255.0, camera.respond(light), np.log(light))
    views = {"train/000": {"exposure_ev": exposure_ev}}
    write_json(
        run.statistics_json,
        {"photometry": {"log_curve": curve.tolist(), "falloff": [0.0, 0.0], "views": views}},
    )


def test_renders_are_compared_in_the_cameras_values(tmp_path):
    """A render of another scale and white balance is the photograph again."""
    camera = ldr.Camera(2.2, 0.1, 0.2, 0.0)
    radiance = np.exp(RNG.uniform(-4.0, 1.0, (12, 16, 3)))
    view = view_of(tmp_path, camera.respond(radiance * 0.7), camera)
    run = RunFolder(tmp_path / "run")
    statistics(run, camera, 0.0)
    (image,) = ldr.as_photographed([radiance * [3.0, 2.0, 1.0]], run, [view])
    assert np.abs(image - read_radiance(view.image)).max() < 0.02
    (same,) = ldr.as_photographed([radiance], run, [replace(view, encoded=False)])
    assert same is radiance
    assert ldr.as_photographed([radiance], RunFolder(tmp_path / "hdr"), [view])[0] is radiance


def test_errors_of_the_camera(tmp_path):
    run, camera = RunFolder(tmp_path / "run"), ldr.Camera(2.2, 0.1, 0.2, 0.0)
    assert ldr.camera_errors(run, tmp_path) is None
    statistics(run, camera, 1.0)
    photometry = json.loads(run.statistics_json.read_text())["photometry"]
    photometry["views"]["train/001"] = {"exposure_ev": 2.1}
    light = np.linspace(0.0, 1.0, ldr.CURVE_STEPS)
    gains = {"train/000": {"gains": [0.5] * 3}, "train/001": {"gains": [1.0] * 3}}
    truth = {"views": gains, "light": light.tolist(), "values": camera.respond(light).tolist()}
    write_json(tmp_path / ldr.TRUTH, truth)
    write_json(run.statistics_json, {"photometry": photometry})
    found = ldr.camera_errors(run, tmp_path)
    assert found["response"] < 1e-3 and found["contrast"] == pytest.approx(1.0, abs=1e-2)
    assert found["exposures"] == pytest.approx(0.05) and found["exposures_most"] == pytest.approx(0.05)
    photometry["log_curve"] = [1.1 * value for value in photometry["log_curve"]]
    write_json(run.statistics_json, {"photometry": photometry})
    found = ldr.camera_errors(run, tmp_path)
    assert found["contrast"] == pytest.approx(1.1, abs=1e-2) and found["response"] > 0.01


def test_emission_is_compared_after_one_scale(tmp_path):
    run = RunFolder(tmp_path / "run")
    statistics(run, ldr.Camera(2.2, 0.0, 0.0, 0.0), 1.0)
    write_json(tmp_path / ldr.TRUTH, {"views": {"train/000": {"gains": [0.5, 0.5, 0.5]}}})
    empty = np.zeros((1, 1, 3))
    maps = Maps(empty, empty, empty, empty[..., 0], empty[..., 0], empty + 3.0, empty[..., 0] > 0)
    (found,) = ldr.in_true_units([maps], run, tmp_path)
    assert found.emission == pytest.approx(3.0 * 2.0 / 0.5)
    (same,) = ldr.in_true_units([maps], RunFolder(tmp_path / "none"), tmp_path)
    assert same is maps
