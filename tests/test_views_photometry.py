"""Photographs that are not HDR become radiance: a small room and a camera with automatic exposure."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.ldr import Camera, draw_gains, photograph
from fipt_blender.core.capture.encoded import srgb_decoded
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.light.clipped import Expectation
from fipt_blender.core.photometry.encoded_photographs import (
    LIGHT_DEVIATION,
    Photometry,
    adjust_photographs,
    solve_light,
    warn_of_photographs,
)
from fipt_blender.core.photometry.refit import refit_photographs
from fipt_blender.core.pixels.mixed_pixels import mark_pure
from fipt_blender.core.pixels.store import PixelStore, create_pixels, fill_pixels
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.settings import make_settings
from samples.small_captures import CAMERAS, COLORS, PANEL, PANEL_RADIANCE, matt, photograph_room, write_run
from samples.small_rooms import BOX, make_room, table

CAMERA = Camera(2.3, 0.15, 0.2, 0.2)
MORE = [[[1.5, 0.2, 1.8], [-1.2, -0.4, 0.6]], [[-0.3, 1.7, 1.5], [0.1, -1.5, 0.8]]]
PARTS = 7


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> tuple[PixelStore, object]:
    """The HDR pixels of eight views of a box with a lamp."""
    room = make_room([*BOX, PANEL], parts="objects")
    materials = matt(np.repeat(np.array([*COLORS, [0.0] * 3]), 2, axis=0))
    capture = photograph_room(
        room, materials, table([12, 13], PANEL_RADIANCE), cameras=[*CAMERAS, *MORE], scale=2, spp=32
    )
    folder = tmp_path_factory.mktemp("photometry")
    pixels = create_pixels(folder / "pixels", load_capture(write_run(folder / "run", capture)).train)
    fill_pixels(pixels, room, lambda _: None)
    mark_pure(pixels, room, room.triangle_object, lambda _: None)
    return pixels, room


def photographed(pixels: PixelStore, encoded: list[int]) -> tuple[PixelStore, float, np.ndarray]:
    """The pixels as photographs of the camera would fill them, the scale, and the (V, 3) gains."""
    values, gains, views = np.array(pixels.radiance), [], list(pixels.views)
    for index, view in enumerate(pixels.views):
        rng, rows = np.random.default_rng([9, index]), pixels.rows(index)
        image = values[rows].reshape(view.height, view.width, 3)
        gains.append(draw_gains(image, rng))
        if index in encoded:
            codes = np.round(photograph(image, gains[-1], CAMERA, rng) * 255.0) / 255.0
            values[rows] = srgb_decoded(codes).reshape(-1, 3)
            views[index] = replace(view, encoded=True)
    scale = float(np.median(values.mean(axis=1)))
    return replace(pixels, views=views, radiance=(values / scale).astype(np.float32)), scale, np.array(gains)


def adjusted(pixels: PixelStore, room, scale: float, folder: Path) -> tuple[Photometry, list[dict]]:
    stream = io.StringIO()
    part = room.triangle_object
    found = adjust_photographs(pixels, room, part, scale, make_settings("draft", {"voxel_resolution": 64}), folder)
    warn_of_photographs(found.facts, Reporter(stream))
    return found, [parse_message(line) for line in stream.getvalue().splitlines()]


@pytest.fixture(scope="module")
def all_adjusted(store, tmp_path_factory) -> tuple[PixelStore, np.ndarray, Photometry, list[dict]]:
    """All views photographed and adjusted; the pixels, the true gains, what was found, the messages."""
    hdr, room = store
    pixels, scale, gains = photographed(hdr, list(range(len(hdr.views))))
    return pixels, gains, *adjusted(pixels, room, scale, tmp_path_factory.mktemp("codes"))


def test_exposures_radiance_and_the_lamp_come_back(store, all_adjusted):
    hdr, _ = store
    pixels, gains, found, messages = all_adjusted
    views = found.facts["views"]
    error = np.array([views[view.name]["exposure_ev"] for view in hdr.views])
    error -= np.log2(gains).mean(axis=1)
    assert np.abs(error - np.median(error)).max() < 0.12
    ratio = np.log(np.asarray(pixels.radiance) / np.maximum(hdr.radiance, 1e-6))[found.weight > 0.5]
    middle = np.median(ratio)
    assert np.median(np.abs(ratio - middle)) < 0.1
    on_lamp = np.asarray(hdr.triangle) >= 12
    lamp = np.asarray(pixels.radiance)[on_lamp & np.asarray(hdr.pure)] / np.exp(middle)
    true = np.asarray(hdr.radiance)[on_lamp & np.asarray(hdr.pure)]
    assert np.median(lamp / true) == pytest.approx(1.0, abs=0.25)
    assert [m["code"] for m in messages if m["type"] == "warning"] == ["lamps-clipped"]
    assert len(found.facts["lamps"]) == 2 and max(found.facts["lamps"][0]["deviation"]) < 0.4
    positive = np.asarray(pixels.radiance).mean(axis=1)
    assert np.median(positive) == pytest.approx(1.0, rel=0.02)


def test_the_same_bits_twice(tmp_path: Path, store, all_adjusted):
    hdr, room = store
    pixels, scale, _ = photographed(hdr, list(range(len(hdr.views))))
    found, _ = adjusted(pixels, room, scale, tmp_path)
    first, _, before, _ = all_adjusted
    assert np.array_equal(pixels.radiance, first.radiance) and np.array_equal(found.weight, before.weight)
    assert found.scale == before.scale and found.facts == before.facts


def test_hdr_photographs_beside_others_keep_their_radiance(tmp_path: Path, store):
    hdr, room = store
    pixels, scale, _ = photographed(hdr, [0, 1, 2, 3, 4])
    found, _ = adjusted(pixels, room, scale, tmp_path)
    for index in range(len(hdr.views)):
        rows = hdr.rows(index)
        ratio = np.asarray(pixels.radiance[rows]) * found.scale / np.maximum(hdr.radiance[rows], 1e-6)
        if index > 4:
            assert np.abs(ratio - 1.0).max() < 1e-3 and (found.weight[rows] == 1.0).all()
        else:
            assert np.median(ratio) == pytest.approx(1.0, abs=0.12)


def test_photographs_without_common_points_are_left_as_they_are(tmp_path: Path, store):
    """One view alone: nothing tells its response, and nothing fails."""
    hdr, room = store
    pixels, scale, _ = photographed(hdr, [0])
    found, _ = adjusted(pixels, room, scale, tmp_path)
    assert np.isfinite(np.asarray(pixels.radiance)).all() and np.isfinite(found.scale)


def test_an_absurd_contrast_by_light_is_left_out(all_adjusted):
    """Photographs of nearly one code: any light explains them if the contrast is large enough."""
    found = all_adjusted[2].found
    expected = Expectation.of(found.lit.bound, found.radiometry.contrast.value)

    def solved(values: np.ndarray):
        points = replace(found.lit.points, value=values)
        return solve_light(found.radiometry, points, found.lit.cache, expected, LIGHT_DEVIATION)[0]

    values = found.lit.points.value
    sources = {source.name: source for source in solved(values).sources}
    assert "light" in sources
    flat = solved(np.nanmedian(values) + 0.02 * (values - np.nanmedian(values)))
    assert "light" not in [source.name for source in flat.sources]
    assert flat.contrast.value == pytest.approx(sources["usual"].value)


@pytest.fixture(scope="module")
def true_light(store) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) L_d by the true albedo of the matt surfaces, in the unit of the radiance; (N,) bool, where."""
    hdr, _ = store
    triangle = np.asarray(hdr.triangle)
    albedo = np.repeat(np.array([*COLORS, [1.0] * 3]), 2, axis=0)[np.maximum(triangle, 0)]
    known = (triangle >= 0) & (triangle < 12)
    return np.where(known[:, None], np.asarray(hdr.radiance) / albedo, 1.0), known


