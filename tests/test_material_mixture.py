"""Materials of known pixels: a calibrated mixture that errors shared by views do not mislead, and base colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.material import likelihood, training_input
from fipt_blender.core.material.groups import TELLING_PIXELS
from fipt_blender.core.material.likelihood import make_candidates
from fipt_blender.core.material.mixture import (
    GroupMaterials,
    Prior,
    broad_prior,
    group_posterior,
    infer_materials,
    joined_groups,
    similarity,
)
from fipt_blender.core.material.pixel_samples import PixelSamples, window_means
from fipt_blender.core.material.projection import color_lines, fit_colors
from fipt_blender.core.optics.factorised import color_line
from samples.material_pixels import CELLS, LEVELS, SETTINGS, VIEWS, synthetic

CANDIDATES = make_candidates(LEVELS)
HALF = len(CANDIDATES.roughness) // 2
DIFFUSE = HALF - 1


def infer(samples: PixelSamples, places: np.ndarray | None = None) -> GroupMaterials:
    groups = int(samples.group.max(initial=-1)) + 1
    return infer_materials(samples, groups, samples.cell, SETTINGS, places)


def first_cells(samples: PixelSamples, cells: int) -> PixelSamples:
    return samples.take(samples.cell % CELLS < cells)


def with_view_errors(
    rng: np.random.Generator, truths: list[tuple[float, float]], noise: float, of_view: float
) -> PixelSamples:
    """Pixels whose errors are shared by ten neighbours, and by whole views where the surface shows gloss."""
    samples, _ = synthetic(rng, truths, 0.0, 0.0)
    block = np.arange(len(samples.rows)) // (VIEWS * int(SETTINGS.pixels_per_sample))
    shared = rng.normal(size=(block.max() + 1, VIEWS, 3))[block, samples.view]
    gloss = 0.04 * samples.specular[:, 3, 0] + samples.specular[:, 3, 1]
    pattern = gloss / np.sqrt((gloss**2).mean())
    groups = len(truths)
    view_error = of_view * rng.normal(size=(groups, VIEWS))[samples.group, samples.view]
    radiance = samples.radiance * (1.0 + noise * shared + view_error[:, None] * pattern)
    return replace(samples, radiance=radiance.clip(0.0).astype(np.float32))


def test_posterior_is_calibrated() -> None:
    """Standardised errors of many groups of few pixels have a mean square of about one."""
    rng = np.random.default_rng(11)
    roughness = np.where(rng.random(60) < 0.5, rng.choice(LEVELS[2:-1], 60), 1.0)
    samples = with_view_errors(rng, [(float(sigma), 0.0) for sigma in roughness], 0.15, SETTINGS.view_error)
    found = infer(first_cells(samples, 20))
    deviation = found.mean[:, 0] - roughness
    assert (np.abs(deviation) > 0.03).sum() > 5  # the noise is large enough to matter
    score = (deviation / np.maximum(found.error[:, 0], 0.02)) ** 2
    assert 0.2 < score.mean() < 2.0
    assert (found.mean[:, 1] < 0.2).all()


def test_no_gloss_in_errors_that_views_share() -> None:
    """Diffuse surfaces whose views err in the pattern of gloss by `view_error`, or by three times as much."""
    for factor in (1.0, 3.0):
        rng = np.random.default_rng(5)
        found = infer(with_view_errors(rng, [(1.0, 0.0)] * 12, 0.02, factor * SETTINGS.view_error))
        assert found.mean[:, 0].mean() > 0.97 and (found.mean[:, 0] > 0.8).all()
        assert (found.mean[:, 1] < 0.01).all()


def test_small_changes_of_the_pixels_change_the_answer_by_little(rng: np.random.Generator) -> None:
    """Also where gloss and no gloss are about equally likely: there is no switch that rounding could flip."""
    samples = with_view_errors(rng, [(float(LEVELS[5]), 0.0), (1.0, 0.0)] * 10, 0.2, 0.005)
    samples = first_cells(samples, 10)
    nudged = samples.radiance * (1.0 + 1e-6 * rng.normal(size=samples.radiance.shape))
    before, after = infer(samples), infer(replace(samples, radiance=nudged.astype(np.float32)))
    assert (before.error[:, 0] > 0.1).any()  # some are undecided
    np.testing.assert_allclose(before.mean[:, 0], after.mean[:, 0], atol=5e-3)
    np.testing.assert_allclose(before.mean[:, 1], after.mean[:, 1], atol=5e-3)


def test_few_pixels_leave_the_prior(rng: np.random.Generator) -> None:
    """With few of its pixels a faint gloss is less certain, and closer to the prior's mean."""
    samples = with_view_errors(rng, [(float(LEVELS[3]), 0.0)], 0.3, 0.005)

    many, few = infer(samples), infer(first_cells(samples, 4))
    assert many.mean[0, 0] == pytest.approx(LEVELS[3], abs=0.1)
    assert many.mean[0, 0] < few.mean[0, 0] < 1.0
    assert few.error[0, 0] > 2.0 * many.error[0, 0]


