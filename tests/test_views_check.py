"""Photographs that do not agree with the others are left out or corrected."""

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.checks.registration import CLEARLY_BETTER, Fit, register
from fipt_blender.core.checks.view_check import ViewCheck, check_views
from fipt_blender.core.pixels.mixed_pixels import mark_pure
from fipt_blender.core.pixels.store import LEFT_OUT, PixelStore, create_pixels, fill_pixels
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.settings import make_settings
from samples.ingesting import edited_json
from samples.small_captures import (
    CAMERAS,
    COLORS,
    PANEL,
    PANEL_RADIANCE,
    SmallCapture,
    matt,
    photograph_room,
    write_run,
)
from samples.small_rooms import BOX, block, make_room, table

EXTRA_CAMERAS = [[[1.5, 0.2, 1.8], [-1.2, -0.4, 0.6]], [[-0.3, 1.7, 1.5], [0.1, -1.5, 0.8]]]
WIDTH, HEIGHT = 96, 64


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    """Boxes of several colours in a box, eight views of 96 x 64 pixels."""
    quads, colors = [*BOX, PANEL], [*COLORS, [0.0] * 3]
    for low, high, color in (
        ((-0.6, 1.1, 0.0), (0.0, 1.7, 1.2), [0.7, 0.5, 0.1]),
        ((0.9, 1.0, 0.0), (1.6, 1.7, 0.8), [0.1, 0.2, 0.6]),
        ((0.8, -1.2, 0.0), (1.3, -0.7, 1.5), [0.75, 0.75, 0.7]),
        ((-1.3, -1.0, 0.0), (-0.8, -0.5, 0.6), [0.15, 0.1, 0.1]),
    ):
        sides = block(low, high)[1:]  # without the bottom
        quads += sides
        colors += [color] * len(sides)
    room, materials = make_room(quads, parts="objects"), matt(np.repeat(np.array(colors), 2, axis=0))
    lamps = table([12, 13], PANEL_RADIANCE)
    return photograph_room(room, materials, lamps, cameras=[*CAMERAS, *EXTRA_CAMERAS], scale=2, spp=32)


def run_check(
    root: Path, capture: SmallCapture, faces: Sequence[int] = (), **settings: bool
) -> tuple[PixelStore, ViewCheck, list[dict]]:
    """The pixels after the check of a capture's views, its result, and its messages; the objects are the parts.

    Args:
        faces: views that are the faces of one panorama.
        settings: changes of the draft preset.
    """
    run = write_run(root / "run", capture)
    with edited_json(run.capture_json) as data:
        for index in faces:
            data["views"][index]["panorama"] = "panorama"
    pixels = create_pixels(root / "pixels", load_capture(run).train)
    fill_pixels(pixels, capture.room, lambda _: None)
    part = capture.room.triangle_object
    mark_pure(pixels, capture.room, part, lambda _: None)
    stream = io.StringIO()
    check = check_views(pixels, capture.room, part, make_settings("draft", settings), Reporter(stream))
    return pixels, check, [m for line in stream.getvalue().splitlines() if (m := parse_message(line))]


def turned(capture: SmallCapture, index: int, degrees: float, axis: int = 1) -> SmallCapture:
    """The capture with one camera rotated about one of its own axes."""
    turn, poses = np.eye(4), list(capture.poses)
    turn[:3, :3] = turn_by(np.radians(degrees) * np.eye(3)[axis])
    poses[index] = poses[index] @ turn
    return replace(capture, poses=poses)


def exposed(capture: SmallCapture, index: int, factor: float) -> SmallCapture:
    images = list(capture.images)
    images[index] = images[index] * np.float32(factor)
    return replace(capture, images=images)


@pytest.fixture(scope="module")
def checked(
    capture: SmallCapture, tmp_path_factory: pytest.TempPathFactory
) -> tuple[PixelStore, ViewCheck, list[dict]]:
    return run_check(tmp_path_factory.mktemp("good"), capture)


def test_good_photographs_are_left_as_they_are_dark_ones_too(
    capture: SmallCapture, checked: tuple[PixelStore, ViewCheck, list[dict]], tmp_path: Path
) -> None:
    """A capture without any lamp is valid."""
    plain = replace(capture, images=[np.ones_like(image) for image in capture.images])
    for pixels, check, messages in (checked, run_check(tmp_path, plain)):
        assert check == ViewCheck() and messages == []
        assert (pixels.triangle != LEFT_OUT).all()


def test_turned_views_are_left_out_by_name_and_do_not_take_good_ones_with_them(
    capture: SmallCapture, tmp_path: Path
) -> None:
    spoilt = turned(turned(capture, 1, 2.0), 6, -2.0, 0)
    pixels, check, (message,) = run_check(tmp_path, spoilt)
    assert set(check.left_out) == {"train/001", "train/006"} and check.exposure == {}
    assert all(1.3 < shift < 4.0 for shift in check.left_out.values())  # 1.8 in the centre, more towards the border
    assert message["code"] == "view-misaligned" and message["text"].startswith("2 of 8") and message["remedy"]
    assert "train/001" in message["text"] and "train/006" in message["text"]
    gone = np.asarray(pixels.triangle) == LEFT_OUT
    assert set(pixels.view_of(np.flatnonzero(gone))) == {1, 6} and gone.sum() == 2 * WIDTH * HEIGHT
    assert not pixels.pure[gone].any()


