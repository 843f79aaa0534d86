"""`ingest` end to end: captures become capture.json; suspicious photographs are converted or told of."""

from __future__ import annotations

import argparse
import io
import json
import os
import shutil
from collections import Counter
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from fipt_blender.core import conventions
from fipt_blender.core.__main__ import main
from fipt_blender.core.capture import checks, images, photograph
from fipt_blender.core.capture.distortion import Undistortion, undistorted_pinhole
from fipt_blender.core.capture.encoded import srgb_decoded, srgb_encoded
from fipt_blender.core.capture.exr_file import ExrFile
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.capture.ingest import add_arguments
from fipt_blender.core.capture.ingest import run as run_command
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.run_files import read_capture
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from samples.capture_files import (
    level_pose,
    make_samples,
    radiance,
    write_colmap,
    write_fipt_real,
    write_fipt_synthetic,
    write_mesh,
    write_transforms,
)
from samples.image_files import write_tiff
from samples.ingesting import edited_json, put, run_ingest, set_pixels, warnings
from samples.photographs import exif
from samples.refusals import error_of


@pytest.fixture
def run(tmp_path):
    return RunFolder(tmp_path / "run")


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_masks_of_pixels_to_leave_out(tmp_path, run, model):
    """They are undistorted with their photograph; a missing one is reported before anything is written."""
    samples = make_samples(2, model=model)
    write_transforms(tmp_path / "in", samples)
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["frames"][0]["mask_path"] = "masks/a.png"
    error = error_of(run_ingest, tmp_path / "in", run)
    assert error.code == "image-missing" and "masks" in error.text and not run.root.exists()
    (tmp_path / "in" / "masks").mkdir()
    mask = np.full((samples[0].height, samples[0].width), 255, np.uint8)
    mask[:, :10] = 0
    Image.fromarray(mask).save(tmp_path / "in" / "masks" / "a.png")
    run_ingest(tmp_path / "in", run)
    first, second = load_capture(run).views
    assert second.masked() is None and first.masked().shape == (first.height, first.width)
    assert first.masked()[:, :6].all() and not first.masked()[:, 12:].any()
    assert (first.mask.is_relative_to(run.root)) == (model == "OPENCV")
    kept = json.loads(run.ingest_json.read_text())
    assert kept.pop("up")["source"] == "format" and kept == json.loads(run.capture_json.read_text())


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
@pytest.mark.parametrize("masked", [False, True])
def test_transparent_pixels_are_left_out(tmp_path, run, model, masked):
    samples = make_samples(2, model=model)
    write_transforms(tmp_path / "in", samples)
    pixels = np.random.default_rng(0).integers(30, 200, (32, 48, 4)).astype(np.uint8)
    pixels[..., 3] = 255
    pixels[:, 36:, 3] = 0
    pixels[:, 20:30, 3] = 1
    (tmp_path / "in" / "images" / "000_0001.exr").unlink()
    Image.fromarray(pixels).save(tmp_path / "in" / "images" / "000_0001.png")
    if masked:
        (tmp_path / "in" / "masks").mkdir()
        mask = np.full((32, 48), 255, np.uint8)
        mask[:, :10] = 0
        Image.fromarray(mask).save(tmp_path / "in" / "masks" / "a.png")
        with edited_json(tmp_path / "in" / "transforms.json") as data:
            data["frames"][0]["mask_path"] = "masks/a.png"
    assert "image-transparent" in warnings(run_ingest(tmp_path / "in", run))
    first, second = load_capture(run).views
    assert second.masked() is None
    left_out = first.masked()
    assert left_out[:, -6:].all() and not left_out[:, 14:28].any() and left_out[:, :6].all() == masked


def test_pixels_that_a_file_does_not_hold_are_left_out(tmp_path, run):
    write_transforms(tmp_path / "in", make_samples(2))
    planes = np.random.default_rng(0).uniform(0.1, 1.0, (3, 20, 30)).astype(np.float32)
    window = {"displayWindow": ((0, 0), (47, 31)), "dataWindow": ((6, 4), (35, 23))}
    file = tmp_path / "in" / "images" / "000_0001.exr"
    OpenEXR.File({**window, "compression": OpenEXR.ZIP_COMPRESSION}, dict(zip("RGB", planes, strict=True))).write(
        str(file)
    )
    messages = run_ingest(tmp_path / "in", run)
    told = next(message for message in messages if message.get("code") == "image-transparent")
    assert "1 photographs" in told["text"] and "61 %" in told["text"]
    left_out = load_capture(run).views[0].masked()
    assert not left_out[4:24, 6:36].any() and left_out.sum() == 48 * 32 - 20 * 30