def likelihood_of(*best: tuple[int, float]) -> np.ndarray:
    """(S, groups) log-likelihoods: diffuse 0, one candidate a value, all others far below."""
    result = np.full((len(CANDIDATES.roughness), len(best)), -60.0)
    result[DIFFUSE] = 0.0
    for group, (candidate, value) in enumerate(best):
        result[candidate, group] = value
    return result - result.max(axis=0)


def roughness_of(log_likelihood: np.ndarray, similarity: np.ndarray | None = None) -> np.ndarray:
    prior = Prior(broad_prior(CANDIDATES), 1.0, similarity)
    posterior = group_posterior(log_likelihood, CANDIDATES, prior)
    np.testing.assert_allclose(posterior.sum(axis=0), 1.0)
    return CANDIDATES.roughness @ posterior


def test_the_posterior_of_one_group_is_bayes_rule() -> None:
    """With a heavy broad prior, one group follows likelihood times prior."""
    prior = broad_prior(CANDIDATES)
    assert prior.sum() == pytest.approx(1.0) and prior[DIFFUSE] > 0.5
    log_likelihood = likelihood_of((10, 2.0), (HALF + 10, 5.0))
    posterior = group_posterior(log_likelihood, CANDIDATES, Prior(prior, 1e9))
    expected = np.exp(log_likelihood) * prior[:, None]
    np.testing.assert_allclose(posterior, expected / expected.sum(axis=0), rtol=1e-5, atol=1e-12)
    # What is not possible stays so, however likely.
    allowed = np.ones(log_likelihood.shape, bool)
    allowed[10] = False
    found = group_posterior(log_likelihood, CANDIDATES, Prior(prior, 1e9), allowed)
    assert (found[10] == 0.0).all() and found.sum(axis=0) == pytest.approx(1.0)


def test_groups_of_unclear_gloss_follow_the_room() -> None:
    """The same faint evidence is gloss in a room of such gloss, and chance in a room without."""
    clear = [(12, 40.0)] * 20
    glossy = roughness_of(likelihood_of(*clear, (12, 1.0)))
    matt = roughness_of(likelihood_of(*[(12, -40.0)] * 20, (12, 1.0)))
    alone = roughness_of(likelihood_of((12, 1.0)))
    assert glossy[-1] < 0.6 < alone[0] < matt[-1]
    unseen = np.zeros((len(CANDIDATES.roughness), 50))  # groups that no pixel shows do not count
    with_unseen = roughness_of(np.concatenate([likelihood_of(*clear, (12, 1.0)), unseen], axis=1))
    np.testing.assert_allclose(with_unseen[:21], glossy, atol=1e-6)
    assert glossy[-1] > CANDIDATES.roughness[12] and matt[-1] > 0.95
    # A group that is clear keeps its own material.
    assert roughness_of(likelihood_of(*clear, (12, -40.0)))[-1] > 0.99


def test_groups_of_one_class_and_color_count_more_than_the_room() -> None:
    """Two unclear groups: one is like five glossy groups, the other like twenty diffuse ones."""
    log_likelihood = likelihood_of(*[(12, 40.0)] * 5, *[(12, -40.0)] * 20, (12, 1.0), (12, 1.0))
    alike = np.eye(27)
    alike[25, :5] = alike[:5, 25] = 1.0
    alike[26, 5:25] = alike[5:25, 26] = 1.0
    roughness = roughness_of(log_likelihood, alike)
    assert roughness[25] < 0.55 and roughness[26] > 0.95


def test_groups_of_one_surface_share_their_gloss_unless_it_differs() -> None:
    """Groups 0 and 1 are sharp alike, 2 is unclear, 3 is diffuse; 4 is on another surface."""
    log_likelihood = likelihood_of((12, 40.0), (12, 30.0), (12, 1.0), (12, -40.0), (12, 40.0))
    surface, same = np.array([0, 0, 0, 0, 1]), np.arange(5)
    found = joined_groups(log_likelihood, broad_prior(CANDIDATES), surface, same)
    assert found[0] == found[1] and len({found[0], found[3], found[4]}) == 3
    assert found[2] in (found[0], found[3])
    hinted = joined_groups(log_likelihood, broad_prior(CANDIDATES), surface, np.array([0, 1, 2, 3, 0]))
    assert hinted[4] == hinted[0]


