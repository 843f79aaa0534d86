"""The paper's BRDF and its Mitsuba plugin: densities, energy, symmetry, and both masking functions."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from benchmarks.tracer import bsdf
from fipt_blender.core.optics import brdf, factorised
from fipt_blender.core.run.settings import make_settings
from samples.combinations import pairs
from samples.refusals import error_of

bsdf.register()

SIGMAS = (0.25, 0.5, 1.0)
ANGLES = (5.0, 50.0, 75.0)
CASES = pairs(SIGMAS, (0.0, 1.0), ANGLES)


def viewer(degrees: float) -> list[float]:
    angle = np.radians(degrees)
    return [float(np.sin(angle) * 0.6), float(np.sin(angle) * 0.8), float(np.cos(angle))]


def spread(count: int, seed: int = 0) -> tuple[mi.Float, mi.Point2f]:
    generator = mi.PCG32(size=count, initstate=seed)
    return generator.next_float32(), mi.Point2f(generator.next_float32(), generator.next_float32())


def hemisphere(side: int) -> tuple[mi.Vector3f, float]:
    """Directions at the centres of side x side cells of equal solid angle, and that solid angle."""
    x, y = dr.meshgrid(*[(dr.arange(mi.Float, side) + 0.5) / side] * 2)
    return mi.warp.square_to_uniform_hemisphere(mi.Point2f(x, y)), 2.0 * np.pi / side**2


@pytest.mark.parametrize("sigma, metallic, angle", [*CASES, (0.5, 0.3, 130.0), (1.0, 0.0, 105.0)])
def test_plugin_samples_fit_its_density(sigma: float, metallic: float, angle: float) -> None:
    """Angles above 90 degrees look at the back, which mirrors the front."""
    direction = viewer(angle)
    xml = f'<float name="roughness" value="{sigma}"/><float name="metallic" value="{metallic}"/>'
    sample, density = mi.chi2.BSDFAdapter(bsdf.PLUGIN_NAME, xml, wi=direction)
    test = mi.chi2.ChiSquareTest(
        mi.chi2.SphericalDomain(), sample, density, sample_dim=3, sample_count=200_000, res=61, ires=32
    )
    assert test.run(0.01, len(CASES), quiet=True), test.messages


@pytest.mark.parametrize("sigma, metallic, angle", CASES)
def test_weights_integrate_the_brdf(sigma: float, metallic: float, angle: float) -> None:
    """a' by sampling and by quadrature agree (z-test), and the factorisation of paper Eq. 6 is exact."""
    towards = mi.Vector3f(viewer(angle))
    color = mi.Color3f(0.8, 0.3, 0.1)
    cells, solid_angle = hemisphere(1024)
    exact = np.array([dr.sum(c)[0] for c in brdf.evaluate(cells, towards, color, sigma, metallic)])
    exact *= solid_angle
    _, weight, _ = brdf.sample(*spread(200_000), towards, color, sigma, metallic)
    values = np.array(weight).T
    error = values.std(axis=0) / np.sqrt(len(values))
    assert (np.abs(values.mean(axis=0) - exact) < 4.5 * error + 2e-3 * exact).all()
    s0, s1 = (float(dr.sum(part)[0]) * solid_angle for part in brdf.specular_lobes(cells, towards, sigma))
    kd = np.array(factorised.diffuse_reflectance(color, mi.Float(metallic))).ravel()
    ks = np.array(factorised.specular_reflectance(color, mi.Float(metallic))).ravel()
    assert np.allclose(exact, kd + ks * s0 + s1, rtol=1e-3)


@pytest.mark.parametrize("sigma", [0.02, 0.06, 0.15, 0.4, 0.7, 1.0])
def test_white_metal_in_a_furnace_gains_nothing(sigma: float) -> None:
    for angle in (1.0, 30.0, 60.0, 80.0, 88.0):
        _, weight, _ = brdf.sample(*spread(50_000), mi.Vector3f(viewer(angle)), mi.Color3f(1.0), sigma, 1.0)
        values = np.array(weight)[0]
        assert values.mean() < 1.0 + 4.0 * values.std() / np.sqrt(len(values))


def test_reciprocity() -> None:
    """f over the cosine is the same with light and viewer exchanged."""
    count = 10_000
    generator = mi.PCG32(size=count)
    numbers = [generator.next_float32() for _ in range(9)]
    first = mi.warp.square_to_uniform_hemisphere(mi.Point2f(numbers[0], numbers[1]))
    second = mi.warp.square_to_uniform_hemisphere(mi.Point2f(numbers[2], numbers[3]))
    material = (mi.Color3f(*numbers[4:7]), dr.lerp(0.15, 1.0, numbers[7]), numbers[8])
    one = np.array(brdf.evaluate(first, second, *material) / first.z)
    other = np.array(brdf.evaluate(second, first, *material) / second.z)
    high = np.array((first.z > 0.01) & (second.z > 0.01))  # below, the model is cut off
    assert np.allclose(one[:, high], other[:, high], rtol=1e-3)


@pytest.fixture(autouse=True)
def default_masking():
    yield
    brdf.set_masking("schlick")


def test_smith_is_height_correlated_and_the_default_is_the_authors():
    """Walter et al. 2007: Λ = (sqrt(1 + alpha^2 tan^2) - 1) / 2."""
    found = np.array(brdf.geometry_term(mi.Float(0.5), mi.Float(1.0), mi.Float(1.0)))
    assert found == pytest.approx(0.5 / 0.75) and make_settings().masking == "schlick"
    cosines = np.array([[1.0, 0.7, 0.2, 0.9], [1.0, 0.4, 0.3, 0.05]])
    brdf.set_masking("smith")
    for sigma in (0.1, 0.5, 1.0):
        found = np.array(brdf.geometry_term(*(mi.Float(each) for each in cosines), mi.Float(sigma)))
        either = (np.sqrt(1.0 + sigma**4 * (1.0 / cosines**2 - 1.0)) - 1.0) / 2.0
        assert np.allclose(found, 1.0 / (1.0 + either.sum(axis=0)), rtol=1e-5)
    with pytest.raises(ValueError, match="unknown masking"):
        brdf.set_masking("none")
    assert error_of(make_settings, changes={"masking": "none"}).code == "setting-invalid"
