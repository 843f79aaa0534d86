"""Photographs that are not HDR: their codes, their EXIF, and what `ingest` keeps and says of them."""

from __future__ import annotations

import json

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.capture.images import open_picture, read_ids, read_radiance, read_size, write_exr
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.checks.survey import examined, view_warning
from fipt_blender.core.run.runfolder import RunFolder
from samples.capture_files import make_samples, write_transforms
from samples.ingesting import edited_json, run_ingest
from samples.photographs import exif, write_jpeg
from samples.refusals import error_of

CODES = np.random.default_rng(3).integers(0, 256, (6, 8, 3)).astype(np.uint8)


def test_exposures_of_files(tmp_path):
    path = write_jpeg(tmp_path / "a.jpg", CODES, exif(1.0 / 50.0, aperture=4.0, iso=400))
    assert open_picture(path).exposure == pytest.approx(4.0 / 50.0 / 16.0, rel=1e-3)
    assert open_picture(write_jpeg(tmp_path / "b.jpg", CODES, exif(None))).exposure is None
    write_exr(tmp_path / "d.exr", PIXELS)
    assert open_picture(tmp_path / "d.exr").exposure is None


def test_captures_of_both_kinds(tmp_path):
    """A photograph of codes stays where it is; one with distortion is resampled and stays marked."""
    samples = make_samples(3)
    samples[1] = make_samples(2, model="OPENCV")[1]
    write_transforms(tmp_path / "in", samples)
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        for index in (0, 1):
            old = tmp_path / "in" / data["frames"][index]["file_path"]
            pixels = np.full((*read_radiance(old).shape[:2], 3), 100 + index, np.uint8)
            old.unlink()
            write_jpeg(old.with_suffix(".jpg"), pixels, exif(1.0 / 60.0))
            data["frames"][index]["file_path"] = f"images/{old.stem}.jpg"
    run = RunFolder(tmp_path / "run")
    messages = run_ingest(tmp_path / "in", run, hold_back=0)
    views = load_capture(run).views
    assert [view.encoded for view in views] == [True, True, False]
    assert views[0].exposure == pytest.approx(1.0 / 60.0 / 64.0, rel=1e-3) and views[2].exposure is None
    assert views[0].image.suffix == ".jpg" and views[1].image.suffix == ".exr"
    middle = read_radiance(views[1].image)[20, 20]
    assert np.abs(srgb_encoded(middle) * 255.0 - 101.0).max() < 1.0
    assert "encoded" not in json.loads(run.capture_json.read_text())["views"][2]
    (warning,) = [message for message in messages if message.get("code") == "images-not-hdr"]
    assert warning["text"].startswith("2 of 3 photographs") and "Make Capture" in warning["remedy"]


@pytest.mark.parametrize(("rows", "warning"), [(1, ""), (2, "20.0 % of its pixels look over-exposed")])
def test_check_views_warns_of_single_photographs_that_are_not_hdr(tmp_path, rows, warning):
    """That all of them are not HDR is told by the import: a list of nothing but warnings tells nothing."""
    codes = np.full((10, 10, 3), 120, np.uint8)
    codes[:rows] = 253
    Image.fromarray(codes).save(tmp_path / "a.png")
    pose = np.eye(4)
    pose[2, 3] = 1.0
    view = View("a", "train", tmp_path / "a.png", 10, 10, 9.0, 9.0, 5.0, 5.0, pose, encoded=True)
    facts = examined(view)
    assert facts.clipped_share == pytest.approx(0.1 * rows)
    assert view_warning(facts, 1.0) == warning


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


def test_files_that_are_no_radiance(tmp_path):
    write_exr(tmp_path / "cut.exr", PIXELS)
    (tmp_path / "cut.exr").write_bytes((tmp_path / "cut.exr").read_bytes()[:-60])
    write_channels(tmp_path / "depth.exr", {"Z": PIXELS[..., 0].copy()})
    codes = {"missing.exr": "image-missing", "text.exr": "image-unreadable"}
    codes |= {"cut.exr": "image-unreadable", "depth.exr": "image-channels"}
    codes |= dict.fromkeys(("a.png", "a.jpg", "a.tif", "a.hdr", "a.webp", "a.heic"), "image-unreadable")
    codes |= dict.fromkeys(("a.bmp", "a.dng"), "image-format")
    for name, code in codes.items():
        path = tmp_path / name
        if name.startswith(("text", "a.")):
            path.write_bytes(b"not an image")
        error = error_of(read_radiance, path)
        assert error.code == code and str(path) in error.text, name
        assert "WebP" in error.text or not name.startswith("a.")  # what can be read
        if name.endswith(("missing.exr", "text.exr")):
            assert error_of(read_size, path).code == code


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


def test_ids_from_png(tmp_path):
    Image.fromarray((IDS * 300).astype(np.uint16)).save(tmp_path / "deep.png")
    palette = Image.fromarray(IDS.astype(np.uint8), mode="P")
    palette.putpalette(list(RNG.integers(0, 256, 768)))
    palette.save(tmp_path / "palette.png")
    colour = np.stack([IDS, IDS // 2, IDS // 3], axis=-1)
    Image.fromarray(colour.astype(np.uint8)).save(tmp_path / "colour.png")
    np.testing.assert_array_equal(read_ids(tmp_path / "deep.png"), IDS * 300)
    np.testing.assert_array_equal(read_ids(tmp_path / "palette.png"), IDS)
    np.testing.assert_array_equal(read_ids(tmp_path / "colour.png"), IDS * 65536 + IDS // 2 * 256 + IDS // 3)
    assert read_size(tmp_path / "deep.png") == (7, 5)


def test_images_that_are_no_ids(tmp_path):
    write_exr(tmp_path / "a.exr", PIXELS)
    write_channels(tmp_path / "n.exr", {"Y": np.full((2, 2), np.nan, np.float32)})
    Image.fromarray(IDS.astype(np.uint8)).save(tmp_path / "a.jpg")
    (tmp_path / "t.png").write_text("no image")
    for name, code in {"t.png": "image-unreadable", "m.png": "image-missing"}.items():
        assert error_of(read_ids, tmp_path / name).code == code
    for name in ("a.exr", "n.exr", "a.jpg"):
        assert error_of(read_ids, tmp_path / name).code == "mask-not-ids"