def copied(pixels: PixelStore) -> PixelStore:
    return replace(pixels, radiance=np.array(pixels.radiance))


def test_light_of_shadings_mends_what_the_model_gets_wrong(store, all_adjusted, true_light):
    """With the true light, the radiance of the walls and the lamp comes nearer to the truth."""
    hdr, room = store
    adjusted_pixels, _, before, _ = all_adjusted
    pixels, (light, known) = copied(adjusted_pixels), true_light
    good = known & (before.weight > 0.5)
    unit = np.median((np.asarray(pixels.radiance) / np.maximum(hdr.radiance, 1e-6))[good])
    light = (light * unit).astype(np.float16)
    after = refit_photographs(before, pixels, room, room.triangle_object, lambda rows, _: light[rows])
    ratio = np.log(np.asarray(pixels.radiance) / np.maximum(hdr.radiance, 1e-6))
    middle = np.median(ratio[good])
    assert np.median(np.abs(ratio[good] - middle)) < 0.06
    on_lamp = (np.asarray(hdr.triangle) >= 12) & np.asarray(hdr.pure)
    assert np.median(ratio[on_lamp]) - middle == pytest.approx(0.0, abs=0.15)
    assert after.facts["contrast"]["light"][1] < before.facts["contrast"]["light"][1]
    assert np.median(np.asarray(pixels.radiance).mean(axis=1)) == pytest.approx(1.0, rel=0.02)


def test_a_view_that_was_corrected_keeps_its_correction(store, all_adjusted, true_light):
    _, room = store
    adjusted_pixels, _, before, _ = all_adjusted
    pixels = copied(adjusted_pixels)
    pixels.radiance[pixels.rows(2)] /= np.float32(1.2)
    light = true_light[0].astype(np.float16)
    after = refit_photographs(before, pixels, room, room.triangle_object, lambda rows, _: light[rows]).facts["views"]
    moved = [after[name]["exposure_ev"] - view["exposure_ev"] for name, view in before.facts["views"].items()]
    assert moved[2] - np.median(moved) == pytest.approx(np.log2(1.2), abs=0.05)
