# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Brackets that time and exposure data do not tell apart from different views: their content decides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from benchmarks.dng import Shot, mosaic_of, write_dng
from fipt_blender.core.photographs.brackets import find_groups
from fipt_blender.core.photographs.exif import describe
from fipt_blender.core.photographs.likeness import SIDE, Likeness, small_picture
from fipt_blender.core.photographs.preparation import Group, Photograph
from fipt_blender.core.photographs.reading import list_photographs
from samples.photographs import exif, write_jpeg

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
    return find_groups(photographs, "auto", Likeness(folder))


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
    likeness = Likeness(tmp_path)
    assert likeness(first, second) is True
    (tmp_path / "b.jpg").write_bytes(b"\xff\xd8 cut")
    assert Likeness(tmp_path)(first, second) is None