def test_a_rolled_view_and_a_photograph_of_somewhere_else_are_left_out(capture: SmallCapture, tmp_path: Path) -> None:
    """A roll displaces the centre of the image little, and no small rotation aligns the other one."""
    images = list(capture.images)
    images[4] = images[4][::-1, ::-1]
    _, check, _ = run_check(tmp_path, replace(turned(capture, 3, 5.0, 2), images=images))
    assert set(check.left_out) == {"train/003", "train/004"}


def test_where_most_views_are_misaligned_none_is_left_out(capture: SmallCapture, tmp_path: Path) -> None:
    """Few degrees of most views: nobody knows which of them are right."""
    spoilt = capture
    for index, degrees in enumerate([2.5, -2.0, 3.0, 0.0, -2.5, 2.0, 0.0, -3.0]):
        spoilt = turned(spoilt, index, degrees, index % 2)
    _, check, _ = run_check(tmp_path, spoilt)
    assert check.left_out == {}


def test_exposures_are_corrected_but_of_views_that_are_left_out(
    capture: SmallCapture, checked: tuple[PixelStore, ViewCheck, list[dict]], tmp_path: Path
) -> None:
    plain = checked[0]
    spoilt = exposed(exposed(exposed(turned(capture, 3, 2.0), 3, 1.5), 5, 0.7), 2, 1.5)
    pixels, check, messages = run_check(tmp_path, spoilt)
    assert list(check.left_out) == ["train/003"] and set(check.exposure) == {"train/002", "train/005"}
    assert check.exposure["train/002"] == pytest.approx(1.5, rel=0.02)
    assert check.exposure["train/005"] == pytest.approx(0.7, rel=0.03)
    assert [message["code"] for message in messages] == ["view-misaligned", "view-exposure"]
    assert "train/002 (× 1.5" in messages[1]["text"]
    ratio = np.asarray(pixels.radiance) / np.maximum(np.asarray(plain.radiance), 1e-6)
    by_view = [np.median(ratio[pixels.rows(index)]) for index in range(8) if index != 3]
    assert np.ptp(by_view) < 0.02 * np.mean(by_view)


def test_faces_of_a_panorama_have_one_exposure(capture: SmallCapture, tmp_path: Path) -> None:
    spoilt = exposed(exposed(capture, 5, 1.5), 2, 1.5)
    _, check, _ = run_check(tmp_path, spoilt, faces=(2, 5))
    assert set(check.exposure) == {"train/002", "train/005"} and len(set(check.exposure.values())) == 1
    assert check.exposure["train/002"] == pytest.approx(1.5, rel=0.02)


def test_both_can_be_switched_off(capture: SmallCapture, tmp_path: Path) -> None:
    spoilt = exposed(turned(capture, 3, 2.0), 5, 0.7)
    pixels, check, messages = run_check(tmp_path, spoilt, reject_views=False, correct_exposure=False)
    assert check == ViewCheck() and messages == [] and (pixels.triangle != LEFT_OUT).all()
    _, check, _ = run_check(tmp_path / "two", spoilt, reject_views=False)
    assert check.left_out == {} and list(check.exposure) == ["train/005"]


INTRINSICS = np.array([[100.0, 0.0, 60.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]])


def test_registration_finds_a_shift_and_stays_on_a_plain_wall(rng: np.random.Generator) -> None:
    y, x = np.mgrid[:80, :120]

    def picture(shift: float) -> np.ndarray:
        return np.where(((x - shift) // 23 + y // 19) % 2 == 0, -0.5, 0.5) + 0.3 * np.sin((x - shift) / 9.0)

    known = np.ones((80, 120), bool)
    fit = register(picture(4.0), picture(0.0), known, INTRINSICS)
    assert fit.shift == pytest.approx(4.0, rel=0.25) and fit.improvement < 0.5
    fit = register(picture(0.0), picture(0.0), known, INTRINSICS)
    assert fit.shift < 0.1 and fit.difference < 1e-3
    noise = 0.02 * rng.normal(size=(2, 80, 120))
    # Noise alone displaces it a little, but never lowers the residual clearly.
    fit = register(noise[0], noise[1], known, INTRINSICS)
    assert fit.shift < 3.0 and fit.improvement > CLEARLY_BETTER
    assert register(noise[0], noise[1], known & (x < 2), INTRINSICS).improvement == 1.0


@pytest.mark.parametrize("strip", [np.s_[:, 40:42], np.s_[30:32, :], np.s_[::2, ::2]])
def test_an_overlap_too_narrow_to_compare_speaks_against_no_view(
    strip: tuple[slice, ...], rng: np.random.Generator
) -> None:
    """Over 200 pixels are known, but hardly any of them has neighbours to interpolate between."""
    known = np.zeros((160, 130), bool)
    known[strip] = True
    photograph, predicted = rng.normal(size=(2, *known.shape))
    assert known.sum() >= 200
    assert register(photograph, predicted, known, INTRINSICS) == Fit(0.0, 1.0, 0.0, 0.0)