def test_groups_are_alike_by_class_and_base_colour(rng: np.random.Generator) -> None:
    """As diffuse surfaces in any light; a group of few pixels counts less for others."""
    samples, _ = synthetic(rng, [(1.0, 0.0)] * 5, 0.0, 0.0)
    color = np.array([0.5, 0.52, 0.3, 0.5, 0.5], np.float32)[samples.group, None]
    samples = replace(samples, radiance=samples.diffuse * color)
    few = (samples.group < 4) | (np.cumsum(samples.group == 4) <= 0.5 * TELLING_PIXELS)
    alike = similarity(samples.take(few), np.array([0, 0, 0, 1, 0]))
    assert (np.diag(alike)[:4] == 1.0).all() and alike[0, 1] == alike[1, 0] > 0.8
    assert (alike[0, 2:4] < 0.1).all() and alike[3, 0] == 0.0
    assert alike[0, 4] == pytest.approx(0.5, abs=0.02) and alike[4, 0] == pytest.approx(1.0)


def test_pixels_without_group_or_company_tell_nothing(rng: np.random.Generator) -> None:
    samples, _ = synthetic(rng, [(float(LEVELS[3]), 0.0)], 0.01, 0.0)
    alone = infer(replace(samples, cell=np.arange(len(samples.rows))))
    prior = broad_prior(CANDIDATES)
    assert alone.mean[0, 0] == pytest.approx(float(CANDIDATES.roughness @ prior), abs=1e-5)
    several = infer(replace(samples, group=2 * samples.group + 1))  # group 0 has no pixel
    assert len(several.mean) == 2 and np.isfinite(several.mean).all()
    nothing = infer(replace(samples, group=np.full(len(samples.rows), -1)))
    assert all(len(values) == 0 for values in vars(nothing).values())


@pytest.mark.parametrize("start", [0.0, 0.37, 0.99])
def test_cells_of_any_wall_are_drawn_evenly(start: float) -> None:
    """Far more evenly than random numbers would: 16 of 160 cells, with a standard deviation of 3.8."""
    for axes in ((0, 1), (0, 2), (1, 2)):
        cell = np.zeros((1600, 4), np.int64)
        cell[:, axes] = np.stack(np.unravel_index(np.arange(1600), (40, 40)), axis=1)
        chosen = training_input.drawn(cell, start) < 0.1
        assert np.abs(chosen.reshape(10, 160).sum(axis=1) - 16).max() <= 5
        assert chosen.sum() == pytest.approx(160, abs=16)


def test_squares_are_those_of_the_best_base_colours(rng: np.random.Generator) -> None:
    """With each of the materials that are compared, beside a plain formula in double precision."""
    samples, _ = synthetic(rng, [(0.3, 0.0), (0.4, 1.0)], 0.02, 0.0)
    samples = samples.take(rng.permutation(len(samples.rows)), cell=rng.integers(0, 40, len(samples.rows)))
    place, metallic = np.array([0.0, 1.25, len(LEVELS) - 1.0]), np.array([0.0, 1.0, 1.0])
    squares = likelihood.DeviceCells(samples).squares(place, metallic)
    weight = samples.square_weight.astype(np.float64)
    for found, at, m in zip(squares, place, metallic, strict=True):
        low = min(int(at), len(LEVELS) - 2)
        share = at - low
        specular = (1.0 - share) * samples.specular[:, low] + share * samples.specular[:, low + 1]
        slope, offset = color_line(samples.diffuse.astype(np.float64), *np.moveaxis(specular, 1, 0), m)
        color = fit_colors(samples.radiance, slope, offset, weight, samples.cell)
        residual = samples.radiance - offset - color[samples.cell] * slope
        np.testing.assert_allclose(found, (weight * residual**2).mean(axis=1), rtol=2e-3, atol=1e-6)


def test_errors_that_pixels_share_in_a_view_are_told_from_noise(rng: np.random.Generator) -> None:
    """Two groups in 2,000 views with 5 to 500 pixels: one has an error of 3 % in each view."""
    group, pixels = np.repeat([0, 1], 2000), rng.uniform(5.0, 500.0, 4000)
    variance = np.array([0.04**2, 0.06**2])
    noise = rng.normal(size=4000) * np.sqrt(variance[group] * SETTINGS.pixels_per_sample / pixels)
    means = noise + np.where(group == 0, 0.03, 0.0) * rng.normal(size=4000)
    found = np.sqrt(likelihood.view_errors(means, pixels, group, variance, SETTINGS))
    assert found[0] == pytest.approx(likelihood.VIEW_SHARE * 0.03, rel=0.1)
    assert found[1] == pytest.approx(SETTINGS.view_error, rel=0.2)