def test_held_back_views_leave_each_view_once(tmp_path, run):
    samples = make_samples(8)
    write_transforms(tmp_path / "in", samples)
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["val_filenames"] = [frame["file_path"] for frame in data["frames"][3:]]
    run_ingest(tmp_path / "in", run, views=5)
    views = load_capture(run).views
    assert sorted(view.name for view in views) == [f"images/{sample.stem}" for sample in samples]


def test_cameras_of_a_solve_that_ran_away_are_named(tmp_path, run):
    samples = make_samples(30)
    for index, sample in enumerate(samples[26:]):
        sample.pose[:3, 3] = 30.0 + 40.0 * index, 5.0, 0.0
    write_transforms(tmp_path / "in", samples)
    told = [message for message in run_ingest(tmp_path / "in", run) if message.get("code") == "cameras-astray"]
    assert len(told) == 1 and "4 of 30" in told[0]["text"] and "images/026_0001" in told[0]["text"]


def test_an_import_is_resumed_until_a_photograph_or_mesh_beside_it_changes(tmp_path):
    write_colmap(tmp_path / "in", make_samples(3), text=True)
    arguments = argparse.ArgumentParser()
    add_arguments(arguments)
    parsed = arguments.parse_args([str(tmp_path / "in" / "sparse" / "0"), str(tmp_path / "run")])

    def made():
        run_command(parsed, Reporter())
        return (tmp_path / "run" / "ingest.json").stat().st_mtime_ns

    first = made()
    assert made() == first
    os.utime(tmp_path / "in" / "images" / "001_0001.exr", (1, 1))
    second = made()
    assert second != first and made() == second
    write_mesh(tmp_path / "in" / "mesh.obj")
    assert made() != second


def test_transforms_become_views_in_metres(tmp_path, run):
    samples = make_samples(9, up=(0.0, 1.0, 0.0))
    write_transforms(tmp_path / "in", samples)
    write_mesh(tmp_path / "room.obj")
    run.create(make_settings("draft"))
    messages = run_ingest(tmp_path / "in", run, up_axis="y", scale=0.5, mesh=tmp_path / "room.obj", hold_back=4)
    assert warnings(messages) == ["mesh-elsewhere"]  # hardly any camera sees the triangle
    assert messages[-1]["type"] == "done" and messages[-1]["data"]["held_back"] == 2
    assert [message["fraction"] for message in messages if message["type"] == "progress"][-1] >= 0.8
    assert run.read().preset == "draft"  # settings are not changed
    capture = load_capture(run)
    assert capture.source == "transforms" and capture.mesh == tmp_path / "room.obj"
    np.testing.assert_allclose(capture.world_from_source, conventions.world_from_source("y", 0.5))
    assert [view.split for view in capture.views].index("held_back") == 2
    assert len(capture.train) == 7 and len(capture.held_back) == 2
    for index, (view, sample) in enumerate(zip(capture.views, samples, strict=True)):
        x, y, z = sample.pose[:3, 3]
        np.testing.assert_allclose(view.camera_to_world[:3, 3], [0.5 * x, -0.5 * z, 0.5 * y], atol=1e-9)
        assert view.camera_to_world.dtype == np.float64
        assert (view.fx, view.fy, view.cx, view.cy) == sample.lens.parameters
        np.testing.assert_allclose(view.radiance(), radiance(index, view.width, view.height), rtol=2.0**-11)
        origins, directions = view.rays()
        assert origins.shape == directions.shape == (view.width * view.height, 3)
    assert [view.radiance().shape for view in capture.views[:2]] == [(32, 48, 3), (48, 32, 3)]
    assert capture.views[0].part_ids() is None and capture.views[0].semantic_ids() is None
    assert not run.images.exists()  # nothing had to be converted


