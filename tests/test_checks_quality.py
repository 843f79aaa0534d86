"""A result is judged by photographs that it was not made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.encoded import srgb_decoded, srgb_encoded
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.checks.projection import projected
from fipt_blender.core.checks.quality import judge
from fipt_blender.core.checks.rerender import Estimate, Renderer
from fipt_blender.core.pixels.store import LEFT_OUT, PixelStore, create_pixels, fill_pixels, trace_view
from fipt_blender.core.report.pictures import write_png
from samples.small_captures import COLORS, PANEL_RADIANCE, PANEL_TRIANGLES, SmallCapture, panel_capture, pinhole
from samples.small_rooms import table

HELD_BACK = 1


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    return panel_capture()


def stored(capture: SmallCapture, folder: Path) -> tuple[PixelStore, View, float]:
    """Pixels of the training views, the view that is held back, and the median radiance."""
    views = []
    for index, (image, pose) in enumerate(zip(capture.images, capture.poses, strict=True)):
        write_exr(folder / f"{index}.exr", image)
        views.append(View(str(index), "train", folder / f"{index}.exr", **vars(pinhole(pose))))
    held_back = replace(views.pop(HELD_BACK), split="held_back")
    pixels = create_pixels(folder / "pixels", views)
    return pixels, held_back, fill_pixels(pixels, capture.room, lambda done: None)


def true_estimate(capture: SmallCapture, scale: float) -> Estimate:
    colors = np.repeat(np.array([*COLORS, [0.0] * 3]), 2, axis=0)

    def query(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return colors[triangles], np.ones(len(triangles)), np.zeros(len(triangles))

    lamps = table(PANEL_TRIANGLES, list(np.array(PANEL_RADIANCE) / scale))
    return Estimate(capture.room, query, lamps, None)


def test_a_true_estimate_renders_the_photograph(capture: SmallCapture, tmp_path: Path) -> None:
    pixels, view, scale = stored(capture, tmp_path)
    image = Renderer(true_estimate(capture, scale), 0).render(view)
    true = capture.images[HELD_BACK] / scale
    inner = trace_view(capture.room, view).triangle < min(PANEL_TRIANGLES)  # the lamp's edge is sharp
    inner = inner.reshape(true.shape[:2])
    assert np.median(np.abs(np.log(image[inner] / true[inner]))) < 0.04
    quality = judge(pixels, [view], true_estimate(capture, scale), {}, scale, 0)
    assert quality is not None and quality.held_back_db > 30.0
    photograph, render, _ = quality.views[0].pictures  # whose noise does not count
    assert quality.held_back_db > -10.0 * np.log10(((render - photograph) ** 2).mean()) + 0.2
    assert quality.projection_db > 15.0  # five photographs do not show all
    wrong = replace(true_estimate(capture, scale), query=lambda p, t: (np.full((len(t), 3), 0.5), t * 0.0 + 1, t * 0.0))
    worse = judge(pixels, [view], wrong, {}, scale, 0)
    assert worse is not None and worse.held_back_db < quality.held_back_db - 8.0
    assert worse.projection_db == quality.projection_db
    assert judge(pixels, [], wrong, {}, scale, 0) is None  # no view is held back


def test_a_photograph_that_was_held_back_has_its_own_exposure(capture: SmallCapture, tmp_path: Path) -> None:
    pixels, view, scale = stored(capture, tmp_path)
    middle, stops = 0.2, -1.5
    light = middle * 2.0**stops * capture.images[HELD_BACK] / scale
    write_png(tmp_path / "phone.png", srgb_encoded(np.clip(light, 0.0, 1.0)))
    phone = replace(view, image=tmp_path / "phone.png", encoded=True)
    steep = 1.6 * np.log(srgb_decoded(np.linspace(0.01, 1.0, 256)))  # of the camera, which Blender does not have
    photometry = {"log_curve": steep, "falloff": np.zeros(2), "median_shown": middle}
    found = judge(pixels, [phone, view], true_estimate(capture, scale), photometry, scale, 0)
    assert found is not None and found.exposures == {"1": pytest.approx(stops, abs=0.1)}
    assert found.document()["exposures"] == {"1": pytest.approx(found.exposures["1"], abs=1e-4)}


def test_the_projection_is_what_others_show(capture: SmallCapture, tmp_path: Path) -> None:
    pixels, view, _ = stored(capture, tmp_path)
    pixels.radiance[:] = np.where(np.asarray(pixels.triangle) >= 6, 3.0, 1.0)[:, None]
    traced = trace_view(capture.room, view)
    found = projected(pixels, 0.0, view, traced)
    expected = np.where(traced.triangle >= 6, 3.0, 1.0).reshape(view.height, view.width)
    assert (np.abs(found[..., 0] - expected) < 0.1).mean() > 0.9
    pixels.triangle[:] = LEFT_OUT
    assert len(np.unique(projected(pixels, 0.0, view, traced))) == 1, "nothing is shown"
