# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""EXR and id images of all kinds that cameras, renderers and painting programs write."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from fipt_blender.core.capture.images import read_ids, read_radiance, read_size, write_exr
from fipt_blender.core.run.errors import FiptError

RNG = np.random.default_rng(0)
PIXELS = RNG.lognormal(0.0, 3.0, (5, 7, 3)).astype(np.float32)


def write_channels(path, channels, **header):
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels).write(str(path))


def planes(prefix="", pixels=PIXELS):
    return {prefix + name: np.ascontiguousarray(pixels[..., index]) for index, name in enumerate("RGB")}


def test_float_round_trip_is_exact(tmp_path):
    path = tmp_path / "new" / "a.exr"
    write_exr(path, PIXELS)
    np.testing.assert_array_equal(read_radiance(path), PIXELS)
    assert read_size(path) == (7, 5)
    assert [entry.name for entry in path.parent.iterdir()] == ["a.exr"]  # no temporary file is left


def test_half_round_trip_keeps_eleven_bits_and_the_range(tmp_path):
    path = tmp_path / "a.exr"
    bright = np.maximum(PIXELS, 1e-3)
    bright[0, 0] = 1e6
    write_exr(path, bright, half=True)
    read = read_radiance(path)
    assert read.dtype == np.float32
    np.testing.assert_allclose(read, np.minimum(bright, 65504.0), rtol=2.0**-11)


def test_one_channel_is_luminance(tmp_path):
    write_exr(tmp_path / "y.exr", PIXELS[..., 0])
    np.testing.assert_array_equal(read_radiance(tmp_path / "y.exr"), np.repeat(PIXELS[..., :1], 3, axis=2))


@pytest.mark.parametrize("prefix", ["Combined.", "ViewLayer.Combined.", "layer."])
def test_layers(tmp_path, prefix):
    write_channels(tmp_path / "a.exr", {**planes(prefix), "Depth.Z": PIXELS[..., 0].copy()})
    np.testing.assert_array_equal(read_radiance(tmp_path / "a.exr"), PIXELS)


def test_unnamed_layer_wins_and_alpha_is_left_out(tmp_path):
    channels = {**planes("AO.", PIXELS * 0.5), **planes(), "A": np.ones((5, 7), np.float32)}
    write_channels(tmp_path / "a.exr", channels)
    np.testing.assert_array_equal(read_radiance(tmp_path / "a.exr"), PIXELS)


def test_data_window_is_placed_on_the_display_window(tmp_path):
    """Data from column -1 to 5 and row 2 to 6 on a display of 8 x 6."""
    write_channels(
        tmp_path / "a.exr",
        planes(),
        dataWindow=(np.array([-1, 2], np.int32), np.array([5, 6], np.int32)),
        displayWindow=(np.array([0, 0], np.int32), np.array([7, 5], np.int32)),
    )
    expected = np.zeros((6, 8, 3), np.float32)
    expected[2:6, 0:6] = PIXELS[:4, 1:]
    np.testing.assert_array_equal(read_radiance(tmp_path / "a.exr"), expected)
    assert read_size(tmp_path / "a.exr") == (8, 6)