def test_fipt_synthetic_through_the_command(tmp_path, run, monkeypatch):
    rng = np.random.default_rng(3)
    poses = [level_pose(rng, np.array([0.0, 1.0, 0.0])) for _ in range(4)]
    write_fipt_synthetic(tmp_path / "in", {"train": poses[:3], "val": poses[3:]})
    monkeypatch.setattr("fipt_blender.core.__main__.claim_stdout", io.StringIO)
    assert main(["ingest", str(tmp_path / "in"), str(run.root), "--hold-back=0"]) == 0
    capture = load_capture(run)
    assert [view.name for view in capture.held_back] == ["val/000"]
    assert capture.mesh is None
    np.testing.assert_array_equal(capture.views[2].part_ids(), 3)
    np.testing.assert_array_equal(capture.views[2].semantic_ids(), 50)
    assert run.read() == make_settings()


@pytest.mark.parametrize("up", [(0, -1, 0), (0, 0, 1), (0, 1, 0), (-1, 0, 0)])
def test_level_cameras_tell_which_way_is_up(tmp_path, run, up):
    write_fipt_real(tmp_path / "in", make_samples(6, up=np.array(up, float)))
    run_ingest(tmp_path / "in", run)
    mean_down = np.mean([view.camera_to_world[:3, 1] for view in load_capture(run).views], axis=0)
    assert mean_down[2] < -0.5 and np.abs(mean_down[:2]).max() < 0.5


@pytest.mark.parametrize("write", [write_transforms, lambda root, samples: write_colmap(root, samples, False)])
def test_distorted_images_and_masks_are_undistorted(tmp_path, run, write):
    samples = make_samples(3, model="OPENCV")
    write(tmp_path / "in", samples)
    ids = np.random.default_rng(0).integers(2**24 - 9, 2**24, (32, 48))
    write_exr(tmp_path / "in" / "parts" / "000_0001.exr", ids)
    messages = run_ingest(tmp_path / "in", run, hold_back=0)
    assert messages[-1]["data"]["undistorted"] == 3
    for view, sample in zip(load_capture(run).views, samples, strict=True):
        pinhole = undistorted_pinhole(sample.lens, sample.width, sample.height)
        assert view.image.is_relative_to(run.images)
        assert (view.width, view.height) == (pinhole.width, pinhole.height) != (sample.width, sample.height)
        assert (view.fx, view.fy, view.cx, view.cy) == (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy)
        assert view.radiance().shape == (view.height, view.width, 3)
    first = load_capture(run).views[0]
    assert first.part_ids().shape == (first.height, first.width)
    assert set(np.unique(first.part_ids())) <= set(np.unique(ids))
    paths = [view["image"] for view in json.loads(run.capture_json.read_text())["views"]]
    assert all(path.startswith("images/") for path in paths)  # the run folder can be moved


@pytest.mark.parametrize("value", [0.4, 1e-7, 1e6], ids=["usual", "dark", "bright"])
def test_large_photographs_are_rewritten_with_the_bits_that_they_have(tmp_path, run, monkeypatch, value):
    """Codes of 8 bits as such without a loss, HDR as half floats where these have its range."""
    monkeypatch.setattr(photograph, "EXACT_PIXELS", 500)
    samples = make_samples(2, model="OPENCV")
    write_transforms(tmp_path / "in", samples)
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        hdr, old = (tmp_path / "in" / frame["file_path"] for frame in data["frames"])
        data["frames"][1]["file_path"] = f"images/{old.stem}.jpg"
    old.unlink()
    jpeg = old.with_suffix(".jpg")
    write_exr(hdr, waves(samples[0]) * np.float32(value))
    Image.fromarray((255.0 * waves(samples[1])).astype(np.uint8)).save(jpeg, quality=98)
    run_ingest(tmp_path / "in", run, hold_back=0)
    views = load_capture(run).views
    assert [view.encoded for view in views] == [False, True] and views[1].image.suffix == ".png"
    exact = [
        Undistortion(sample.lens, sample.width, sample.height).image(read_radiance(image))
        for sample, image in zip(samples, (hdr, jpeg), strict=True)
    ]
    np.testing.assert_allclose(views[0].radiance(), exact[0], rtol=5e-4)
    is_half = OpenEXR.File(str(views[0].image)).channels()["RGB"].pixels.dtype == np.float16
    assert is_half == (value == 0.4)
    error = srgb_encoded(views[1].radiance()) - srgb_encoded(exact[1])
    assert np.abs(error).max() < 0.51 / 255.0  # rounding


