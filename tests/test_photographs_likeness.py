"""Brackets that time and exposure data do not tell apart from different views: their content decides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from fipt_blender.prepare.brackets import SIDE, find_groups, likeness, small_picture
from fipt_blender.prepare.exif import describe
from fipt_blender.prepare.merging import moved_regions
from fipt_blender.prepare.motion import Motion, after, measure, warped
from fipt_blender.prepare.preparation import Group, Photograph
from fipt_blender.prepare.reading import list_photographs
from samples.dng import Shot, mosaic_of, write_dng
from samples.photographs import exif, smooth_radiance, write_jpeg

HEIGHT, WIDTH = 160, 240


def room_view(seed: int) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) radiance of something: smooth areas, borders and a lamp; median near 0.1."""
    rng = np.random.default_rng(seed)
    fine = ndimage.gaussian_filter(rng.normal(size=(HEIGHT, WIDTH)), 4.0)
    coarse = ndimage.gaussian_filter(rng.normal(size=(HEIGHT, WIDTH)), 25.0)
    values = 0.1 * np.exp(0.8 * (coarse > 0.0) + 1.2 * coarse / coarse.std() * 0.4 + 0.3 * fine / fine.std())
    y, x = rng.integers(20, HEIGHT - 20), rng.integers(20, WIDTH - 20)
    values[y - 6 : y + 6, x - 8 : x + 8] = 6.0
    return np.repeat(values[..., None], 3, -1)


