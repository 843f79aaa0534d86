# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A complete estimation from photographs that are not HDR: its lamp is clipped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.ldr import Camera, draw_gains, photograph, write_photograph
from fipt_blender.core.capture.encoded import srgb_decoded
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.small_captures import (
    CAMERAS,
    COLORS,
    PANEL,
    PANEL_RADIANCE,
    PANEL_TRIANGLES,
    UNTRAINED,
    SmallCapture,
    matt,
    photograph_room,
    run_here,
    write_run,
)
from samples.small_rooms import BOX, make_room, table

pytestmark = pytest.mark.usefixtures("one_thread")

CAMERA = Camera(2.2, 0.1, 0.2, 0.1, suffix=".png")
MORE = [[[1.5, 0.2, 1.8], [-1.2, -0.4, 0.6]], [[-0.3, 1.7, 1.5], [0.1, -1.5, 0.8]]]


def write_encoded(root: Path, capture: SmallCapture) -> tuple[RunFolder, np.ndarray]:
    """The run folder of PNG files that a camera with automatic exposure took, and its (V, 3) gains."""
    run = write_run(root, capture, rounds=0, **UNTRAINED)
    data, every = json.loads(run.capture_json.read_text()), []
    for index, (view, image) in enumerate(zip(data["views"], capture.images, strict=True)):
        rng = np.random.default_rng([5, index])
        gains = draw_gains(image, rng)
        every.append(gains)
        path = run.images / f"{index:03d}.png"
        write_photograph(path, photograph(image, gains, CAMERA, rng), CAMERA, gains[1])
        view |= {"image": f"images/{path.name}", "encoded": True, "exposure": None}
    write_json(run.capture_json, data)
    return run, np.array(every)


def test_a_clipped_panel_is_found_with_its_radiance(tmp_path: Path) -> None:
    room = make_room([*BOX, PANEL], parts="objects")
    materials = matt(np.repeat(np.array([*COLORS, [0.0] * 3]), 2, axis=0))
    lamps = table(PANEL_TRIANGLES, PANEL_RADIANCE)
    capture = photograph_room(room, materials, lamps, cameras=[*CAMERAS, *MORE], scale=2, spp=64)
    run, gains = write_encoded(tmp_path / "run", capture)
    messages = run_here(run, train=False)
    assert messages[-1]["type"] == "done"
    assert [m["code"] for m in messages if m["type"] == "warning"].count("lamps-clipped") == 1
    photometry = json.loads(run.statistics_json.read_text())["photometry"]
    pictures = [np.asarray(Image.open(path), np.float64) / 255.0 for path in run.images.glob("*.png")]
    median = np.median(np.concatenate([srgb_decoded(each).mean(axis=-1).ravel() for each in pictures]))
    assert photometry["median_shown"] == pytest.approx(median, rel=0.05)
    exposures = np.array([view["exposure_ev"] for view in photometry["views"].values()])
    offsets = exposures - np.log2(gains).mean(axis=1)
    assert np.abs(offsets - np.median(offsets)).max() < 0.12
    (fixture,) = json.loads(run.emitters_json.read_text())["fixtures"]
    assert set(fixture["triangles"]) == set(PANEL_TRIANGLES)
    # One scale is left open: found exposures are relative to the median view's.
    found = np.array(fixture["radiance"]) * 2.0 ** np.median(offsets)
    assert found == pytest.approx(np.array(PANEL_RADIANCE), rel=0.25)
