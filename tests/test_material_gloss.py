# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Gloss is told from errors of the shadings; in case of doubt, parts take a mean of the candidates."""

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.material import training_input
from fipt_blender.core.material.candidates import choose_materials, with_similar_groups
from fipt_blender.core.material.gloss import OVERDONE_GLOSS, group_materials
from fipt_blender.core.material.pixel_samples import PixelSamples
from samples.material_pixels import CELLS, LAMBDA_DIFFUSE, LEVELS, VIEWS, materials_of, synthetic

ROUGHNESS = np.linspace(0.0, 1.0, 11)
SCALE = 0.01


def with_gloss(strength: float, spoil: float = 0.0) -> tuple[float, float]:
    """Estimated roughness and metallic of a dielectric of LEVELS[3] that shows `strength` times its gloss.

    Args:
        spoil: share of the gloss by which each pixel's own L_d is too dark, as an error of the shadings.
    """
    rng = np.random.default_rng(5)
    samples, color = synthetic(rng, [(1.0, 0.0)], 0.0, 0.0)
    diffuse, specular = samples.diffuse, samples.specular
    gloss = 0.04 * specular[:, :, 0] + specular[:, :, 1]
    more = gloss[:, 3] - gloss[:, -1]
    radiance = color * diffuse + gloss[:, -1] + strength * more
    radiance = radiance.clip(0.0) * (1.0 + 0.02 * rng.normal(size=radiance.shape))
    spoilt = (diffuse - spoil * more / color).astype(np.float32)
    roughness, metallic = materials_of(replace(samples, radiance=radiance.astype(np.float32), diffuse=spoilt))
    return float(roughness[0]), float(metallic[0])


def test_only_gloss_of_a_dielectrics_strength_is_gloss() -> None:
    assert with_gloss(1.0) == pytest.approx((LEVELS[3], 0.0), abs=0.05)
    assert with_gloss(0.0) == pytest.approx((1.0, 0.0), abs=0.06)
    for strength in (OVERDONE_GLOSS, 3.0):
        # No dielectric of similar roughness; the gloss of a metal has no fixed strength.
        roughness, metallic = with_gloss(strength)
        assert metallic == 1.0 or roughness > LEVELS[3] + 0.1


def test_errors_of_diffuse_shading_that_look_like_gloss_cancel_between_views() -> None:
    """The surface is equally bright in all views, although each view's own L_d differs."""
    assert with_gloss(0.0, spoil=1.0) == pytest.approx((1.0, 0.0), abs=0.06)


def costs_of(best: list[tuple[int, int, float]]) -> np.ndarray:
    """(2, K, parts) costs with one good candidate (metallic, level, cost) for each part."""
    costs = np.full((2, len(ROUGHNESS), len(best)), 1.0)
    for part, (metal, place, cost) in enumerate(best):
        costs[metal, place, part] = cost
    return costs


def test_ambiguous_evidence_gives_the_mean_of_glossy_and_diffuse() -> None:
    scale = np.full(4, SCALE)
    costs = costs_of([(0, 3, 0.0), (0, 3, -SCALE * np.log(3.0)), (0, 3, -1.0), (0, 3, 0.5)])
    roughness, metallic = choose_materials(costs, ROUGHNESS, scale)
    np.testing.assert_allclose(roughness, [1 - 0.5 * 0.7, 1 - 0.75 * 0.7, 0.3, 1.0], atol=1e-6)
    assert (metallic == 0.0).all()


def test_metal_and_dark_plastic_of_equal_cost_give_their_mean() -> None:
    costs = costs_of([(0, 6, -1.0), (1, 6, -1.0), (1, 6, -1.0)])
    costs[1, 6, 0] = -1.0
    roughness, metallic = choose_materials(costs, ROUGHNESS, np.full(3, SCALE))
    np.testing.assert_allclose(roughness, 0.6, atol=1e-6)
    np.testing.assert_allclose(metallic, [0.5, 1.0, 1.0], atol=1e-6)


def test_gloss_of_unclear_roughness_takes_that_of_other_parts() -> None:
    """Four parts have 0.4; one fits everything up to 0.7 equally, and one clearly has 0.1."""
    costs = costs_of([(0, 4, -1.0)] * 4 + [(0, 4, 1.0), (0, 1, -1.0)])
    costs[0, :8, 4] = -1.0
    costs[0, 0, 4] -= 1e-6  # the best one without the prior
    roughness, _ = choose_materials(costs, ROUGHNESS, np.full(6, SCALE))
    np.testing.assert_allclose(roughness, [0.4, 0.4, 0.4, 0.4, 0.4, 0.1], atol=1e-6)
    alone, _ = choose_materials(costs[:, :, 4:5], ROUGHNESS, np.full(1, SCALE))
    assert alone[0] < 0.8
    # A diffuse part stays diffuse, whatever the other parts are.
    costs[0, :, 4] = 0.5
    assert choose_materials(costs, ROUGHNESS, np.full(6, SCALE))[0][4] == 1.0


