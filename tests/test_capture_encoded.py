# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that are not HDR: their codes, their EXIF, and what `ingest` keeps and says of them."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.encoded import (
    file_exposure,
    load_codes,
    read_encoded,
    srgb_decoded,
    srgb_encoded,
)
from fipt_blender.core.capture.images import read_radiance, read_size, write_exr
from fipt_blender.core.capture.ingest import IngestOptions, ingest
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.views.survey import photograph_facts, view_warning
from samples.capture_files import make_samples, write_transforms
from samples.deep_images import write_deep_png, write_deep_tiff
from samples.photographs import exif, write_jpeg
from samples.small_rooms import BOX, make_room

CODES = np.random.default_rng(3).integers(0, 256, (6, 8, 3)).astype(np.uint8)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.TIFF"])
def test_codes_come_back(tmp_path, name):
    Image.fromarray(CODES).save(tmp_path / name)
    pixels = read_radiance(tmp_path / name)
    assert pixels.dtype == np.float32 and read_size(tmp_path / name) == (8, 6)
    assert np.array_equal(np.round(srgb_encoded(pixels) * 255.0), CODES)


def test_grey_alpha_palette_and_sixteen_bits(tmp_path):
    grey = CODES[..., 0]
    alpha = np.dstack([CODES, grey])
    Image.fromarray(alpha).save(tmp_path / "alpha.png")
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "deep.png")
    Image.fromarray(CODES).convert("P").save(tmp_path / "palette.png")
    assert np.array_equal(np.round(srgb_encoded(read_encoded(tmp_path / "alpha.png")) * 255), CODES)
    wanted = np.repeat(grey[..., None], 3, axis=-1)
    for name in ("grey.png", "deep.png"):
        assert np.array_equal(np.round(srgb_encoded(read_encoded(tmp_path / name)) * 255), wanted)
    assert read_encoded(tmp_path / "palette.png").shape == (6, 8, 3)


@pytest.mark.parametrize("channels", [3, 4])
def test_colors_keep_all_sixteen_bits(tmp_path, channels):
    codes = np.random.default_rng(4).integers(0, 65536, (6, 8, channels)).astype(np.uint16)
    paths = [write_deep_png(tmp_path / "a.png", codes)]
    for order, packed in ((o, p) for o in "<>" for p in (False, True)):
        name = f"{'little' if order == '<' else 'big'}-{packed}.tif"
        paths.append(write_deep_tiff(tmp_path / name, codes, order, packed))
    for path in paths:
        assert np.array_equal(load_codes(path, "PNG" if path.suffix == ".png" else "TIFF"), codes[..., :3]), (
            path.name
        )
        values = srgb_encoded(read_encoded(path).astype(np.float64))
        assert np.abs(values * 65535.0 - codes[..., :3]).max() < 0.1


def test_a_damaged_file_of_sixteen_bits_is_refused(tmp_path):
    codes = np.zeros((60, 80, 3), np.uint16)
    for path in (
        write_deep_png(tmp_path / "a.png", codes),
        write_deep_tiff(tmp_path / "a.tif", codes, "<", True),
    ):
        path.write_bytes(path.read_bytes()[:-40])
        with pytest.raises(FiptError) as error:
            read_encoded(path)
        assert error.value.code == "image-unreadable"


