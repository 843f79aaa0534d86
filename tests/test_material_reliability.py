# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns on parts stay as they are seen, however fine; paint becomes one colour, whatever its errors."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.shadings import roughness_levels
from fipt_blender.core.material.cell_errors import DrawnPixels
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.part_colors import room_detail
from fipt_blender.core.material.reliability import PlaceColors, part_detail
from fipt_blender.core.material.seen import Box, seen_cells

SIDE, PIXEL = 64, 0.02  # places along a wall, and their width in metres
BOX = Box(np.zeros(3) - 0.1, 4.0)
VIEWS, SEES = 8, 0.7  # the views, and the share of them that sees a place
TINT = np.array([1.0, 0.9, 0.75])
# Relative errors of base colour: noise of the pixels, errors of a view that are alike over 3 and over 15
# pixels, errors of light that all views have in common, alike over 12 pixels.
NOISE, NEAR, FAR, LIGHT = 0.03, 0.015, 0.02, 0.01
CONTRASTS = (0.02, 0.05, 0.1, 0.3)
KINDS = ("lines", "dots", "print", "grain")


def pattern(kind: str, width: int, rng: np.random.Generator) -> np.ndarray:
    """(SIDE, SIDE) where a pattern is dark (1) and where not (0), or in between; `width` in places."""
    row, column = np.mgrid[0:SIDE, 0:SIDE]
    if kind == "lines":
        return ((column // width) % 3 == 0).astype(float)
    if kind == "dots":
        return (((column // width) % 3 == 0) & ((row // width) % 3 == 0)).astype(float)
    if kind == "print":  # words of random length in lines of text
        words = np.repeat(rng.random((SIDE, SIDE)) < 0.6, width, axis=0)[:SIDE]
        words = np.repeat(words, width, axis=1)[:, :SIDE]
        return (words & ((row // width) % 2 == 0)).astype(float)
    blocks = rng.random((SIDE, SIDE)).repeat(width, axis=0).repeat(width, axis=1)
    return blocks[:SIDE, :SIDE]  # grain


def smooth(rng: np.random.Generator, width: float) -> np.ndarray:
    """(SIDE, SIDE) random field with a standard deviation of 1 that is alike over `width` places."""
    field = gaussian_filter(rng.normal(size=(SIDE, SIDE)), width)
    return (field - np.median(field)) / field.std()


def seen(true: np.ndarray, rng: np.random.Generator, light: float = 1.0) -> tuple[PlaceColors, np.ndarray]:
    """A wall of these base colours (SIDE, SIDE, 3) as the views show it, and (K, 3) the truth at its places.

    Args:
        light: factor of the error of light that all views share.
    """
    common = 1.0 + light * LIGHT * smooth(rng, 12.0)
    errors = [NEAR * smooth(rng, 3.0) + FAR * smooth(rng, 15.0) + NOISE * smooth(rng, 0.0) for _ in range(VIEWS)]
    views = (true * (common + np.array(errors))[..., None]).reshape(VIEWS, -1, 3)
    sees = rng.random(views.shape[:2]) < SEES
    kept = sees.any(axis=0)
    weight = np.stack([sees[0::2].sum(axis=0), sees[1::2].sum(axis=0)]).astype(float)[:, kept]
    sums = (views * sees[..., None]).reshape(-1, 2, *views.shape[1:]).sum(axis=0)[:, kept]
    row, column = np.divmod(np.flatnonzero(kept), SIDE)
    position = PIXEL * np.stack([column + 0.5, row + 0.5, np.zeros(len(row))], axis=1)
    # Standard errors come from the spread between views, half of which is taken as common to all.
    error = np.hypot(LIGHT, np.hypot(NEAR, FAR) / np.sqrt(SEES * VIEWS)) * np.median(true)
    halves = sums / np.maximum(weight, 1.0)[..., None]
    color = sums.sum(axis=0) / weight.sum(axis=0)[:, None]
    part = np.zeros(len(row), int)
    places = PlaceColors(position, part, color, halves, weight, np.full(len(row), error))
    return places, true.reshape(-1, 3)[kept]


def as_parts(walls: list[PlaceColors]) -> PlaceColors:
    along = {"halves": 1, "weight": 1}
    joined = {
        name: np.concatenate([getattr(wall, name) for wall in walls], axis=along.get(name, 0))
        for name in ("position", "color", "halves", "weight", "error")
    }
    return PlaceColors(part=np.repeat(np.arange(len(walls)), [len(wall.part) for wall in walls]), **joined)


def shrunk(walls: list[PlaceColors]) -> list[np.ndarray]:
    """What becomes of the estimate at the places of each wall."""
    places = as_parts(walls)
    median = np.stack([np.median(wall.color, axis=0) for wall in walls])
    detail = part_detail(places, median, PIXEL, BOX)
    values = detail.shrink(places.color, places.position, places.part, BOX)
    return np.split(values, np.flatnonzero(np.diff(places.part)) + 1)


def psnr(values: np.ndarray, true: np.ndarray) -> float:
    return float(-10.0 * np.log10(((values - true) ** 2).mean()))


def correlation(values: np.ndarray, true: np.ndarray) -> float:
    values, true = values - values.mean(axis=0), true - true.mean(axis=0)
    return float((values * true).sum() / np.sqrt((values**2).sum() * (true**2).sum() + 1e-30))


@pytest.mark.parametrize(("kind", "width"), [("lines", 1), ("dots", 2), ("dots", 5), ("print", 3), ("grain", 1)])
def test_patterns_stay_and_paint_beside_them_is_one_colour(kind: str, width: int) -> None:
    rng = np.random.default_rng([width, KINDS.index(kind)])
    cases = list(itertools.product((0.08, 0.7), (0.0, *CONTRASTS)))
    made = [
        seen(bright * TINT * (1.0 - contrast * pattern(kind, width, rng)[..., None]), rng) for bright, contrast in cases
    ]
    values = shrunk([places for places, _ in made])
    for (_, contrast), (places, true), result in zip(cases, made, values, strict=True):
        flat, single = psnr(np.median(places.color, axis=0), true), psnr(places.color, true)
        found = psnr(result, true)
        if contrast == 0.0:
            assert found > 50.0
            continue
        # Never worse than both, nor much worse than the better one of a pattern as weak as the errors.
        assert found > max(min(flat, single) - 0.1, max(flat, single) - 2.0)
        if contrast >= 0.1:
            assert found > 0.95 * single
            assert correlation(result, true) > 0.95 * correlation(places.color, true)


@pytest.mark.parametrize(("views", "light"), [*itertools.product((4, 8, 24), (0.0, 1.0))])
def test_errors_of_paint_are_gone(views: int, light: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.VIEWS", views)
    rng = np.random.default_rng(views)
    made = [seen(np.full((SIDE, SIDE, 3), 0.7) * TINT, rng, light) for _ in range(4)]
    for (places, true), result in zip(made, shrunk([places for places, _ in made]), strict=True):
        assert psnr(result, true) > 50.0 > psnr(places.color, true)


@pytest.mark.parametrize("height", [0.01, 0.02, 0.035])
def test_a_blotch_of_wrong_light_near_a_lamp_is_gone(height: float) -> None:
    places, _ = seen(np.full((SIDE, SIDE, 3), 0.6) * TINT, np.random.default_rng(4))
    away = ((places.position[:, :2] - [0.4, 0.8]) ** 2).sum(axis=1)
    blotch = height * np.exp(-0.5 * away / 0.15**2)[:, None]
    doubted = replace(
        places,
        color=places.color + blotch,
        halves=places.halves + blotch,
        error=np.hypot(places.error, blotch[:, 0]),  # as lamp_doubt says
    )
    assert psnr(shrunk([doubted])[0], np.median(doubted.color, axis=0)) > 50.0


def test_a_picture_on_a_wall_stays_and_the_wall_beside_it_is_plainer() -> None:
    true = np.full((SIDE, SIDE, 3), 0.7) * TINT
    rng = np.random.default_rng(5)
    true[10:24, 12:30] = [0.2, 0.3, 0.25] * (1.0 - 0.3 * pattern("print", 2, rng)[10:24, 12:30, None])
    places, true = seen(true.reshape(SIDE, SIDE, 3), rng)
    (values,) = shrunk([places])
    column, row = (places.position[:, :2] / PIXEL).T.astype(int)
    picture = (row >= 10) & (row < 24) & (column >= 12) & (column < 30)
    far = (row >= 44) | (column >= 50)
    assert psnr(values[picture], true[picture]) > 0.95 * psnr(places.color[picture], true[picture])
    assert psnr(values[far], true[far]) > psnr(places.color[far], true[far]) + 2.0


def test_what_no_two_halves_saw_has_the_median_and_other_parts_are_unchanged() -> None:
    rng = np.random.default_rng(6)
    places, _ = seen(0.6 * TINT * (1.0 - 0.3 * pattern("lines", 2, rng)[..., None]), rng)
    median = np.array([np.median(places.color, axis=0), [0.3, 0.2, 0.1], [np.nan] * 3])
    detail = part_detail(places, median, PIXEL, BOX)
    for part, expected in ((0, None), (1, median[1]), (2, places.color), (-1, places.color)):
        values = detail.shrink(places.color, places.position, np.full(len(places.part), part), BOX)
        if expected is None:
            assert correlation(values, places.color) > 0.9
        else:
            np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape), atol=1e-6)
    far = places.position + [0.0, 0.0, 1.0]  # of the same part
    values = detail.shrink(places.color, far, places.part, BOX)
    np.testing.assert_allclose(values, np.broadcast_to(median[0], values.shape), atol=1e-6)
    one = replace(places, weight=places.weight * [[1.0], [0.0]])  # nothing repeats what these views show
    values = part_detail(one, median, PIXEL, BOX).shrink(places.color, places.position, places.part, BOX)
    assert psnr(values, median[0]) > 80.0


class PlaceByPlace:
    """In place of the network: a base colour for each place of a wall (SIDE, SIDE, 3), rough, no metal."""

    box = BOX

    def __init__(self, color: np.ndarray) -> None:
        self.color = color

    def query(self, positions: np.ndarray, units: np.ndarray) -> np.ndarray:
        column, row = (positions[:, :2] / PIXEL).astype(int).T
        return np.column_stack([self.color[row, column], np.ones(len(row)), np.zeros(len(row))])


@pytest.mark.parametrize("contrast", [0.0, 0.2])
def test_the_halves_are_made_of_the_pixels_of_the_views(contrast: float) -> None:
    """Photographs of a wall in light that differs from view to view; a part of several materials stays."""
    rng = np.random.default_rng(7)
    true = 0.6 * TINT * (1.0 - contrast * pattern("dots", 2, rng)[..., None])
    row, column = (index.ravel() for index in np.mgrid[0:SIDE, 0:SIDE])
    points = PIXEL * np.stack([column + 0.5, row + 0.5, np.zeros(len(row))], axis=1).astype(np.float32)
    light = np.linspace(0.5, 2.0, VIEWS)[:, None, None] * np.ones((1, SIDE**2, 3))
    noise = np.stack([FAR * smooth(rng, 15.0) + NOISE * smooth(rng, 0.0) for _ in range(VIEWS)])
    shown = true.reshape(-1, 3) * (1.0 + noise.reshape(VIEWS, -1, 1))
    fields, part = PlaceByPlace(shown.mean(axis=0).reshape(true.shape)), (row >= SIDE // 2).astype(int)
    units = Units(np.arange(2, dtype=np.int32), np.array([True, False]))
    cells = seen_cells(BOX, [(points, part)])
    count, levels = VIEWS * SIDE**2, roughness_levels(2, 0.1, 1.0)
    shadings = ShadingStore(light.reshape(-1, 3).astype(np.float16), np.zeros((count, len(levels), 2, 3), np.float16))
    view = np.repeat(np.arange(VIEWS), SIDE**2)
    pixels = SimpleNamespace(own=(shown * light).reshape(-1, 3), view_of=lambda rows: view[rows])
    seen_by = SimpleNamespace(pixels=pixels, footprint=PIXEL)
    data = SimpleNamespace(observations=seen_by, shadings=shadings, levels=levels)
    position, unit = np.tile(points, (VIEWS, 1)), np.tile(part, VIEWS)
    found, place = np.unique(cells.find(BOX, position, unit), return_inverse=True)
    drawn = DrawnPixels(np.arange(count), position, unit, found, place)
    errors = np.full((len(cells.keys), 3), 0.022, np.float32)
    detail = room_detail(drawn, data, units, fields, cells, errors)
    values = detail.shrink(fields.query(points, part)[:, :3], points, part, BOX)
    one, truth = part == 0, true.reshape(-1, 3)
    estimate = fields.color.reshape(-1, 3)
    np.testing.assert_allclose(values[~one], estimate[~one], atol=1e-6)
    if contrast:
        assert psnr(values[one], truth[one]) > psnr(estimate[one], truth[one]) - 0.1
    else:
        assert np.ptp(values[one], axis=0).max() == 0.0 < np.ptp(estimate[one], axis=0).min()
        assert psnr(values[one], truth[one]) > 50.0