def materials_among_similar(costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roughness and metallic of groups that are all similar to each other, each of 1000 pixels."""
    groups = costs.shape[2]
    scale, count = np.full(groups, SCALE), np.full(groups, 1000.0)
    costs = with_similar_groups(costs, ROUGHNESS, scale, count, np.ones((groups, groups)))
    return choose_materials(costs, ROUGHNESS, scale)


def test_groups_of_faint_gloss_follow_similar_groups() -> None:
    """Twenty clearly have 0.4; one shows nothing, one is slightly diffuse, one diffuse and one metal."""
    costs = costs_of([(0, 4, 0.0), (0, 4, 0.0), (0, 4, 1.0), (1, 7, -1.0), *[(0, 4, -1.0)] * 20])
    costs[0, :, 0] = 0.0
    costs[0, :, 1] = SCALE
    alone, _ = choose_materials(costs, ROUGHNESS, np.full(24, SCALE))
    assert alone[0] > 0.6 and alone[1] > 0.8
    roughness, metallic = materials_among_similar(costs)
    np.testing.assert_allclose(roughness, [0.4, 0.4, 1.0, 0.7, *[0.4] * 20], atol=0.06)
    np.testing.assert_array_equal(metallic, [0, 0, 0, 1, *[0] * 20])
    # Among diffuse groups, the same gloss does not count.
    costs = costs_of([(0, 4, 1.0)] * 3 + [(0, 4, -2.0 * SCALE)])
    assert choose_materials(costs, ROUGHNESS, np.full(4, SCALE))[0][3] < 0.5
    assert materials_among_similar(costs)[0][3] > 0.9


def test_a_large_group_does_not_outweigh_several_small_ones() -> None:
    """One faint group among four clear ones of 0.4 and a matt one that has more pixels than all of them."""
    costs = costs_of([(0, 4, 0.0), *[(0, 4, -1.0)] * 4, (0, 4, 1.0)])
    scale, count = np.full(6, SCALE), np.array([300.0, 500, 500, 500, 500, 9000])
    costs = with_similar_groups(costs, ROUGHNESS, scale, count, np.ones((6, 6)))
    assert choose_materials(costs, ROUGHNESS, scale)[0][0] < 0.6


def test_whether_a_group_is_metal_is_decided_by_itself() -> None:
    """Metal and dark plastic of 0.4 fit one group equally; the similar groups are plastic."""
    costs = costs_of([(0, 4, -1.0)] * 5)
    costs[1, 4, 0] = -1.0
    np.testing.assert_allclose(materials_among_similar(costs), [[0.4] * 5, [0.5, 0, 0, 0, 0]], atol=1e-6)


def test_without_similar_groups_costs_do_not_change() -> None:
    costs = np.random.default_rng(0).normal(0.0, 3.0 * SCALE, (2, len(ROUGHNESS), 5))
    costs[0, -1] = 100.0
    scale = np.full(5, SCALE)
    changed = with_similar_groups(costs, ROUGHNESS, scale, np.full(5, 1000.0), np.eye(5))
    np.testing.assert_allclose(changed, costs, atol=1e-9)


def test_the_same_residuals_are_weaker_evidence_in_a_small_part() -> None:
    """With few of its pixels, a faint gloss is closer to diffuse."""
    samples, color = synthetic(np.random.default_rng(2), [(1.0, 0.0)], 0.0, 0.0)
    diffuse, specular = samples.diffuse, samples.specular
    gloss = 0.04 * specular[:, :, 0] + specular[:, :, 1]
    noise = 1.0 + 0.2 * np.random.default_rng(3).normal(size=color.shape)
    radiance = ((color * diffuse + gloss[:, 3]) * noise).clip(0.0).astype(np.float32)
    arrays = vars(replace(samples, radiance=radiance))

    def roughness(cells: int, similarity: np.ndarray | None = None) -> float:
        few = {name: array if name == "levels" else array[: cells * VIEWS] for name, array in arrays.items()}
        subset = PixelSamples(**few)
        return float(group_materials(subset, subset.cell, LAMBDA_DIFFUSE, similarity)[0][0])

    assert roughness(CELLS) < 0.5
    assert roughness(CELLS) < roughness(4) <= 1.0
    assert roughness(4, np.ones((1, 1))) < roughness(4)  # no caution where similar groups could contradict


def test_large_groups_are_sampled_by_complete_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_input, "GROUP_PIXELS", 1000)
    part = np.repeat([0, 1], [800, 20_000])
    cell = np.arange(len(part)) // 5
    kept = training_input.sample_groups(part, cell, np.random.default_rng(0))
    assert kept[part == 0].all()
    assert kept[part == 1].sum() == pytest.approx(1000, rel=0.2)
    assert set(np.bincount(cell, kept)) == {0.0, 5.0}