def test_values_of_other_depths_are_refused(tmp_path):
    Image.fromarray(CODES[..., 0].astype(np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(FiptError, match="float32") as error:
        read_encoded(tmp_path / "a.tif")
    assert error.value.code == "image-unreadable"


def test_srgb_is_undone():
    values = np.linspace(0.0, 1.0, 1001)
    assert np.abs(srgb_encoded(srgb_decoded(values)) - values).max() < 1e-6
    assert srgb_decoded(np.float32([0.0, 1.0])).tolist() == [0.0, 1.0]


def test_exposures_of_files(tmp_path):
    path = write_jpeg(tmp_path / "a.jpg", CODES, exif(1.0 / 50.0, aperture=4.0, iso=400))
    assert file_exposure(path) == pytest.approx(4.0 / 50.0 / 16.0, rel=1e-3)
    assert file_exposure(write_jpeg(tmp_path / "b.jpg", CODES, exif(None))) is None
    (tmp_path / "c.jpg").write_bytes(path.read_bytes()[:40])
    assert file_exposure(tmp_path / "c.jpg") is None
    assert file_exposure(tmp_path / "d.exr") is None


def test_captures_of_both_kinds(tmp_path):
    """A photograph of codes stays where it is; one with distortion is resampled and stays marked."""
    samples = make_samples(3)
    samples[1] = make_samples(2, model="OPENCV")[1]
    write_transforms(tmp_path / "in", samples)
    path = tmp_path / "in" / "transforms.json"
    data = json.loads(path.read_text())
    for index in (0, 1):
        old = tmp_path / "in" / data["frames"][index]["file_path"]
        pixels = np.full((*read_radiance(old).shape[:2], 3), 100 + index, np.uint8)
        old.unlink()
        write_jpeg(old.with_suffix(".jpg"), pixels, exif(1.0 / 60.0))
        data["frames"][index]["file_path"] = str(
            old.with_suffix(".jpg").relative_to(tmp_path / "in").as_posix()
        )
    path.write_text(json.dumps(data))
    run, stream = RunFolder(tmp_path / "run"), io.StringIO()
    ingest(tmp_path / "in", run, IngestOptions(hold_back=0), Reporter(stream))
    views = load_capture(run).views
    assert [view.encoded for view in views] == [True, True, False]
    assert views[0].exposure == pytest.approx(1.0 / 60.0 / 64.0, rel=1e-3) and views[2].exposure is None
    assert views[0].image.suffix == ".jpg" and views[1].image.suffix == ".exr"
    middle = read_radiance(views[1].image)[20, 20]
    assert np.abs(srgb_encoded(middle) * 255.0 - 101.0).max() < 1.0
    assert "encoded" not in json.loads(run.capture_json.read_text())["views"][2]
    messages = [parse_message(line) for line in stream.getvalue().splitlines()]
    (warning,) = [m for m in messages if m["type"] == "warning" and m["code"] == "images-not-hdr"]
    assert warning["text"].startswith("2 of 3 photographs") and "Make Capture" in warning["remedy"]


@pytest.mark.parametrize(("rows", "warning"), [(1, ""), (2, "20.0 % of its pixels look over-exposed")])
def test_check_views_warns_of_single_photographs_that_are_not_hdr(tmp_path, rows, warning):
    """That all of them are not HDR is told by the import: a list of nothing but warnings tells nothing."""
    room = make_room(BOX)
    codes = np.full((10, 10, 3), 120, np.uint8)
    codes[:rows] = 253
    Image.fromarray(codes).save(tmp_path / "a.png")
    pose = np.eye(4)
    pose[2, 3] = 1.0
    view = View("a", "train", tmp_path / "a.png", 10, 10, 9.0, 9.0, 5.0, 5.0, pose, encoded=True)
    facts = photograph_facts(view, room)
    assert facts["clipped_share"] == pytest.approx(0.1 * rows) and not facts["looks_ldr"]
    assert view_warning(facts | {"room_share": 1.0, "much_off": False}) == warning


def test_hdr_captures_say_nothing_of_it(tmp_path):
    write_transforms(tmp_path / "in", make_samples(2))
    stream = io.StringIO()
    ingest(tmp_path / "in", RunFolder(tmp_path / "run"), IngestOptions(hold_back=0), Reporter(stream))
    assert "not HDR" not in stream.getvalue()
    write_exr(tmp_path / "x.exr", np.ones((2, 2, 3)))
    assert file_exposure(tmp_path / "x.exr") is None
