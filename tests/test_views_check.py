# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that do not agree with the others: misaligned ones are left out, exposures are corrected."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.checks.misaligned import CLEARLY_BETTER
from fipt_blender.core.checks.registration import Fit, register
from fipt_blender.core.checks.view_check import ViewCheck
from fipt_blender.core.pixels.store import LEFT_OUT, NO_TRIANGLE, PixelStore
from samples.checked_views import run_check
from samples.small_captures import CAMERAS, COLORS, PANEL, PANEL_RADIANCE, SmallCapture, matt, photograph_room
from samples.small_rooms import BOX, make_room, table

EXTRA_CAMERAS = [[[1.5, 0.2, 1.8], [-1.2, -0.4, 0.6]], [[-0.3, 1.7, 1.5], [0.1, -1.5, 0.8]]]


def block(x: float, y: float, width: float, height: float) -> list:
    """Four sides and the top of a block on the floor, fronts outwards."""
    a, b, c, d = ([x + i * width, y + j * width] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    sides = [[[*p, 0.0], [*q, 0.0], [*q, height], [*p, height]] for p, q in ((a, b), (b, c), (c, d), (d, a))]
    return [*sides, [[*p, height] for p in (a, b, c, d)]]


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    """Boxes of several colours in a box, eight views of 144 x 96 pixels."""
    quads, colors = [*BOX, PANEL], [*COLORS, [0.0] * 3]
    for x, y, width, height, color in (
        (-0.6, 1.1, 0.6, 1.2, [0.7, 0.5, 0.1]),
        (0.9, 1.0, 0.7, 0.8, [0.1, 0.2, 0.6]),
        (0.8, -1.2, 0.5, 1.5, [0.75, 0.75, 0.7]),
        (-1.3, -1.0, 0.5, 0.6, [0.15, 0.1, 0.1]),
    ):
        quads += block(x, y, width, height)
        colors += [color] * 5
    room = make_room(quads, parts="objects")
    lamps = table([12, 13], PANEL_RADIANCE)
    materials = matt(np.repeat(np.array(colors), 2, axis=0))
    return photograph_room(room, materials, lamps, cameras=[*CAMERAS, *EXTRA_CAMERAS], scale=3, spp=24, denoise=True)


def turned(capture: SmallCapture, index: int, degrees: float, axis: int = 1) -> SmallCapture:
    """The capture with one camera rotated about one of its own axes."""
    angle = np.radians(degrees)
    turn = np.eye(4)
    i, j = [k for k in range(3) if k != axis]
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
    poses = list(capture.poses)
    poses[index] = poses[index] @ turn
    return replace(capture, poses=poses)


def exposed(capture: SmallCapture, index: int, factor: float) -> SmallCapture:
    images = list(capture.images)
    images[index] = images[index] * np.float32(factor)
    return replace(capture, images=images)


def test_good_photographs_are_left_as_they_are(capture: SmallCapture, tmp_path: Path) -> None:
    pixels, check, messages = run_check(tmp_path, capture)
    assert check == ViewCheck() and messages == []
    assert (pixels.triangle != LEFT_OUT).all()


def test_photographs_without_anything_bright_agree(capture: SmallCapture, tmp_path: Path) -> None:
    """A capture without any lamp is valid."""
    plain = [np.ones_like(image) for image in capture.images]
    assert run_check(tmp_path, replace(capture, images=plain))[1] == ViewCheck()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_view_turned_by_two_degrees_is_left_out_by_name(capture: SmallCapture, tmp_path: Path, axis: int) -> None:
    degrees = 2.0 if axis < 2 else 5.0  # a roll displaces the centre of the image little
    pixels, check, (message,) = run_check(tmp_path, turned(capture, 3, degrees, axis))
    assert list(check.left_out) == ["train/003"] and check.exposure == {}
    if axis < 2:
        assert 2.0 < check.left_out["train/003"] < 6.0  # 2.7 in the centre, more towards the border
    assert message["code"] == "view-misaligned" and "train/003" in message["text"] and message["remedy"]
    gone = np.asarray(pixels.triangle) == LEFT_OUT
    assert (pixels.view_of(np.flatnonzero(gone)) == 3).all() and gone.sum() == 144 * 96
    assert not pixels.pure[gone].any()


def test_a_photograph_of_somewhere_else(capture: SmallCapture, tmp_path: Path) -> None:
    """No small rotation aligns it."""
    images = list(capture.images)
    images[4] = images[4][::-1, ::-1]
    _, check, (message,) = run_check(tmp_path, replace(capture, images=images))
    assert list(check.left_out) == ["train/004"] and "train/004" in message["text"]


def test_two_misaligned_views_do_not_take_good_ones_with_them(capture: SmallCapture, tmp_path: Path) -> None:
    spoilt = turned(turned(capture, 1, 2.5), 6, -2.0, 0)
    _, check, (message,) = run_check(tmp_path, spoilt)
    assert set(check.left_out) == {"train/001", "train/006"}
    assert message["text"].startswith("2 of 8")


def test_where_most_views_are_misaligned_none_is_left_out(capture: SmallCapture, tmp_path: Path) -> None:
    """Few degrees of most views: nobody knows which of them are right."""
    spoilt = capture
    for index, degrees in enumerate([2.5, -2.0, 3.0, 0.0, -2.5, 2.0, 0.0, -3.0]):
        spoilt = turned(spoilt, index, degrees, index % 2)
    _, check, _ = run_check(tmp_path, spoilt)
    assert check.left_out == {}


def test_an_exposure_of_one_and_a_half_is_corrected(capture: SmallCapture, tmp_path: Path) -> None:
    plain, _, _ = run_check(tmp_path / "plain", capture)
    pixels, check, (message,) = run_check(tmp_path, exposed(capture, 2, 1.5))
    assert check.left_out == {} and list(check.exposure) == ["train/002"]
    assert check.exposure["train/002"] == pytest.approx(1.5, rel=0.02)
    assert message["code"] == "view-exposure" and "train/002 (× 1.5" in message["text"]
    ratio = np.asarray(pixels.radiance) / np.maximum(np.asarray(plain.radiance), 1e-6)
    by_view = [np.median(ratio[pixels.ranges[i] : pixels.ranges[i + 1]]) for i in range(8)]
    assert np.ptp(by_view) < 0.02 * np.mean(by_view)


def test_a_view_that_is_both_is_left_out_and_a_darker_one_corrected(capture: SmallCapture, tmp_path: Path) -> None:
    spoilt = exposed(exposed(turned(capture, 3, 2.0), 3, 1.5), 5, 0.7)
    _, check, messages = run_check(tmp_path, spoilt)
    assert list(check.left_out) == ["train/003"] and list(check.exposure) == ["train/005"]
    assert check.exposure["train/005"] == pytest.approx(0.7, rel=0.03)
    assert [message["code"] for message in messages] == ["view-misaligned", "view-exposure"]


def test_both_can_be_switched_off(capture: SmallCapture, tmp_path: Path) -> None:
    spoilt = exposed(turned(capture, 3, 2.0), 5, 0.7)
    pixels, check, messages = run_check(tmp_path, spoilt, reject_views=False, correct_exposure=False)
    assert check == ViewCheck() and messages == [] and (pixels.triangle != LEFT_OUT).all()
    _, check, _ = run_check(tmp_path / "two", spoilt, reject_views=False)
    assert check.left_out == {} and list(check.exposure) == ["train/005"]


def test_registration_finds_a_shift_and_stays_on_a_plain_wall(rng: np.random.Generator) -> None:
    intrinsics = np.array([[100.0, 0.0, 60.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]])
    y, x = np.mgrid[:80, :120]

    def picture(shift: float) -> np.ndarray:
        return np.where(((x - shift) // 23 + y // 19) % 2 == 0, -0.5, 0.5) + 0.3 * np.sin((x - shift) / 9.0)

    known = np.ones((80, 120), bool)
    fit = register(picture(4.0), picture(0.0), known, intrinsics)
    assert fit.shift == pytest.approx(4.0, rel=0.25) and fit.improvement < 0.5
    fit = register(picture(0.0), picture(0.0), known, intrinsics)
    assert fit.shift < 0.1 and fit.difference < 1e-3
    noise = 0.02 * rng.normal(size=(2, 80, 120))
    # Noise alone displaces it a little, but never lowers the residual clearly.
    fit = register(noise[0], noise[1], known, intrinsics)
    assert fit.shift < 3.0 and fit.improvement > CLEARLY_BETTER
    assert register(noise[0], noise[1], known & (x < 2), intrinsics).improvement == 1.0


@pytest.mark.parametrize("strip", [np.s_[:, 40:42], np.s_[30:32, :], np.s_[::2, ::2]])
def test_an_overlap_too_narrow_to_compare_speaks_against_no_view(
    strip: tuple[slice, ...], rng: np.random.Generator
) -> None:
    """Over 200 pixels are known, but hardly any of them has neighbours to interpolate between."""
    intrinsics = np.array([[100.0, 0.0, 60.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]])
    known = np.zeros((160, 130), bool)
    known[strip] = True
    photograph, predicted = rng.normal(size=(2, *known.shape))
    assert known.sum() >= 200
    assert register(photograph, predicted, known, intrinsics) == Fit(0.0, 1.0, 0.0, 0.0)


def test_a_good_view_that_shares_a_strip_with_the_others_is_kept(capture: SmallCapture, tmp_path: Path) -> None:

    def keep_strip(pixels: PixelStore) -> None:
        outside = np.ones((96, 144), bool)
        outside[40:43] = False
        pixels.triangle[pixels.rows(3)][outside.reshape(-1)] = NO_TRIANGLE

    pixels, check, messages = run_check(tmp_path, capture, keep_strip)
    assert np.count_nonzero(pixels.pure[pixels.rows(3)] & (pixels.triangle[pixels.rows(3)] >= 0)) > 200
    assert check.left_out == {} and messages == []
