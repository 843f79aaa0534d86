"""Expected standard errors: of synthetic pixels, and of light by the doubt about where a scan's lamps are."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.emitters import Fixture
from fipt_blender.core.light.lamp_doubt import hardly_seen, light_errors, power_errors
from fipt_blender.core.material import confidence
from fipt_blender.core.material.cell_errors import LitCells, add_light_errors, groups_of_cells
from fipt_blender.core.material.confidence import UNIFORM_DEVIATION, LinearisedPixels, linearise, standard_errors
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.pixel_samples import RADIANCE_FLOOR
from fipt_blender.core.material.projection import color_lines
from fipt_blender.core.material.seen import Box, SeenCells
from samples.small_rooms import make_room

LEVELS = np.linspace(0.02, 1.0, 6).astype(np.float32)
VIEWS, EACH = 6, 4


def synthetic(
    cells: int, light: np.ndarray, noise: float, rng: np.random.Generator, gloss: float = 0.3
) -> tuple[LinearisedPixels, np.ndarray, np.ndarray]:
    """Dielectric cells lit by `light` (cells,) in VIEWS views of EACH pixels; estimated and true colours.

    All cells are one group. Relative errors of the shadings are correlated within a view and larger where it
    is dark. The estimate is the least-squares colour, as in training.
    """
    true = rng.uniform(0.2, 0.8, (cells, 3))
    cell = np.repeat(np.arange(cells), VIEWS * EACH)
    view = np.tile(np.repeat(np.arange(VIEWS), EACH), cells)
    count = len(cell)
    diffuse = np.repeat(light[cell][:, None], 3, axis=1)
    lobe = gloss * rng.uniform(0.5, 1.5, count) * light[cell]
    by_level = lobe[:, None] / (1.0 + LEVELS)
    specular = np.broadcast_to(by_level[:, :, None, None], (count, len(LEVELS), 2, 3))

    def at(color: np.ndarray, radiance: np.ndarray) -> LinearisedPixels:
        return linearised(radiance, color[cell], diffuse, specular)

    at_truth = at(true, np.ones((count, 3)))
    rendered = 1.0 - at_truth.residual
    errors = rng.standard_normal((cells, VIEWS, 3))[cell, view] + 0.1 * rng.standard_normal((count, 3))
    radiance = rendered + noise * (rendered + RADIANCE_FLOOR) * errors
    weight = 1.0 / (rendered + RADIANCE_FLOOR) ** 2
    slope = at_truth.by_color
    change = np.stack(
        [
            np.bincount(cell, (weight * slope * (radiance - rendered))[:, c])
            / np.bincount(cell, (weight * slope**2)[:, c])
            for c in range(3)
        ],
        axis=1,
    )
    color = true + change
    return at(color, radiance), color, true


def linearised(
    radiance: np.ndarray,
    color: np.ndarray,
    diffuse: np.ndarray,
    specular: np.ndarray,
    material: tuple[float, float] = (0.5, 0.0),
    error: tuple[float, float] = (0.0, 0.0),
) -> LinearisedPixels:
    """Pixels of this material and its errors, linearised at these base colours (N, 3)."""
    materials, errors = (np.tile(np.float32(values), (len(color), 1)) for values in (material, error))
    lines = partial(color_lines, ShadingStore(diffuse, specular, LEVELS), np.arange(len(color)))
    return linearise(radiance, lines, color, materials, errors)


def errors_of(pixels: LinearisedPixels) -> np.ndarray:
    """Standard errors of :func:`synthetic` pixels."""
    cell, rest = np.divmod(np.arange(len(pixels.residual)), VIEWS * EACH)
    return standard_errors(pixels, cell, np.zeros_like(cell), rest // EACH)


def test_changes_are_those_of_the_rendering() -> None:
    """By a step of base colour, and by errors of roughness and metallic."""
    rng = np.random.default_rng(0)
    radiance, color, diffuse = rng.uniform(0.1, 0.9, (3, 50, 3))
    specular = rng.uniform(0.0, 2.0, (50, 6, 2, 3))

    def at(color: np.ndarray, roughness: float, metallic: float) -> LinearisedPixels:
        errors = (0.02, 0.05)
        return linearised(radiance, color, diffuse, specular, (roughness, metallic), errors)

    here = at(color, 0.5, 0.4)
    for change, low, high in (
        (here.by_color, here, at(color + 1.0, 0.5, 0.4)),
        (2.0 * here.by_roughness, at(color, 0.48, 0.4), at(color, 0.52, 0.4)),
        (2.0 * here.by_metallic, at(color, 0.5, 0.35), at(color, 0.5, 0.45)),
    ):
        np.testing.assert_allclose(low.residual - high.residual, change, atol=1e-4)


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_expected_errors_of_colour_are_the_actual_errors(monkeypatch, noise):
    """Only independent noise of each view; root mean squares over dark and over bright cells."""
    monkeypatch.setattr(confidence, "COMMON", 0.0)
    monkeypatch.setattr(confidence, "FLOOR", 0.0)
    light = np.repeat([0.02, 0.1, 1.0], 300)
    pixels, color, true = synthetic(900, light, noise, np.random.default_rng(1), gloss=0.0)
    expected = errors_of(pixels)
    actual = np.sqrt(((color - true) ** 2).mean(axis=1))
    for level in np.unique(light):
        cells = light == level
        ratio = np.sqrt((expected[cells] ** 2).mean() / (actual[cells] ** 2).mean())
        assert 0.7 < ratio < 1.5, level
    means = [actual[light == level].mean() for level in np.unique(light)]
    assert means[0] > 2 * means[1] > 3 * means[2]  # the levels differ
    order = np.argsort(confidence.confidence(expected))
    binned = [np.sqrt((actual[part] ** 2).mean()) for part in np.array_split(order, 3)]
    assert binned[0] > binned[1] > binned[2]


def test_colour_is_uncertain_where_it_compensates_an_uncertain_material():
    """A metallic that is wrong by 0.1 changes the diffuse reflectance of a surface without gloss by 10 %."""
    pixels, color, _ = synthetic(200, np.full(200, 0.5), 0.002, np.random.default_rng(2), gloss=0.0)
    known = errors_of(pixels)
    # Without gloss a metallic of 0.1 takes a tenth of the reflected light away.
    unknown = errors_of(replace(pixels, by_metallic=-0.1 * color.repeat(VIEWS * EACH, axis=0) * pixels.by_color))
    added = np.sqrt(unknown**2 - known**2)
    assert added == pytest.approx(0.1 * np.sqrt((color**2).mean(axis=1)), rel=0.1)


def test_errors_never_exceed_those_of_the_uniform_prior():
    pixels, *_ = synthetic(20, np.full(20, 0.5), 0.01, np.random.default_rng(3))
    color_error = errors_of(replace(pixels, by_color=np.zeros_like(pixels.by_color)))
    assert color_error == pytest.approx(UNIFORM_DEVIATION, rel=1e-3)
    assert errors_of(replace(pixels, by_roughness=10.0 * pixels.by_color)).max() <= UNIFORM_DEVIATION
    worse = errors_of(replace(pixels, residual=pixels.residual + 0.2))
    better = errors_of(pixels)
    assert worse.mean() > 2 * better.mean()


def test_many_units_stay_apart() -> None:
    """Also from unit 8191 on, where 32 bits do not hold the pair of unit and block."""
    part = np.array([-1, 0, 8190, 8191, 8192, 16384, 16384 + 8191, 100_000, 116_384], np.int32)
    for single in (True, False):
        units = Units(part, np.full(part.max() + 1, single))
        fields = SimpleNamespace(box=Box(np.zeros(3), 1.0))
        cells = SeenCells(np.arange(len(part)), np.full((len(part), 3), 0.5, np.float32), part)
        assert len(np.unique(groups_of_cells(units, fields, cells))) == len(part)


def test_base_color_is_less_certain_where_places_are() -> None:
    errors = np.array([[0.02, 0.1, 0.2], [0.2, 0.1, 0.2], [UNIFORM_DEVIATION] * 3], np.float32)
    assert np.array_equal(confidence.errors_with_place(errors, 0.0), errors)
    scan = confidence.errors_with_place(errors, 0.02)
    assert scan.dtype == np.float32 and np.array_equal(scan[:, 1:], errors[:, 1:])
    assert scan[0, 0] > 0.05 and scan[0, 0] < 0.1  # what was certain loses most
    assert errors[1, 0] < scan[1, 0] < 1.1 * errors[1, 0]
    assert scan[2, 0] == errors[2, 0]


def test_confidence_is_one_minus_the_error_relative_to_the_priors_and_never_high_in_a_poor_result() -> None:
    known = np.array([0.0, UNIFORM_DEVIATION / 2, UNIFORM_DEVIATION, 1.0])
    assert confidence.confidence(known).tolist() == [1.0, 0.5, 0.0, 0.0]
    errors = np.array([[0.02, 0.03, 0.28]], np.float32)
    poor = confidence.confidence(confidence.no_better_than(errors, 10.0 ** (-16.0 / 20.0)))
    assert poor.max() < 0.3
    good = confidence.no_better_than(errors, 10.0 ** (-40.0 / 20.0))
    np.testing.assert_array_equal(good, errors)


FLOOR = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]
UP = np.array([[0.0, 0.0, 1.0]])
AREA, LUMINANCE = 1e-4, 1000.0


def lamp_above(height: float) -> list:
    """A square of one centimetre that shines down."""
    return [[-0.005, -0.005, height], [-0.005, 0.005, height], [0.005, 0.005, height], [0.005, -0.005, height]]


def fixture(quad: int, height: float) -> Fixture:
    triangles = np.array([2 * quad, 2 * quad + 1])
    shines = np.full(3, LUMINANCE)
    return Fixture(triangles, shines, np.zeros(3), AREA, np.array([0.0, 0.0, height]))


def errors(quads: list, height: float, points: np.ndarray, doubt: float) -> np.ndarray:
    room = make_room([FLOOR, lamp_above(height), *quads])
    surface = points, np.repeat(UP, len(points), axis=0)
    return light_errors(room, [fixture(1, height)], surface, doubt, 0)


@pytest.mark.parametrize("height", [0.3, 0.6, 1.2])
def test_the_error_is_that_of_the_inverse_square(height: float) -> None:
    """Below a small lamp L_d is A L / (pi h^2); an error d of h changes it by 2 d / h."""
    doubt = 0.01
    found = errors([], height, np.zeros((1, 3)), doubt)
    light = AREA * LUMINANCE / (np.pi * height**2)
    assert found[0] == pytest.approx(2.0 * doubt / height * light, rel=0.05)


def test_where_a_shadow_ends_light_is_least_certain() -> None:
    """A board halfway between lamp and floor, whose edge's shadow lies below the lamp."""
    board = [[0.0, -1, 0.5], [1.5, -1, 0.5], [1.5, 1, 0.5], [0.0, 1, 0.5]]
    places = ([0.002, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.5, 0.0, 0.0])
    edge, lit, shadow = (errors([board], 1.0, np.array([place]), 0.01)[0] for place in places)
    assert edge > 5.0 * lit > 0.0
    assert shadow == 0.0
    assert errors([], 1.0, np.array([[0.3, 0.0, 2.0]]), 0.01)[0] == 0.0  # above a lamp that shines down