def test_photographs_of_a_named_color_space(tmp_path, run):
    """Log codes of 16 bits become HDR images of the run, whose highest values are brighter than white."""
    samples = make_samples(2)
    write_transforms(tmp_path / "in", samples)
    error = error_of(run_ingest, tmp_path / "in", run, colorspace="slog")
    assert error.code == "colorspace-unknown" and not run.root.exists()
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        for frame, sample in zip(data["frames"], samples, strict=True):
            codes = np.full((sample.height, sample.width, 3), 420.0 / 1023.0)  # 18 % grey
            codes[:5] = 1.0
            old = tmp_path / "in" / frame["file_path"]
            old.unlink()
            path = old.with_suffix(".tif")
            frame["file_path"] = f"images/{path.name}"
            write_tiff(path, np.round(65535.0 * codes).astype(np.uint16))
    run_ingest(tmp_path / "in", run, hold_back=0, colorspace="S-Log3 S-Gamut3.Cine")
    views = load_capture(run).views
    assert not any(view.encoded for view in views)
    np.testing.assert_allclose(views[0].radiance()[[0, -1], 0], np.outer([38.421, 0.18], np.ones(3)), rtol=1e-3)


def test_photographs_without_distortion_that_the_disk_lacks_are_refused(tmp_path, run, monkeypatch):
    write_transforms(tmp_path / "in", make_samples(2, model="OPENCV"))
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    error = error_of(run_ingest, tmp_path / "in", run)
    assert error.code == "disk-space" and not run.root.exists()


def waves(sample):
    """Smooth values between 0.2 and 0.8, (height, width, 3)."""
    y, x = np.mgrid[: sample.height, : sample.width] / np.float32(40.0)
    return np.stack([0.5 + 0.3 * np.sin(x), 0.5 + 0.3 * np.cos(y), 0.6 + 0.0 * x], axis=-1)


def test_names_splits_and_poses(tmp_path, run):
    """The format's held-back views override --hold-back, and poses are made exact."""
    samples = make_samples(3)
    samples[0].pose[:3, :3] += 2e-4 * np.random.default_rng(0).normal(size=(3, 3))  # nearly orthonormal
    write_transforms(tmp_path / "in", samples)
    (tmp_path / "in" / "images" / "002_0001.exr").rename(tmp_path / "in" / "002_0001.exr")
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["frames"][2]["file_path"] = "../in/002_0001.exr"
        data["frames"].append({**data["frames"][0]})  # a photograph has one camera
        data["test_filenames"] = ["images/001_0001.exr"]
    run_ingest(tmp_path / "in", run, hold_back=2)
    views = load_capture(run).views
    assert [view.name for view in views] == ["images/000_0001", "images/001_0001", "002_0001"]
    assert [view.split for view in views] == ["train", "held_back", "train"]
    rotation = views[0].camera_to_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


# --- suspicious photographs --------------------------------------------------------------------------------


@pytest.mark.parametrize(("value", "options"), [(-1e-5, {}), (-0.1, {"clamp_negative": True})])
def test_negative_values_are_clamped_in_a_copy(tmp_path, run, value, options):
    write_transforms(tmp_path / "in", make_samples(2))
    set_pixels(tmp_path, lambda pixels: put(pixels, value))
    assert warnings(run_ingest(tmp_path / "in", run, **options)) == ["image-negative"]
    views = load_capture(run).views
    assert views[1].image.is_relative_to(run.images) and not views[0].image.is_relative_to(run.images)
    original = read_radiance(tmp_path / "in" / "images" / "001_0001.exr")
    np.testing.assert_array_equal(views[1].radiance(), np.maximum(original, 0.0))


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("decode", [lambda codes: codes / 255.0, lambda codes: srgb_decoded(codes / 255.0)])
def test_eight_bit_values_in_an_exr_are_noticed(tmp_path, run, decode, half):
    write_transforms(tmp_path / "in", make_samples(2))
    codes = np.random.default_rng(0).integers(0, 256, (48, 32, 3))
    write_exr(tmp_path / "in" / "images" / "001_0001.exr", decode(codes), half)
    assert "image-maybe-ldr" in warnings(run_ingest(tmp_path / "in", run))


