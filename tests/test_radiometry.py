"""Response, exposures, white balances and vignetting from points that several views see."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.ldr import Camera
from fipt_blender.core.radiometry.adjustment import Samples, adjust, falloff_terms
from fipt_blender.core.radiometry.contrast import EXIF_DEVIATION, Source, combined, exif_contrast
from fipt_blender.core.radiometry.inversion import BOUND_WEIGHT, Radiometry, reliability
from fipt_blender.core.radiometry.response import HIGH_ANCHOR, LOW_ANCHOR, interpolated, response_basis, slope

VIEWS, POINTS = 12, 1000
CAMERAS = [Camera(1.8, 0.0, 0.0, 0.0), Camera(2.2, 0.3, 0.1, 0.25), Camera(2.6, 0.1, 0.35, 0.1)]


def true_curve(camera: Camera) -> np.ndarray:
    """(256,) logarithm of the light of each code."""
    light = np.geomspace(1e-6, 1.0, 20_000)
    return np.interp(np.arange(256) / 255.0, camera.respond(light), np.log(light))


def contrast_of(curve: np.ndarray) -> float:
    return float(curve[HIGH_ANCHOR] - curve[LOW_ANCHOR])


def make_samples(camera: Camera, seed: int = 0, outliers: float = 0.1) -> tuple[Samples, np.ndarray]:
    """Codes of points in six views each, and the (V, 3) logarithms of the views' gains."""
    rng = np.random.default_rng(seed)
    log_gains = rng.normal(0.0, 0.4, (VIEWS, 1)) + rng.normal(0.0, 0.05, (VIEWS, 3))
    point = np.repeat(np.arange(POINTS), 6)
    view = np.concatenate([rng.permutation(VIEWS)[:6] for _ in range(POINTS)])
    radius = rng.random(len(point))
    radiance = np.exp(rng.uniform(np.log(0.02), np.log(0.8), (POINTS, 3)))[point]
    highlight = rng.random(len(point)) < outliers
    radiance = radiance * np.where(highlight, rng.uniform(1.2, 3.0, len(point)), 1.0)[:, None]
    share = 1.0 - camera.falloff * radius**2
    light = radiance * np.exp(log_gains[view]) * share[:, None]
    codes = np.round(camera.respond(light) * 255.0 + rng.normal(0.0, 0.5, light.shape)).clip(0.0, 255.0)
    return Samples(point, point // 10, view, radius, codes), log_gains


def test_the_basis_contains_other_responses():
    basis = response_basis()
    for camera in CAMERAS:
        curve = true_curve(camera)
        contrast = contrast_of(curve)
        usable = slice(4, 252)
        weights = np.linalg.lstsq(basis.components[:, usable].T, (curve / contrast - basis.mean)[usable], rcond=None)[0]
        found = basis.shape(weights) * contrast
        assert np.sqrt(((np.exp(found) - np.exp(curve)) ** 2).mean()) < 3e-3


def test_shapes_have_an_inverse_whatever_their_weights():
    basis = response_basis()
    assert np.array_equal(basis.mean, response_basis().mean)
    for weights in np.random.default_rng(1).normal(0.0, 20.0, (50, len(basis.components))):
        shape = basis.shape(weights)
        assert np.diff(shape).min() > 0.0 and shape[-1] == 0.0
        assert shape[HIGH_ANCHOR] - shape[LOW_ANCHOR] == pytest.approx(1.0)


@pytest.mark.parametrize("number", range(len(CAMERAS)))
def test_views_tell_response_exposures_and_vignetting(number):
    """Within 2 % and 0.05 EV once the contrast is known, with a tenth of highlights."""
    camera = CAMERAS[number]
    samples, log_gains = make_samples(camera, number)
    found = adjust(samples, np.arange(VIEWS), response_basis())
    curve = true_curve(camera)
    contrast = contrast_of(curve)
    assert np.sqrt(((np.exp(found.shape * contrast) - np.exp(curve)) ** 2).mean()) < 0.02
    error = found.log_gains * contrast - (log_gains - log_gains.mean(axis=0))
    assert np.abs(error).max() < 0.05 * np.log(2.0)
    share = np.exp((falloff_terms(np.array([1.0])) @ found.falloff)[0] * contrast)
    assert share == pytest.approx(1.0 - camera.falloff, abs=0.02)
    assert found.outliers.max() < 0.35


def test_views_of_one_photograph_have_one_gain():
    """The faces of a panorama."""
    samples, log_gains = make_samples(CAMERAS[0])
    photograph = np.array([0, 0, 0, *range(1, VIEWS - 2)])
    log_gains[:3] = log_gains[0]
    light = np.exp(log_gains[samples.view] - make_samples(CAMERAS[0])[1][samples.view])
    curve = true_curve(CAMERAS[0])
    codes = np.interp(np.log(light) + np.interp(samples.codes, np.arange(256), curve), curve, np.arange(256))
    same = Samples(samples.point, samples.cluster, samples.view, samples.radius, codes)
    found = adjust(same, photograph, response_basis())
    assert found.log_gains.shape == (VIEWS, 3) and np.ptp(found.log_gains[:3], axis=0).max() == 0.0
    error = found.log_gains * contrast_of(curve) - log_gains
    assert np.ptp(error, axis=0).max() < 0.1 * np.log(2.0)
    errors = Radiometry(found, Source("light", 0.0, 0.01), ()).exposure_errors()
    np.testing.assert_allclose(errors[:3], errors[0], rtol=1e-6)


def test_claimed_errors_cover_the_made_ones_and_radiance_of_codes_comes_back():
    camera = CAMERAS[1]
    contrast = contrast_of(true_curve(camera))
    ratios, radius = [], np.array([0.2, 0.9])
    for seed in range(4):
        samples, log_gains = make_samples(camera, seed)
        source = Source("light", float(np.log(contrast)), 0.01)
        found = Radiometry(adjust(samples, np.arange(VIEWS), response_basis()), source, (source,))
        grey, true = found.log_gains.mean(axis=1), log_gains.mean(axis=1)
        error = (grey - grey.mean()) - (true - true.mean())
        ratios.append(np.square(error / found.exposure_errors()))
        # Two photographs of one radiance, of different exposure and place in the image, agree.
        lights = [0.2 * np.exp(log_gains[v]) * (1.0 - camera.falloff * radius[:, None] ** 2) for v in (0, 1)]
        logs = [found.values(v, camera.respond(light) * 255.0, radius) * found.factor for v, light in enumerate(lights)]
        assert np.ptp(np.array(logs), axis=(0, 1)).max() < 0.04
    # What is claimed is more than is made, but not five times as much.
    assert 0.2 < np.sqrt(np.mean(ratios)) < 1.0


def test_views_of_one_exposure_leave_the_prior():
    """Without differences of exposure nothing tells the shape, which the covariance says."""
    samples, _ = make_samples(CAMERAS[1], outliers=0.0)
    flat = np.round(interpolated(np.arange(256.0), samples.codes[:1]).repeat(len(samples.codes), 0))
    found = adjust(
        Samples(samples.point, samples.cluster, samples.view, samples.radius, flat), np.arange(VIEWS), response_basis()
    )
    assert np.isfinite(found.shape).all() and np.isfinite(found.covariance).all()
    assert np.abs(found.log_gains).max() < 1e-6


def test_without_shared_points_nothing_is_adjusted():
    samples, _ = make_samples(CAMERAS[0])
    alone = Samples(np.arange(len(samples.view)), samples.cluster, samples.view, samples.radius, samples.codes)
    found = adjust(alone, np.arange(VIEWS), response_basis())
    assert np.abs(found.log_gains).max() < 1e-9 and found.shared.max() == 0
    assert np.abs(found.shape - response_basis().shape(np.zeros(4))).max() < 1e-9


def test_exposures_of_files_tell_the_contrast():
    rng = np.random.default_rng(5)
    log_gains = rng.normal(0.0, 0.2, 30)
    exposures = np.exp(2.7 * log_gains + 1.0)
    rounded = 2.0 ** (np.round(3.0 * np.log2(exposures)) / 3.0)
    rounded[3] *= 4.0  # one file is wrong
    rounded[4] = np.nan
    found = exif_contrast(log_gains, rounded)
    assert found is not None and abs(found.value - np.log(2.7)) < 3.0 * found.deviation < 0.3
    assert exif_contrast(log_gains, np.full(30, np.nan)) is None
    assert exif_contrast(np.zeros(30), exposures) is None
    assert exif_contrast(log_gains, 1.0 / exposures) is None


@pytest.mark.parametrize("error", [0.02, 0.07, 0.2])
def test_exposures_of_files_count_by_how_well_they_fit(error):
    """The deviation is that of the found contrasts over many cameras, exact exposures or poor ones."""
    rng, ratios = np.random.default_rng(6), []
    for _ in range(200):
        log_gains = rng.normal(0.0, 0.2, 36)
        told = np.exp(2.7 * log_gains + rng.normal(0.0, error, 36))
        found = exif_contrast(log_gains, told)
        assert found is not None
        ratios.append([found.value - np.log(2.7), found.deviation])
    errors, deviations = np.array(ratios).T
    assert 0.6 < errors.std() / deviations.mean() < 1.35


def test_sources_are_combined_by_their_errors():
    both = combined([Source("usual", 1.0, 0.2), Source("exif", 1.2, 0.1)])
    assert both.value == pytest.approx(1.16) and both.deviation == pytest.approx(0.2 / np.sqrt(5.0))
    assert EXIF_DEVIATION > 0.0


def test_errors_grow_towards_both_ends():
    samples, _ = make_samples(CAMERAS[1])
    source = Source("usual", 1.1, 0.2)
    found = Radiometry(adjust(samples, np.arange(VIEWS), response_basis()), source, (source,))
    codes = np.repeat(np.array([0.0, 5.0, 30.0, 128.0, 245.0, 255.0])[:, None], 3, axis=1)
    weight = reliability(found.errors(codes))
    assert weight[0] == weight[-1] == np.float32(BOUND_WEIGHT)
    assert BOUND_WEIGHT < weight[1] < weight[2] < weight[3] and weight[3] > 0.9
    assert slope(found.log_curve, np.array([128.0]))[0] > 0.0
    one = reliability(found.errors(np.array([[128.0, 128.0, 255.0]])))
    assert one[0] == np.float32(BOUND_WEIGHT)
