"""Frames of photographs: orientation, demosaicing, working size, clipping and the colors of cameras."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps

from fipt_blender.prepare import frames, merge_step, merging
from fipt_blender.prepare.frames import (
    NEAR_TOP,
    binned_rows,
    block_mean,
    common_ceiling,
    demosaiced_rows,
    find_ceiling,
    rec709_from_camera,
    upright,
)
from fipt_blender.prepare.merging import in_rec709
from samples.dng import Shot, mosaic_of, write_dng
from samples.prepared_captures import prepare


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientations_are_those_of_exif(orientation: int) -> None:
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    image = Image.fromarray(pixels)
    image.getexif()[0x0112] = orientation
    np.testing.assert_array_equal(upright(pixels, orientation), np.asarray(ImageOps.exif_transpose(image)))


def test_demosaicing_keeps_a_plane_and_spreads_clipping() -> None:
    plane = np.linspace(0.1, 0.9, 24)[None, :, None] * np.array([1.0, 0.8, 0.6]) + np.zeros((16, 1, 1))
    mosaic = mosaic_of(plane).astype(np.float32)
    colors = np.array([[0, 1], [1, 2]])
    values, clipped = demosaiced_rows(mosaic, colors, 0.95, 0, 16)
    np.testing.assert_allclose(values[2:-2, 2:-2], plane[2:-2, 2:-2], rtol=1e-5)
    assert not clipped.any()
    mosaic[6, 8] = 1.0  # a red place
    values, clipped = demosaiced_rows(mosaic, colors, 0.95, 0, 16)
    assert clipped[5:8, 7:10, 0].all() and clipped.sum() == 9
    for start in (0, 5, 11):
        rows, _ = demosaiced_rows(mosaic, colors, 0.95, start, start + 5)
        np.testing.assert_array_equal(rows, values[start : start + 5])


@pytest.mark.parametrize("factor", [3, 4, 5, 8])
def test_squares_of_a_mosaic_are_means_of_their_own_places(factor: int) -> None:
    """Exact on slopes, and nothing comes from beside a square."""
    y, x = np.mgrid[: 6 * factor, : 8 * factor].astype(np.float32)
    slopes = np.stack([0.1 + 0.002 * x + 0.003 * y, 0.2 + 0.001 * (x - y), 0.3 - 0.002 * x], -1)
    mosaic, colors = mosaic_of(slopes).astype(np.float32), np.array([[0, 1], [1, 2]])
    values, clipped = binned_rows(mosaic, colors, 0.95, 0, factor)
    np.testing.assert_allclose(values, block_mean(slopes, factor), atol=1e-6)
    assert not clipped.any()
    mosaic[2 * factor : 3 * factor, 3 * factor : 4 * factor] = 1.0
    bright, clipped = binned_rows(mosaic, colors, 0.95, 0, factor)
    assert clipped[2, 3].all() and clipped.sum() == 3
    changed = np.abs(bright - values).max(axis=-1) > 1e-6
    assert changed[2, 3] and changed.sum() == 1
    later, _ = binned_rows(mosaic[2 * factor :], colors, 0.95, 2 * factor, factor)
    np.testing.assert_array_equal(later, bright[2:])


def test_white_stays_white_in_the_cameras_colors() -> None:
    matrix = rec709_from_camera(np.array([[0.9, -0.2, -0.1], [-0.4, 1.2, 0.2], [-0.05, 0.2, 0.6]]))
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
    np.testing.assert_array_equal(rec709_from_camera(np.zeros((3, 3))), np.eye(3))


def test_the_ceiling_of_a_camera_is_that_of_all_photographs() -> None:
    lower = np.minimum(np.linspace(0.0, 1.2, 10_000), 0.85)
    wall = np.minimum(np.linspace(0.0, 1.2, 10_000), 0.6)
    assert find_ceiling(lower) == pytest.approx(0.848) and find_ceiling(wall) == pytest.approx(0.598)
    ceilings = [find_ceiling(lower), find_ceiling(wall), NEAR_TOP]
    assert common_ceiling(ceilings, [0.85, 0.6, 0.3]) == pytest.approx(0.848)
    assert common_ceiling([find_ceiling(wall), NEAR_TOP], [0.6, 1.0]) == NEAR_TOP


def test_clipped_channels_become_neutral_and_others_stay() -> None:
    radiance = np.array([[[1.0, 1.0, 1.0], [1.0, 0.2, 0.1]]], np.float32)
    clipped = np.array([[[True, True, True], [True, False, False]]])
    found = in_rec709(radiance, clipped, np.array([2.0, 1.0, 1.5]), np.eye(3))
    np.testing.assert_allclose(found[0], [[2.0, 2.0, 2.0], [2.0, 0.2, 0.15]], rtol=1e-6)


HEIGHT, WIDTH, EXPOSURES = 400, 600, 5
# 2 GB less the process itself (0.25 GB), over 24 million pixels. Half floats and flags of the exposures are
# 45 of these bytes, the result is 16. Measured: 68, with motion 69. One more copy of an exposure takes 6.
MOST_BYTES = 72.9


@pytest.mark.parametrize("shift", [0, 3])
def test_merging_five_large_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shift: int) -> None:
    # The bands of rows and the grid of what has moved in the proportion of 24 megapixels.
    monkeypatch.setattr(frames, "LARGE_PIXELS", HEIGHT * WIDTH // 2)
    for module in (frames, merging):
        monkeypatch.setattr(module, "BAND_ROWS", 128 * HEIGHT // 4000)
    monkeypatch.setattr(merging, "SAMPLE_SIDE", merging.SAMPLE_SIDE * WIDTH // 6000)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    for index in range(EXPOSURES):
        moved = x + shift * index
        plane = 0.02 + 0.2 * (0.5 + 0.5 * np.sin(moved / 15.0) * np.cos(y / 10.0))
        light = np.repeat(plane[..., None] * 2.0 ** (index - 2), 3, -1)
        values = np.clip(mosaic_of(light) * 16000.0 + 256.0, 0, 16383).astype(np.uint16)
        shot = Shot(0.01 * 2.0 ** (index - 2), time=f"2026:05:01 12:00:0{index}")
        write_dng(tmp_path / "in" / f"{index}.dng", values, shot, 256, 16383)
    settings = ["working_width=0", f"align={'true' if shift else 'false'}"]

    prepare(tmp_path / "in", tmp_path / "out", "read", *settings)
    del y, x, moved, plane, light, values
    peaks = []
    merged = merge_step.merged_group

    def measured(*arguments: object) -> object:
        tracemalloc.start()
        try:
            return merged(*arguments)
        finally:
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()

    monkeypatch.setattr(merge_step, "merged_group", measured)
    prepare(tmp_path / "in", tmp_path / "out", "merge", *settings)
    assert peaks[0] / (HEIGHT * WIDTH) < MOST_BYTES