def test_lamps_that_few_pixels_see_alone_are_doubted_by_the_spread_of_their_radiance() -> None:
    room = make_room([FLOOR, lamp_above(0.5), lamp_above(1.0)])
    triangle = np.array([2] * 20 + [4] * 12)
    own = np.full((32, 3), 100.0, np.float32)
    own[20:26] *= 1.5
    pixels = SimpleNamespace(triangle=triangle, own=own, weight=np.full(32, 0.5), pure=np.arange(32) < 22, radiance=own)
    lamps = [fixture(1, 0.5), fixture(2, 1.0)]
    (doubt,) = hardly_seen(lamps, pixels, len(room.triangles))
    assert doubt == (1, 12, pytest.approx(0.2))
    surface = np.array([[0.3, 0.0, 0.75]]), UP  # below that lamp, above the other
    received = AREA * LUMINANCE / np.pi * 0.25**2 / (0.25**2 + 0.3**2) ** 2
    found = power_errors(room, lamps, [doubt], surface, 0)
    assert found[0] == pytest.approx(0.2 * received, rel=0.05)


def test_base_color_is_as_wrong_as_the_light() -> None:
    known = np.full((4, 3), 0.03, np.float32)
    points = np.zeros((2, 3))
    lit = LitCells(np.array([1, 3]), points, points, np.array([0.5, 0.8]), np.array([2.0, 0.1]))
    found = add_light_errors(known, lit, np.array([0.16, 1.0]))
    assert found[1, 0] == pytest.approx(np.hypot(0.03, 0.5 * 0.08))
    assert found[3, 0] == pytest.approx(UNIFORM_DEVIATION)
    assert np.array_equal(found[[0, 2]], known[[0, 2]]) and np.array_equal(found[:, 1:], known[:, 1:])