def test_dark_hdr_is_not_taken_for_ldr():
    dark = np.random.default_rng(0).random((64, 64, 3), np.float32).astype(np.float16).astype(np.float32)
    assert not checks.pixel_statistics(None, dark).looks_ldr


def highlight():
    """A warm highlight (64, 64, 3), much brighter than its surroundings."""
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    noise = np.random.default_rng(0).lognormal(0.0, 0.05, (64, 64, 3))
    return np.exp(-8.0 * (x**2 + y**2))[..., None] * [40.0, 28.0, 15.0] * noise + 0.1


def test_clipped_highlights_are_noticed_and_a_lamp_of_even_radiance_is_none():
    def clipped(pixels):
        return checks.pixel_statistics(None, pixels.astype(np.float16).astype(np.float32)).clipped

    cut = np.minimum(highlight(), 10.0)
    assert clipped(cut) == pytest.approx((highlight() >= 10.0).any(axis=2).mean(), abs=2e-3)
    assert clipped(highlight()) == 0.0
    cut[10:30, 10:30] = [50.0, 40.0, 30.0]
    assert clipped(cut) == 0.0


def test_the_header_of_each_file_is_read_once_and_its_pixels_are_decoded_once(tmp_path, run, monkeypatch):
    """Of photographs with and without distortion, and masks; large ones get a small copy."""
    samples = [make_samples(1, model="OPENCV")[0], *make_samples(3)[1:]]
    write_transforms(tmp_path / "in", samples)
    codes = np.random.default_rng(0).integers(9, 200, (32, 48, 3)).astype(np.uint8)
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["frames"][2]["file_path"] = "images/002_0001.png"
        data["frames"][0]["mask_path"] = "masks/a.png"
    (tmp_path / "in" / "masks").mkdir()
    Image.fromarray(codes[..., 0]).save(tmp_path / "in" / "masks" / "a.png")
    (tmp_path / "in" / "images" / "002_0001.exr").unlink()
    Image.fromarray(codes).save(tmp_path / "in" / "images" / "002_0001.png", exif=exif(1.0 / 50.0))
    opened = Counter()
    for name, of in (("_open", lambda file, *_, **__: file.path), ("_oiio_input", lambda path, _: path)):
        owner = ExrFile if name == "_open" else images
        real = getattr(owner, name)
        counted = lambda *args, of=of, real=real, **kinds: opened.update([of(*args, **kinds)]) or real(*args, **kinds)  # noqa: E731
        monkeypatch.setattr(owner, name, counted)
    monkeypatch.setattr(photograph, "PREVIEW_SIDE", 40)
    run_ingest(tmp_path / "in", run, keep_poses=True)
    files = [path for folder in ("images", "masks") for path in (tmp_path / "in" / folder).iterdir()]
    assert opened == dict.fromkeys(files, 2) and len(files) == 4  # for the header, and for the pixels
    views = load_capture(run).views
    for view, entry in zip(views, read_capture(run.capture_json).views, strict=True):
        shown = read_radiance(run.resolve(entry.preview))
        assert max(shown.shape) == 40 < max(view.width, view.height)
        assert shown.mean() == pytest.approx(view.radiance().mean(), rel=0.02)  # compressed with losses
    assert not views[1].image.is_relative_to(run.root)  # needed no change
    opened.clear()
    for view in (*views, *views):  # as several stages do at the resolution of light
        assert view.resized(20, 20).radiance().shape == (20, 20, 3)
    assert opened == {view.image: 1 for view in views}


def test_a_room_of_an_impossible_size_asks_for_its_scale(tmp_path, run):
    """A solve has no unit: a room 25 m high is told of, with the scale that a usual one would need."""
    write_colmap(tmp_path / "in", make_samples(3), text=True)
    corners = np.array([[x, y, z] for x in (0.0, 30.0) for y in (0.0, 40.0) for z in (0.0, 25.0)])
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 2 3", "f 2 3 4"]
    (tmp_path / "in" / "scene.obj").write_text("\n".join(lines))
    messages = run_ingest(tmp_path / "in", run, up_axis="z")
    told = next(message for message in messages if message.get("code") == "size-implausible")
    assert "25 m high" in told["text"] and "0.1 times" in told["remedy"]
    right = run_ingest(tmp_path / "in", RunFolder(tmp_path / "again"), up_axis="z", scale=0.1)
    assert "size-implausible" not in warnings(right)
