# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result is judged by photographs that it was not made of, and its faults are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import affine_transform, gaussian_filter, shift

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.checks.projection import Projection, projected
from fipt_blender.core.checks.quality import POOR, Cause, JudgedView, Quality, judge, shares
from fipt_blender.core.checks.rerender import Estimate, Renderer
from fipt_blender.core.pixels.store import LEFT_OUT, PixelStore, fill_pixels, open_pixels, trace_view
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
    pixels = open_pixels(folder / "pixels", views, create=True)
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
    assert np.median(np.abs(np.log(image[inner] / true[inner]))) < 0.03
    quality = judge(pixels, [view], true_estimate(capture, scale), {}, scale, 0)
    assert quality is not None and quality.held_back_db > 30.0 and quality.warning() is None
    assert quality.projection_db > 15.0  # five photographs do not show all
    wrong = replace(true_estimate(capture, scale), query=lambda p, t: (np.full((len(t), 3), 0.5), t * 0.0 + 1, t * 0.0))
    worse = judge(pixels, [view], wrong, {}, scale, 0)
    assert worse is not None and worse.held_back_db < quality.held_back_db - 8.0
    assert worse.projection_db == quality.projection_db
    assert judge(pixels, [], wrong, {}, scale, 0) is None  # no view is held back


def test_the_projection_is_what_others_show(capture: SmallCapture, tmp_path: Path) -> None:
    pixels, view, _ = stored(capture, tmp_path)
    pixels.radiance[:] = np.where(np.asarray(pixels.triangle) >= 6, 3.0, 1.0)[:, None]
    traced = trace_view(capture.room, view)
    found = projected(pixels, 0.0, view, traced)
    expected = np.where(traced.triangle >= 6, 3.0, 1.0).reshape(view.height, view.width)
    assert (np.abs(found.radiance[..., 0] - expected) < 0.1).mean() > 0.9
    assert found.seen.max() >= 2 and found.spread[found.seen > 0].mean() < 0.1
    pixels.triangle[:] = LEFT_OUT
    assert not projected(pixels, 0.0, view, traced).seen.any()


SIZE = (60, 80)


def picture() -> np.ndarray:
    rng = np.random.default_rng(2)
    grey = gaussian_filter(rng.normal(size=SIZE), 2.0)
    return np.clip(0.5 + 0.6 * np.stack([grey, grey, 0.8 * grey], axis=2), 0.02, 0.98)


def first_cause(
    photograph: np.ndarray,
    render: np.ndarray,
    plain: np.ndarray,
    off: np.ndarray | None = None,
    missed: np.ndarray | None = None,
) -> str:
    spread = np.zeros(SIZE, np.float32) if off is None else off.astype(np.float32)
    missed = np.zeros(SIZE, bool) if missed is None else missed
    projection = Projection(plain, np.full(SIZE, 4, np.int16), spread, missed)
    view = View("0", "held_back", Path(), SIZE[1], SIZE[0], 70.0, 70.0, 40.0, 30.0, np.eye(4))
    judged = JudgedView("0", np.array([photograph, render, plain], np.float32), np.zeros((2, 3)))
    found = shares(judged, projection, np.ones(SIZE, bool), view, 0.8 if off is None else 0.0, 0.0)
    assert sum(found.values()) == pytest.approx(1.0) and min(found.values()) >= 0.0
    return max(found, key=lambda name: found[name])


def test_the_cause_that_was_built_in_is_named_first() -> None:
    true, rng = picture(), np.random.default_rng(5)
    noise = 0.01 * rng.normal(size=true.shape)
    gradient = np.linspace(0.6, 1.4, SIZE[1])[None, :, None]
    assert first_cause(true, np.clip(true * gradient, 0, 1), true + noise) == "light that nothing shows"
    assert first_cause(true, np.clip(true * gradient, 0, 1), true + noise, np.zeros(SIZE)) == "lamps"
    assert first_cause(true, true + 0.1 * rng.normal(size=true.shape), true + noise) == "materials"
    moved = shift(true, (0.0, 2.5, 0.0), mode="nearest")
    assert first_cause(true, moved, moved) == "poses"
    wider = affine_transform(true, np.diag([0.95, 0.95, 1.0]), [1.5, 2.0, 0.0], order=1)
    assert first_cause(true, wider, wider) == "poses"
    block = np.zeros(SIZE, bool)
    block[20:40, 20:50] = True
    torn = np.where(block[..., None], true[::-1], true)
    assert first_cause(true, torn, torn + noise, block) == "surfaces"
    assert first_cause(true, torn, torn + noise, missed=block) == "surfaces"
    blurred = gaussian_filter(true, (1.5, 1.5, 0.0))
    assert first_cause(blurred, true, true) == "photographs"
    assert first_cause(true, true * [1.0, 0.8, 0.7], true * [1.0, 0.8, 0.7]) == "photographs"


def test_a_poor_result_says_what_helps() -> None:
    causes = (Cause("lamps", 0.7, "Look at the lamps."), Cause("poses", 0.2, "Solve them."))
    poor = Quality(POOR - 5.0, 27.0, causes, ())
    code, text, remedy = poor.warning() or ("", "", "")
    assert code == "result-poor" and "lamps (70 %), poses (20 %)" in text and remedy == "Look at the lamps."
    assert replace(poor, held_back_db=POOR).warning() is None
    assert poor.document()["causes"][0] == {"name": "lamps", "share": 0.7, "remedy": "Look at the lamps."}
    assert poor.deviation == pytest.approx(0.1)