def test_declared_primaries_become_rec709(tmp_path):
    """ACEScg (AP1, white near D60): white stays white, and red becomes the published value in Rec.709."""
    ap1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    pixels = np.array([[[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], np.float32)
    write_channels(tmp_path / "a.exr", planes(pixels=pixels), chromaticities=ap1)
    expected = [
        [1.0, 1.0, 1.0],
        [1.70505, -0.13026, -0.02400],
        [-0.62179, 1.14080, -0.12897],
        [-0.08326, -0.01055, 1.15297],
    ]
    np.testing.assert_allclose(read_radiance(tmp_path / "a.exr")[0], expected, atol=1e-4)
    rec709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    write_channels(tmp_path / "b.exr", planes(), chromaticities=rec709)
    np.testing.assert_array_equal(read_radiance(tmp_path / "b.exr"), PIXELS)


def error_code(function, path):
    with pytest.raises(FiptError) as caught:
        function(path)
    assert str(path) in caught.value.text and caught.value.remedy
    return caught.value.code


def test_files_that_are_no_radiance(tmp_path):
    missing, text, cut, depth = (tmp_path / name for name in ("m.exr", "t.exr", "c.exr", "d.exr"))
    assert error_code(read_radiance, missing) == error_code(read_size, missing) == "image-missing"
    text.write_text("not an image")
    assert error_code(read_radiance, text) == error_code(read_size, text) == "image-unreadable"
    write_exr(cut, PIXELS)
    cut.write_bytes(cut.read_bytes()[:-60])
    assert error_code(read_radiance, cut) == "image-unreadable"
    write_channels(depth, {"Z": PIXELS[..., 0].copy()})
    assert error_code(read_radiance, depth) == "image-channels"
    for name in ("a.png", "a.jpg", "a.tif", "a.hdr"):
        (tmp_path / name).write_bytes(b"x")
        code = "image-format" if name == "a.hdr" else "image-unreadable"
        assert error_code(read_radiance, tmp_path / name) == code


IDS = RNG.integers(0, 200, (5, 7))


def test_ids_from_exr(tmp_path):
    write_exr(tmp_path / "y.exr", IDS)
    write_exr(tmp_path / "rgb.exr", np.repeat(IDS[..., None], 3, axis=2))
    write_exr(tmp_path / "half.exr", IDS, half=True)
    write_channels(tmp_path / "uint.exr", {"IndexOB.X": IDS.astype(np.uint32)})
    for name in ("y", "rgb", "half", "uint"):
        ids = read_ids(tmp_path / f"{name}.exr")
        assert ids.dtype == np.int32
        np.testing.assert_array_equal(ids, IDS)


def test_large_ids_survive(tmp_path):
    write_exr(tmp_path / "a.exr", np.array([[2**24 - 1, 0]]))
    np.testing.assert_array_equal(read_ids(tmp_path / "a.exr"), [[2**24 - 1, 0]])


def test_ids_from_png(tmp_path):
    Image.fromarray(IDS.astype(np.uint8)).save(tmp_path / "grey.png")
    Image.fromarray((IDS * 300).astype(np.uint16)).save(tmp_path / "deep.png")
    palette = Image.fromarray(IDS.astype(np.uint8), mode="P")
    palette.putpalette(list(RNG.integers(0, 256, 768)))
    palette.save(tmp_path / "palette.png")
    colour = np.stack([IDS, IDS // 2, IDS // 3], axis=-1)
    Image.fromarray(colour.astype(np.uint8)).save(tmp_path / "colour.png")
    np.testing.assert_array_equal(read_ids(tmp_path / "grey.png"), IDS)
    np.testing.assert_array_equal(read_ids(tmp_path / "deep.png"), IDS * 300)
    np.testing.assert_array_equal(read_ids(tmp_path / "palette.png"), IDS)
    np.testing.assert_array_equal(read_ids(tmp_path / "colour.png"), IDS * 65536 + IDS // 2 * 256 + IDS // 3)
    assert read_size(tmp_path / "grey.png") == (7, 5)


def test_images_that_are_no_ids(tmp_path):
    write_exr(tmp_path / "a.exr", PIXELS)
    assert error_code(read_ids, tmp_path / "a.exr") == "mask-not-ids"
    write_exr(tmp_path / "n.exr", np.full((2, 2), np.nan))
    assert error_code(read_ids, tmp_path / "n.exr") == "mask-not-ids"
    Image.fromarray(IDS.astype(np.uint8)).save(tmp_path / "a.jpg")
    assert error_code(read_ids, tmp_path / "a.jpg") == "mask-not-ids"
    (tmp_path / "t.png").write_text("no image")
    assert error_code(read_ids, tmp_path / "t.png") == "image-unreadable"
    assert error_code(read_ids, tmp_path / "m.png") == "image-missing"
