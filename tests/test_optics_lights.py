"""Emissive triangles: drawn in proportion to power, uniform by area, and right as estimators."""

from dataclasses import replace

import mitsuba as mi
import numpy as np
from scipy.stats import chi2

from fipt_blender.core.optics.lights import AreaLights, EmitterTable

# triangle 0 emits nothing, 1 both sides, 2 its back, 3 its front but has no area, 4 its front
VERTICES = np.array(
    [
        [0, 0, 0], [1, 0, 0], [0, 1, 0],
        [0, 0, 1], [2, 0, 1], [0, 3, 1.5],
        [5, 5, 5], [5, 5, 6], [5, 6, 5],
        [9, 9, 9], [9, 9, 9], [9, 9, 9],
    ],
    np.float32,
)  # fmt: skip
TRIANGLES = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11], [0, 2, 1]], np.int32)
TABLE = EmitterTable(
    np.array([4, 1, 2, 3], np.int32),
    np.array([[2, 2, 2], [1, 0, 0], [0, 0, 0], [9, 9, 9]], np.float32),
    np.array([[0, 0, 0], [0, 0, 1], [0, 7, 0], [0, 0, 0]], np.float32),
)


def draw(count: int, seed: int) -> mi.Float:
    sampler = mi.PCG32(size=count, initstate=seed)
    return [sampler.next_float32() for _ in range(3)]


def areas() -> np.ndarray:
    corners = VERTICES[TRIANGLES].astype(float)
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def test_triangles_are_chosen_by_power_with_their_density() -> None:
    lights = AreaLights(VERTICES, TRIANGLES, TABLE)
    assert lights.count == 3
    count = 100_000
    sample = lights.sample(*draw(count, 1))
    chosen = np.array(sample.triangle)
    luminance = np.array([0.2126, 0.7152, 0.0722])
    power = np.zeros(5)
    power[TABLE.triangles] = (TABLE.radiance + TABLE.back_radiance) @ luminance * areas()[TABLE.triangles]
    expected = power / power.sum() * count
    observed = np.bincount(chosen, minlength=5)
    assert observed[expected == 0].sum() == 0
    used = expected > 0
    statistic = float(((observed - expected)[used] ** 2 / expected[used]).sum())
    assert chi2.sf(statistic, used.sum() - 1) > 1e-3
    # The mean of 1/pdf over the samples is the area that can be sampled.
    values = 1.0 / np.array(sample.pdf_area)
    assert abs(values.mean() - areas()[[1, 2, 4]].sum()) < 4 * values.std() / np.sqrt(count)
    assert np.allclose(np.array(lights.pdf_area(sample.triangle)), np.array(sample.pdf_area))


def test_lookup_by_side_also_without_emitters() -> None:
    lights = AreaLights(VERTICES, TRIANGLES, TABLE)
    triangle = mi.UInt32([0, 1, 1, 2, 2, 4, 4])
    side = mi.Float([1, 1, -1, 1, -1, 1, -1])
    found = np.array(lights.radiance(triangle, side)).T
    expected = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, 0], [0, 7, 0], [2, 2, 2], [0, 0, 0]]
    assert np.array_equal(found, expected)
    assert np.array(lights.is_emitter(triangle)).tolist() == [False] + [True] * 6
    assert np.array(lights.pdf_area(mi.UInt32([0, 3]))).tolist() == [0.0, 0.0]
    lights = AreaLights(VERTICES, TRIANGLES, replace(TABLE, reflective=TABLE.triangles == 4))
    assert np.array_equal(np.array(lights.radiance(triangle, side)).T, expected)
    assert np.array(lights.is_emitter(triangle)).tolist() == [False] + [True] * 4 + [False] * 2
    none = AreaLights(VERTICES, TRIANGLES, EmitterTable.empty())
    assert not np.array(none.radiance(triangle, side)).any() and not np.array(none.is_emitter(triangle)).any()
    assert np.array(none.pdf_area(triangle)).tolist() == [0.0] * 7


def test_irradiance_of_a_triangle_is_lamberts_formula() -> None:
    """Irradiance from a polygon, sum of edge angles: sampled directions agree (z-test)."""
    table = EmitterTable(np.array([1], np.int32), np.ones((1, 3), np.float32), np.ones((1, 3), np.float32))
    lights = AreaLights(VERTICES, TRIANGLES, table)
    point, up = np.array([0.4, 0.2, -0.3]), np.array([0.0, 0.0, 1.0])
    rays = VERTICES[3:6].astype(float) - point
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    exact = 0.0
    for first, second in zip(rays, np.roll(rays, -1, axis=0), strict=True):
        cross = np.cross(first, second)
        exact += 0.5 * np.arccos(first @ second) * (cross @ up) / np.linalg.norm(cross)
    direct = lights.sample_direction(mi.Point3f(point.tolist()), *draw(200_000, 4))
    cosine = np.maximum(np.array(direct.direction).T @ up, 0.0)
    values = np.array(direct.radiance)[0] * cosine / np.array(direct.pdf)
    error = values.std() / np.sqrt(len(values))
    assert error < 0.01 * abs(exact)
    assert abs(values.mean() - abs(exact)) < 4 * error