def codes(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """A camera's JPEG values: an S-shaped response that is steeper than sRGB's."""
    power = np.clip(radiance * exposure, 0.0, 1.0) ** (1.0 / 2.2)
    return np.round(255.0 * (power + 0.3 * power * (1.0 - power) * (2.0 * power - 1.0))).astype(np.uint8)


def groups_of(folder: Path) -> list[Group]:
    photographs = [describe(folder / name, name) for name in list_photographs(folder)]
    return find_groups(photographs, "auto", likeness(folder))


def test_a_bracket_taken_by_hand_slowly_is_one_group(tmp_path: Path) -> None:
    """A tripod, seven exposures down to the lamp alone, 12 to 22 seconds apart; then another view."""
    shutters = (2.0, 0.5, 1 / 8, 1 / 30, 1 / 125, 1 / 1000, 1 / 4000)
    number, clock = 0, 0.0
    for view in (1, 2):
        radiance = room_view(view)
        for index, shutter in enumerate(shutters):
            clock += shutter + 12.0 + 10.0 * (index % 2)
            write_jpeg(tmp_path / f"{number}.jpg", codes(radiance, 3.0 * shutter), exif(shutter, clock))
            number += 1
    assert [len(group.photographs) for group in groups_of(tmp_path)] == [7, 7]


@pytest.mark.parametrize("pause", [None, 4.0, 15.0])
def test_views_of_a_walk_with_automatic_exposure_are_no_brackets(tmp_path: Path, pause: float | None) -> None:
    """A phone's photographs from view to view, with exposures that differ a little, mostly without a time."""
    for index, stops in enumerate((0.0, 0.12, 0.33, -0.4, 0.3, 0.95)):
        shutter = 0.0006 * 2.0**stops
        tags = exif(shutter, index * (pause or 0.0))
        if pause is None:
            inner = tags.get_ifd(0x8769)
            del inner[0x9003], inner[0x9291]
        radiance = room_view(10 + index)
        write_jpeg(tmp_path / f"{index}.jpg", codes(radiance, 0.2 / np.median(radiance)), tags)
    assert [len(group.photographs) for group in groups_of(tmp_path)] == [1] * 6


def test_a_bracket_without_times_held_by_hand(tmp_path: Path) -> None:
    for view in range(2):
        radiance = room_view(20 + view)
        for index, stops in enumerate((0.0, -2.0, 2.0)):
            tags = exif(0.01 * 2.0**stops)
            inner = tags.get_ifd(0x8769)
            del inner[0x9003], inner[0x9291]
            moved = np.roll(radiance, (index, 2 * index), (0, 1))
            write_jpeg(tmp_path / f"{view}{index}.jpg", codes(moved, 2.0**stops), tags)
    assert [len(group.photographs) for group in groups_of(tmp_path)] == [3, 3]


def test_content_is_looked_at_only_where_time_is_not_enough(tmp_path: Path) -> None:
    def shot(path: str, exposure: float, time: float) -> Photograph:
        return Photograph(path=path, kind="ldr", width=8, height=6, exposure=exposure, time=time)

    asked = []

    def same_view(first: Photograph, second: Photograph) -> bool | None:
        asked.append((first.path, second.path))
        return True

    quick = [shot("1", 1.0, 0.0), shot("2", 0.25, 1.0), shot("3", 4.0, 2.0)]
    assert len(find_groups(quick, "auto", same_view)) == 1 and not asked
    slow = [shot("1", 1.0, 0.0), shot("2", 0.25, 20.0), shot("3", 4.0, 40.0), shot("4", 16.0, 200.0)]
    assert [len(group.photographs) for group in find_groups(slow, "auto", same_view)] == [3, 1]
    # Each is compared with the exposure nearest to its own.
    assert asked == [("1", "2"), ("1", "3")]


def test_small_pictures_of_all_kinds_agree(tmp_path: Path) -> None:
    radiance = room_view(3)
    names = ("a.jpg", "a.png", "a.dng")
    write_jpeg(tmp_path / "a.jpg", codes(radiance, 2.0), exif(0.01))
    Image.fromarray(codes(radiance, 2.0)).save(tmp_path / "a.png")
    mosaic = np.clip(mosaic_of(radiance) * 2.0, 0.0, 1.0) * (16383 - 256) + 256
    write_dng(tmp_path / "a.dng", mosaic.astype(np.uint16), Shot(0.01), 256, 16383)
    pictures = [small_picture(tmp_path / name, describe(tmp_path / name, name)) for name in names]
    assert all(max(picture.shape) in range(SIDE - 20, SIDE + 1) for picture in pictures)
    for picture in pictures:
        assert np.isnan(picture).any() and np.nanmedian(picture) > 0.05
    shared = np.isfinite(pictures[0]) & np.isfinite(pictures[1])
    np.testing.assert_allclose(pictures[0][shared], pictures[1][shared], rtol=0.1, atol=0.01)


def test_a_photograph_that_cannot_be_read_decides_nothing(tmp_path: Path) -> None:
    first = describe(write_jpeg(tmp_path / "a.jpg", codes(room_view(1), 1.0), exif(0.01)), "a.jpg")
    second = describe(write_jpeg(tmp_path / "b.jpg", codes(room_view(1), 2.0), exif(0.02)), "b.jpg")
    assert likeness(tmp_path)(first, second) is True
    (tmp_path / "b.jpg").write_bytes(b"\xff\xd8 cut")
    assert likeness(tmp_path)(first, second) is None


@pytest.mark.parametrize("motion", [Motion(), Motion(0.01, -0.02, 0.01), Motion(0.08, 0.03, -0.02)])
def test_motion_is_measured_across_exposures(motion: Motion) -> None:
    height, width = 120, 160
    scene = 0.1 * smooth_radiance(9, 240, 320, 0.8)[..., 0]

    def shot(moved: Motion, exposure: float) -> np.ndarray:
        y, x = np.mgrid[:height, :width] + 0.5
        back = Motion(0.0, 0.0, -moved.angle)
        points = np.stack([x.ravel(), y.ravel()], -1) - width * np.array([moved.x, moved.y])
        places = back.apply(points, width, height) + [width / 2 - 0.5, height / 2 - 0.5]
        values = ndimage.map_coordinates(scene, [places[:, 1], places[:, 0]], order=3).reshape(height, width)
        return np.where(values * exposure < 1.0, values * exposure, np.nan)

    found = measure(shot(Motion(), 1.0), shot(motion, 4.0))
    rest = Motion(found.x - motion.x, found.y - motion.y, found.angle - motion.angle)
    assert rest.corner_shift(width, height) < 0.1 and found.similarity > 0.95


def test_a_bare_wall_does_not_move() -> None:
    rng = np.random.default_rng(4)
    walls = [np.full((120, 160), 0.3) + rng.normal(0.0, 0.01, (120, 160)) for _ in range(2)]
    assert measure(*walls) == Motion()


def test_motions_follow_one_another() -> None:
    first, second = Motion(0.1, -0.05, 0.3), Motion(-0.02, 0.04, -0.1)
    points = np.random.default_rng(0).uniform(0.0, 100.0, (5, 2))
    both = second.apply(first.apply(points, 120, 80), 120, 80)
    np.testing.assert_allclose(after(first, second).apply(points, 120, 80), both)


def test_warping_shifts_rows_and_marks_what_is_outside() -> None:
    values = np.arange(20.0)[:, None, None].repeat(10, 1)
    moved = warped(values, Motion(y=0.1), 0, 20)  # two rows of twenty
    np.testing.assert_allclose(moved[:18, :, 0], values[2:, :, 0])
    assert np.isnan(moved[18:]).all()


def test_what_moves_is_taken_from_one_exposure() -> None:
    still = np.ones((20, 30))
    first, second, third = still.copy(), still.copy(), still.copy()
    first[5:10, 5:10], second[5:10, 12:17] = 3.0, 3.0
    third[:, 20:] = np.nan
    choice = moved_regions([first, second, third], [np.full((20, 30), 0.01)] * 3)
    assert (choice[6:9, 6:9] == 2).all() and (choice[12:] == -1).all() and (choice[:, 24:] == -1).all()
    assert len(set(choice[5:10, 12:17].ravel())) == 1  # one region, one exposure
    noisy = [still + np.random.default_rng(i).normal(0.0, 0.03, still.shape) for i in range(3)]
    assert (moved_regions(noisy, [np.full((20, 30), 0.03)] * 3) == -1).all()
