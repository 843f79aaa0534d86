"""`prepare`, step `merge`: brackets become radiance on one scale; motion, clipping, bad files."""

from __future__ import annotations

import errno
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.run.messages import Reporter
from fipt_blender.prepare import frames, merge_step, merging
from fipt_blender.prepare.calibration import Survey, calibrate, camera_of, correct_exposures
from fipt_blender.prepare.exif import describe
from fipt_blender.prepare.frames import Stored, load, upright
from fipt_blender.prepare.merging import measure_noise, merge_exposures, sensor_noise
from fipt_blender.prepare.motion import Motion
from fipt_blender.prepare.preparation import (
    Group,
    Photograph,
    Preparation,
    PreparationFolder,
    read_preparation,
    write_preparation,
)
from fipt_blender.prepare.response import LEVELS, recover_response, srgb_curve
from samples import prepared_captures, refusals
from samples.dng import Shot, mosaic_of, write_dng
from samples.image_files import icc_profile, in_primaries, write_exr_layers
from samples.photographs import exif, smooth_radiance, write_jpeg
from samples.prepared_captures import facts as facts_of

BLACK, WHITE = 256, 16383
SHUTTERS = (1 / 400, 1 / 100, 1 / 25)
TALL, WIDE = 48, 64


@pytest.fixture
def source(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


@pytest.fixture
def folder(tmp_path: Path) -> PreparationFolder:
    return PreparationFolder(tmp_path / "out")


def merge(source: Path, folder: PreparationFolder, *changes: str) -> Reporter:
    """Read and merge in full size, unless another working width is among the changes."""
    return prepared_captures.prepare(source, folder.root, "read,merge", "working_width=0", *changes)


def write_raw(folder: Path, radiance: np.ndarray, first: int = 0, minute: int = 0, turn: int = 1) -> None:
    """A bracket of RAW photographs with a little read noise; radiance 1 fills the middle one by a fifth."""
    rng = np.random.default_rng([first, minute])
    for index, shutter in enumerate(SHUTTERS):
        light = 0.2 * radiance * shutter * 100.0
        values = mosaic_of(light) * (WHITE - BLACK) + BLACK + rng.normal(0.0, 2.0, light.shape[:2])
        shot = Shot(shutter, time=f"2026:05:01 12:{minute:02d}:{index:02d}", orientation=turn)
        path = folder / f"IMG_{first + index}.dng"
        write_dng(path, np.clip(np.round(values), 0, WHITE).astype(np.uint16), shot, BLACK, WHITE)


def camera_response(linear: np.ndarray) -> np.ndarray:
    """An S-shaped response, 0 to 1."""
    power = linear ** (1.0 / 2.1)
    return power + 0.3 * power * (1.0 - power) * (2.0 * power - 1.0)


def write_jpegs(folder: Path, radiance: np.ndarray, first: int = 0, minute: int = 0) -> None:
    for index, shutter in enumerate(SHUTTERS):
        linear = np.clip(0.2 * radiance * shutter * 100.0, 0.0, 1.0)
        codes = np.round(255.0 * camera_response(linear)).astype(np.uint8)
        write_jpeg(folder / f"IMG_{first + index}.jpg", codes, exif(shutter, 60.0 * minute + index))


def error_of(image: np.ndarray, truth: np.ndarray) -> float:
    """Median relative error after a common factor."""
    ratio = image / truth
    return float(np.median(np.abs(ratio / np.median(ratio) - 1.0)))


def test_raw_brackets_become_radiance_on_one_scale(source: Path, folder: PreparationFolder) -> None:
    truths = [smooth_radiance(0), 0.25 * smooth_radiance(1)]
    for index, truth in enumerate(truths):
        write_raw(source, truth, 3 * index, index)
    reporter = merge(source, folder)
    images = [read_radiance(folder.image(group)) for group in read_preparation(folder).used_groups]
    ratios = [np.median(image / truth) for image, truth in zip(images, truths, strict=True)]
    assert ratios[1] == pytest.approx(ratios[0], rel=3e-3)
    assert all(error_of(image, truth) < 0.01 for image, truth in zip(images, truths, strict=True))
    assert not reporter.warnings
    facts = facts_of(folder, "merge")
    assert [entry["moved_share"] for entry in facts["images"]] == [0.0, 0.0]
    # Radiance 1 saturates the exposure in the middle.
    assert ratios[0] == pytest.approx(0.2, rel=0.01)


def test_a_raw_value_is_not_stretched(tmp_path: Path) -> None:
    """LibRaw by itself scales a photograph by its own maximum."""
    mosaic = np.full((64, 64), round(0.8 * (WHITE - BLACK)) + BLACK, np.uint16)
    write_dng(tmp_path / "a.dng", mosaic, Shot(0.01, orientation=6), BLACK, WHITE)
    photograph = describe(tmp_path / "a.dng", "a.dng")
    assert photograph.shutter == pytest.approx(0.01) and photograph.orientation == 6
    stored = load(tmp_path / "a.dng", photograph)
    np.testing.assert_allclose(stored.values, 0.8, atol=1e-4)
    np.testing.assert_allclose(stored.matrix, np.eye(3), atol=1e-3)
    np.testing.assert_allclose(stored.balance, 1.0)


def test_jpeg_brackets_recover_the_cameras_response(source: Path, folder: PreparationFolder) -> None:
    truths = [smooth_radiance(seed, 96, 128, 1.2) for seed in range(3)]
    for index, truth in enumerate(truths):
        write_jpegs(source, truth, 3 * index, index)
    merge(source, folder)
    for group, truth in zip(read_preparation(folder).used_groups, truths, strict=True):
        well = (0.2 * truth.max(axis=-1) / 4 < 0.8) & (0.2 * truth.min(axis=-1) * 4 > 0.05)
        assert error_of(read_radiance(folder.image(group))[well], truth[well]) < 0.03
    facts = facts_of(folder, "merge")
    curve = np.array(facts["response"]["curves"][0])
    codes = np.arange(30, 226)
    linear = np.linspace(0.0, 1.0, 4096)
    true = np.interp(codes / 255.0, camera_response(linear), linear)
    ratio = curve[codes] / true
    np.testing.assert_allclose(ratio / ratio[100], 1.0, atol=0.04)
    assert 0.0 < facts["response"]["uncertainty"] < 0.05


def test_the_response_from_exact_codes_and_its_uncertainty() -> None:
    rng = np.random.default_rng(3)
    times = np.array([0.25, 1.0, 4.0])
    linear = np.linspace(0.0, 1.0, 4096)
    groups = []
    for _ in range(4):
        light = np.exp(rng.uniform(-5.0, 0.5, (3000, 1, 3))) * times[None, :, None]
        codes = 255.0 * np.interp(light, linear, camera_response(linear))
        groups.append(np.where(light < 0.98, codes, np.nan))
    found = recover_response(groups, [times] * 4)
    truth = np.interp(np.arange(LEVELS) / 255.0, camera_response(linear), linear)
    ratio = found.curve[20:240] / truth[20:240, None]
    assert np.abs(ratio / np.median(ratio, axis=0) - 1.0).max() < 0.02
    assert (np.diff(found.curve, axis=0) > 0.0).all() and np.all(found.curve[-1] == 1.0)
    noisy = [codes + rng.normal(0.0, 4.0, codes.shape) for codes in groups]
    assert recover_response(noisy, [times] * 4).uncertainty.mean() > 2.0 * found.uncertainty.mean()


def test_single_photographs_pass_with_a_warning(source: Path, folder: PreparationFolder) -> None:
    codes = np.full((6, 8, 3), 128, np.uint8)
    write_jpeg(source / "a.jpg", codes, exif(1 / 60))
    write_jpeg(source / "b.jpg", codes, exif(1 / 60, 60.0))
    reporter = merge(source, folder)
    assert {"no-brackets", "response-unknown"} <= {message["code"] for message in reporter.warnings}
    np.testing.assert_allclose(read_radiance(folder.images / "a.exr"), srgb_curve()[128, 0], rtol=0.02)


@pytest.mark.parametrize(("suffix", "orientation"), [(".jpg", 1), (".jpg", 6), (".tif", 6), (".png", 3)])
def test_photographs_of_other_primaries_are_merged_upright(
    source: Path, folder: PreparationFolder, suffix: str, orientation: int
) -> None:
    truth = np.kron(0.1 + 0.5 * np.random.default_rng(1).random((3, 4, 3)), np.ones((16, 16, 1)))
    codes = np.round(255.0 * srgb_encoded(in_primaries(truth, "P3"))).astype(np.uint8)
    profile, tags = icc_profile("P3", "sRGB"), exif(1 / 60, orientation=orientation)
    options = {"quality": 100, "subsampling": 0, "icc_profile": profile, "exif": tags}
    Image.fromarray(codes).save(source / f"a{suffix}", **options)
    merge(source, folder, "response=srgb")
    found, wanted = read_radiance(folder.images / "a.exr"), upright(truth, orientation)
    np.testing.assert_allclose(found[8::16, 8::16], wanted[8::16, 8::16], atol=0.01)


def test_linear_pictures_keep_their_values_and_a_layer_is_chosen_by_its_name(
    source: Path, folder: PreparationFolder
) -> None:
    truth = 3.0 * smooth_radiance(5).astype(np.float32)
    beauty = {name: np.ascontiguousarray(truth[..., index]) for index, name in enumerate("RGB")}
    layers = {"rgba": dict.fromkeys("RGB", np.full((TALL, WIDE), 0.2, np.float32)), "beauty": beauty}
    write_exr_layers(source / "a.exr", layers, parts=True)
    caught = refusals.error_of(merge, source, folder)
    assert caught.code == "image-layers" and "--layer" in caught.remedy
    merge(source, folder, "layer=beauty")
    np.testing.assert_allclose(read_radiance(folder.images / "a.exr"), truth, rtol=1e-3)


def test_what_is_clipped_in_all_exposures_is_told(source: Path, folder: PreparationFolder) -> None:
    truth = np.ones((TALL, WIDE, 3))
    truth[8:16, 20:32] = 1000.0
    write_raw(source, truth)
    reporter = merge(source, folder)
    assert [message["code"] for message in reporter.warnings] == ["clipped"]
    mask = np.asarray(Image.open(folder.clipped / "IMG_0.png"))
    assert mask[9:15, 21:31].min() == 255 and mask[20:].max() == 0
    image = read_radiance(folder.images / "IMG_0.exr")
    # At least as bright as the ceiling of the darkest exposure; the surroundings are right.
    assert image[9:15, 21:31].min() > 3.9 and image[30, 40] == pytest.approx(np.full(3, 0.2), rel=0.02)
    facts = facts_of(folder, "merge")["images"][0]
    assert facts["clipped_share"] == pytest.approx(np.mean(mask == 255), abs=1e-6)


def test_bands_of_rows_leave_no_traces(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_raw(source, smooth_radiance(6))
    images = []
    for rows in (7, 1000):
        for module in (frames, merging):
            monkeypatch.setattr(module, "BAND_ROWS", rows)
        merge(source, PreparationFolder(tmp_path / str(rows)))
        images.append(read_radiance(tmp_path / str(rows) / "images" / "IMG_0.exr"))
    np.testing.assert_array_equal(*images)


def test_the_working_size_is_a_mean_over_areas(source: Path, folder: PreparationFolder) -> None:
    truth = smooth_radiance(8, 96, 128)
    write_raw(source, truth)
    merge(source, folder, "working_width=64")
    small = truth.reshape(48, 2, 64, 2, 3).mean((1, 3))
    image = read_radiance(folder.images / "IMG_0.exr")
    assert image.shape == small.shape and error_of(image, small) < 0.01


def test_the_last_row_is_no_noisier_if_long_exposures_are_a_little_off() -> None:
    """A fraction of a pixel would leave it to the darkest exposure alone."""
    rng = np.random.default_rng(5)
    exposures, noise = (0.01, 0.1, 1.0), sensor_noise(1e-4, 1e-3)
    values = [0.3 * e + rng.normal(0.0, 3e-3, (40, 60, 3)).astype(np.float32) for e in exposures]
    held = [frames.Frame(v.astype(np.float32), np.zeros(v.shape, bool)) for v in values]
    for shift in (0.7, -0.7):
        motions = [Motion(), Motion(), Motion(y=shift / 60.0)]
        radiance, _, _ = merging.merge_group(held, exposures, motions, noise)
        deviation = np.abs(radiance / 0.3 - 1.0).mean(axis=(1, 2))
        assert deviation[[0, -1]].max() < 2.5 * np.median(deviation)


def test_merging_is_unbiased_and_prefers_the_less_noisy() -> None:
    rng = np.random.default_rng(1)
    gain, read, truth = 1e-3, 2e-3, 0.02
    exposures = [1.0, 4.0, 16.0]
    values = [truth * e + rng.normal(0.0, np.sqrt(gain * truth * e + read**2), (200, 200, 3)) for e in exposures]
    clipped = [value >= 1.0 for value in values]
    merged, none = merge_exposures(values, clipped, exposures, sensor_noise(gain, read))
    assert merged.mean() == pytest.approx(truth, rel=1e-3) and not none.any()
    alone = values[2] / 16.0
    assert merged.std() < alone.std()


def test_noise_is_measured_from_a_photograph() -> None:
    rng = np.random.default_rng(2)
    ramp = np.linspace(0.01, 0.8, 512)[None].repeat(256, 0)
    gain, read = 2e-4, 1e-3
    noisy = ramp + rng.normal(0.0, np.sqrt(gain * ramp + read**2))
    found = measure_noise(noisy.astype(np.float32), 2)
    assert found[0] == pytest.approx(gain, rel=0.5) and found[1] == pytest.approx(read, rel=1.0)


def test_exposures_that_headers_round_are_corrected() -> None:
    def shot(shutter: float) -> Photograph:
        return Photograph("a", "raw", 8, 6, shutter=shutter, exposure=shutter)

    bracket = [shot(1 / 250), shot(1 / 60), shot(1 / 15)]
    true = np.log([1 / 256, 1 / 64, 1 / 16])
    nominal = np.log([item.exposure for item in bracket])
    ratios = tuple(np.diff(true) - np.diff(nominal))
    survey = Survey(ratios=ratios)
    corrections, largest = correct_exposures([bracket] * 3, [survey] * 3)
    found = np.array([corrections[(item.shutter, 0.0, 0.0, item.exposure)] for item in bracket])
    np.testing.assert_allclose(np.diff(found + nominal), np.diff(true))
    assert found.mean() == pytest.approx(0.0) and 0.0 < largest < 0.1


def test_a_bracket_of_borders_is_merged_without_blur(source: Path, folder: PreparationFolder, tmp_path: Path) -> None:
    """Squares of one radiance, four pixels of the sensor long, become the pixels of the merged image."""
    squares = np.exp(np.random.default_rng(4).uniform(-1.0, 1.0, (48, 64, 3)))
    write_raw(source, squares.repeat(4, 0).repeat(4, 1))
    merge(source, folder, "working_width=64")
    image = read_radiance(next((tmp_path / "out" / "images").glob("*.exr")))
    assert image.shape == squares.shape
    assert np.quantile(np.abs(image / squares / np.median(image / squares) - 1.0), 0.99) < 0.02


def test_a_stranger_in_a_bracket_is_left_out(source: Path, folder: PreparationFolder, tmp_path: Path) -> None:
    truth = smooth_radiance(11, 120, 160, 0.5)
    write_raw(source, truth)
    other = tmp_path / "other"
    write_raw(other, smooth_radiance(12, 120, 160, 0.5))
    shutil.copy(other / "IMG_2.dng", source / "IMG_2.dng")
    reporter = merge(source, folder)
    assert "exposures-left-out" in {message["code"] for message in reporter.warnings}
    assert facts_of(folder, "merge")["images"][0]["left_out"] == ["IMG_2.dng"]
    assert error_of(read_radiance(folder.images / "IMG_0.exr"), truth) < 0.02


def test_groups_that_can_not_be_merged_are_refused(source: Path, folder: PreparationFolder) -> None:
    write_raw(source, smooth_radiance(0))
    merge(source, folder)
    before = read_preparation(folder)
    image = folder.images / "IMG_0.exr"
    content = image.read_bytes()
    first = before.photographs[0]
    unknown = (replace(first, exposure=None), *before.photographs[1:])
    turned = (replace(first, orientation=6), *before.photographs[1:])
    for photographs, groups, code in (
        (unknown, before.groups, "exposure-unknown"),
        (turned, before.groups, "bracket-mixed"),
        (before.photographs, (replace(before.groups[0], used=False),), "no-photographs"),
    ):
        write_preparation(folder, replace(before, photographs=photographs, groups=groups))
        assert refusals.error_of(merge, source, folder).code == code
        assert image.read_bytes() == content and not folder.facts("merge").exists()


@pytest.mark.parametrize("content", [None, b"", b"II*" + bytes(500), "half"])
def test_a_raw_file_that_is_damaged_later_is_named(
    source: Path, folder: PreparationFolder, content: bytes | str | None
) -> None:
    write_raw(source, smooth_radiance(0))
    path = source / "IMG_1.dng"
    photograph, whole = describe(path, "IMG_1.dng"), path.read_bytes()
    path.unlink()
    if content is not None:
        path.write_bytes(whole[: len(whole) // 2] if isinstance(content, str) else content)
    caught = refusals.error_of(load, path, photograph)
    assert caught.code == "photograph-unreadable" and "IMG_1.dng" in caught.text
    if content == "half":
        assert "IMG_1" in refusals.error_of(merge, source, folder).text
        assert not folder.images.exists()


def test_a_stopped_merge_goes_on_with_the_other_groups(
    source: Path, folder: PreparationFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    for index in range(2):
        write_raw(source, smooth_radiance(index), 3 * index, index)
    plain, images, written = Path.write_bytes, [], ["IMG_0.exr"]

    def full(self: Path, data: bytes) -> int:
        if ".exr" in self.name:
            images.append(self)
            if len(images) == 2:
                plain(self, bytes(data)[:100])
                raise OSError(errno.ENOSPC, "No space left on device")
        return plain(self, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    caught = refusals.error_of(merge, source, folder)
    assert caught.code == "disk-full" and "Free some space" in caught.remedy
    monkeypatch.undo()
    assert [path.name for path in folder.images.iterdir()] == ["IMG_0.exr"]
    assert not folder.facts("merge").exists()
    monkeypatch.setattr(
        merge_step, "write_exr", lambda path, *rest, **more: written.append(path.name) or write_exr(path, *rest, **more)
    )
    merge(source, folder)
    assert written == ["IMG_0.exr", "IMG_3.exr"]
    merge(source, folder)
    assert len(written) == 2  # nothing has changed
    before = read_preparation(folder)
    write_preparation(folder, replace(before, groups=before.groups[:1]))
    merge(source, folder)
    assert [path.name for path in folder.images.iterdir()] == ["IMG_0.exr"]


def test_raw_files_of_several_cameras_get_the_colors_of_their_own(tmp_path: Path) -> None:
    photographs = [Photograph(f"{name}.dng", "raw", 8, 6, model=name, exposure=1.0) for name in "AB"]
    groups = tuple(Group(item.model, (item.path,)) for item in photographs)
    matrices = {"A": np.eye(3), "B": 2.0 * np.eye(3)}
    surveys = [Survey(color=Stored(np.empty(0), matrix=matrices[item.model])) for item in photographs]
    found, _ = calibrate(Preparation(tmp_path, tuple(photographs), groups), surveys, Reporter())
    for item in photographs:
        np.testing.assert_array_equal(found.colors[camera_of(item)][1], matrices[item.model])