def test_a_material_is_less_certain_where_views_err(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = with_view_errors(rng, [(0.3, 0.0), (1.0, 0.0)], 0.02, 0.0)
    factor = 1.0 + 0.05 * rng.normal(size=(VIEWS, 1)).astype(np.float32)
    samples = replace(samples, radiance=samples.radiance * factor[samples.view])
    with_errors = infer(samples)
    monkeypatch.setattr(likelihood, "VIEW_SHARE", 0.0)
    without = infer(samples)
    assert with_errors.error[:, 0].sum() > 1.2 * without.error[:, 0].sum()


@pytest.mark.parametrize(
    ("count", "most"),
    [([10, 20, 70_000], 50_000.0), ([400_000] * 20, 30_000.0), ([0, 100_000, 40_000, 20_000] * 10, 20_000.0)],
)
def test_no_group_uses_more_pixels_than_all_may_use_together(count, most):
    assert training_input.max_of_each(np.array(count)) == most
    assert np.minimum(count, most).sum() <= 600_000


@pytest.mark.parametrize("noise, outliers, within", [(0.0, 0.0, 0.01), (0.03, 0.05, 0.06)])
def test_known_materials_are_recovered(rng: np.random.Generator, noise: float, outliers: float, within: float) -> None:
    truths = [(1.0, 0.0), *((float(LEVELS[level]), 0.0) for level in (2, 3, 5))]
    truths += [(float(LEVELS[2]), 1.0), (float(LEVELS[5]), 1.0)]
    samples, color = synthetic(rng, truths, noise, outliers)
    roughness, metallic = materials = infer(samples).mean.T
    np.testing.assert_allclose(metallic, [metallic for _, metallic in truths], atol=1e-3)
    for estimated, (true, _) in zip(roughness, truths, strict=True):
        assert estimated == pytest.approx(true, abs=0.08)
    shadings, rows = ShadingStore(samples.diffuse, samples.specular, LEVELS), np.arange(len(samples.group))
    lines = color_lines(shadings, rows, np.stack(materials, axis=1)[samples.group])
    found = fit_colors(samples.radiance, *lines, samples.square_weight, samples.cell)[samples.cell]
    for index in range(len(truths)):
        rows = samples.group == index
        assert np.median(np.abs(found[rows] - color[rows])) < within


def test_roughness_between_levels_is_found(rng: np.random.Generator) -> None:
    """Shadings halfway between two levels give the roughness at which the levels have equal shares."""
    samples, color = synthetic(rng, [(1.0, 0.0)], 0.0, 0.0)
    middle = 0.5 * (samples.specular[:, 3] + samples.specular[:, 4])
    radiance = (color * samples.diffuse + 0.04 * middle[:, 0] + middle[:, 1]).astype(np.float32)
    roughness, metallic = infer(replace(samples, radiance=radiance)).mean.T
    assert roughness[0] == pytest.approx((0.5 * LEVELS[3] ** -2 + 0.5 * LEVELS[4] ** -2) ** -0.5, abs=1e-6)
    assert metallic[0] < 1e-3


def test_window_means_stay_within_part_and_view(rng: np.random.Generator) -> None:
    """Against a plain loop over two images of different sizes."""
    sizes = [(5, 7), (4, 3)]
    view = np.repeat([0, 1], [35, 12])
    widths = np.array([7, 3])
    count = len(view)
    part, pure = rng.integers(0, 2, count), rng.random(count) < 0.7
    values = rng.normal(size=(count, 2, 3)).astype(np.float32)
    rows = np.flatnonzero(pure)
    (means,) = window_means([values], rows, pure, part, np.array([0, 35, 47]), widths)
    for row, mean in zip(rows, means, strict=True):
        first = 35 * view[row]
        height, width = sizes[view[row]]
        y, x = divmod(row - first, width)
        near = [
            first + j * width + i
            for j in range(max(y - 1, 0), min(y + 2, height))
            for i in range(max(x - 1, 0), min(x + 2, width))
        ]
        near = [other for other in near if pure[other] and part[other] == part[row]]
        np.testing.assert_allclose(mean, values[near].mean(axis=0), rtol=1e-5, atol=1e-6)
