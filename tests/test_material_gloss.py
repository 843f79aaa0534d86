# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Gloss is told from the shadings' errors, and where that can't be, parts take what is likely."""

import numpy as np
import pytest
from test_material_projection import CELLS, LEVELS, VIEWS, synthetic

from fipt_blender.core.job import training_input
from fipt_blender.core.material.gloss import OVERDONE_GLOSS, _as_kin_say, _chosen, part_materials

ROUGHNESS = np.linspace(0.0, 1.0, 11)
SCALE = 0.01


def with_gloss(strength: float, spoil: float = 0.0) -> tuple[float, float]:
    """Roughness and metallic found where a dielectric of LEVELS[3] shows `strength` times its gloss.

    Args:
        spoil: how far each pixel's own L_d is too dark by its gloss, as an error of shadings would be.
    """
    rng = np.random.default_rng(5)
    (_, diffuse, specular), cell, part, color = synthetic(rng, [(1.0, 0.0)], 0.0, 0.0)
    gloss = 0.04 * specular[:, :, 0] + specular[:, :, 1]
    more = gloss[:, 3] - gloss[:, -1]
    radiance = color * diffuse + gloss[:, -1] + strength * more
    radiance = radiance.clip(0.0) * (1.0 + 0.02 * rng.normal(size=radiance.shape))
    own = (diffuse - spoil * more / color).astype(np.float32)
    view = np.arange(len(part)) % VIEWS
    found = part_materials(radiance.astype(np.float32), own, specular, LEVELS, cell, cell, part, view)
    return float(found[0][0]), float(found[1][0])


def test_gloss_of_its_own_strength_is_found_and_more_of_it_is_an_error_of_shadings() -> None:
    assert with_gloss(1.0) == pytest.approx((LEVELS[3], 0.0), abs=0.05)
    assert with_gloss(0.0) == pytest.approx((1.0, 0.0), abs=0.06)
    for strength in (OVERDONE_GLOSS, 3.0):
        # No dielectric of any roughness near it; a metal's gloss has no fixed strength.
        roughness, metallic = with_gloss(strength)
        assert metallic == 1.0 or roughness > LEVELS[3] + 0.1


def test_errors_of_diffuse_shading_that_look_like_gloss_cancel_between_views() -> None:
    """The spot is as bright from everywhere; each view's own L_d says otherwise."""
    assert with_gloss(0.0, spoil=1.0) == pytest.approx((1.0, 0.0), abs=0.06)


def costs_of(best: list[tuple[int, int, float]]) -> np.ndarray:
    """(2, K, parts) costs with one good candidate (metal, place, cost) a part."""
    costs = np.full((2, len(ROUGHNESS), len(best)), 1.0)
    for part, (metal, place, cost) in enumerate(best):
        costs[metal, place, part] = cost
    return costs


def test_faint_evidence_gives_the_mean_of_gloss_and_none() -> None:
    scale = np.full(4, SCALE)
    costs = costs_of([(0, 3, 0.0), (0, 3, -SCALE * np.log(3.0)), (0, 3, -1.0), (0, 3, 0.5)])
    roughness, metallic = _chosen(costs, ROUGHNESS, scale)
    np.testing.assert_allclose(roughness, [1 - 0.5 * 0.7, 1 - 0.75 * 0.7, 0.3, 1.0], atol=1e-6)
    assert (metallic == 0.0).all()


def test_what_metal_and_dark_plastic_explain_alike_is_half_of_each() -> None:
    costs = costs_of([(0, 6, -1.0), (1, 6, -1.0), (1, 6, -1.0)])
    costs[1, 6, 0] = -1.0
    roughness, metallic = _chosen(costs, ROUGHNESS, np.full(3, SCALE))
    np.testing.assert_allclose(roughness, 0.6, atol=1e-6)
    np.testing.assert_allclose(metallic, [0.5, 1.0, 1.0], atol=1e-6)


def test_gloss_without_a_clear_roughness_takes_the_rooms_usual_one() -> None:
    """Four parts are at 0.4; one fits anything up to 0.7 alike, and one is clearly at 0.1."""
    costs = costs_of([(0, 4, -1.0)] * 4 + [(0, 4, 1.0), (0, 1, -1.0)])
    costs[0, :8, 4] = -1.0
    costs[0, 0, 4] -= 1e-6  # first without what the others say
    roughness, _ = _chosen(costs, ROUGHNESS, np.full(6, SCALE))
    np.testing.assert_allclose(roughness, [0.4, 0.4, 0.4, 0.4, 0.4, 0.1], atol=1e-6)
    alone, _ = _chosen(costs[:, :, 4:5], ROUGHNESS, np.full(1, SCALE))
    assert alone[0] < 0.8
    # A diffuse part stays diffuse, whatever the others are.
    costs[0, :, 4] = 0.5
    assert _chosen(costs, ROUGHNESS, np.full(6, SCALE))[0][4] == 1.0


def kin_say(costs: np.ndarray, kin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    scale = np.full(costs.shape[2], SCALE)
    count = np.full(costs.shape[2], 1000.0)
    return _chosen(_as_kin_say(costs, ROUGHNESS, scale, count, kin), ROUGHNESS, scale)


def test_pieces_whose_gloss_is_faint_learn_of_their_kin() -> None:
    """Twenty clear ones at 0.4; one shows nothing, one a little against it; one is diffuse and one metal."""
    costs = costs_of([(0, 4, 0.0), (0, 4, 0.0), (0, 4, 1.0), (1, 7, -1.0), *[(0, 4, -1.0)] * 20])
    costs[0, :, 0] = 0.0
    costs[0, :, 1] = SCALE
    alone, _ = _chosen(costs, ROUGHNESS, np.full(24, SCALE))
    assert alone[0] > 0.6 and alone[1] > 0.8
    roughness, metallic = kin_say(costs, np.ones((24, 24)))
    np.testing.assert_allclose(roughness, [0.4, 0.4, 1.0, 0.7, *[0.4] * 20], atol=0.06)
    np.testing.assert_array_equal(metallic, [0, 0, 0, 1, *[0] * 20])
    # Among kin that are diffuse the same gloss is none.
    costs = costs_of([(0, 4, 1.0)] * 3 + [(0, 4, -2.0 * SCALE)])
    assert _chosen(costs, ROUGHNESS, np.full(4, SCALE))[0][3] < 0.5
    assert kin_say(costs, np.ones((4, 4)))[0][3] > 0.9


def test_a_large_piece_does_not_shout_down_its_kin() -> None:
    """One faint piece between four clear ones of 0.4 and a matt one of as many pixels as all of them."""
    costs = costs_of([(0, 4, 0.0), *[(0, 4, -1.0)] * 4, (0, 4, 1.0)])
    scale, count = np.full(6, SCALE), np.array([300.0, 500, 500, 500, 500, 9000])
    told = _as_kin_say(costs, ROUGHNESS, scale, count, np.ones((6, 6)))
    assert _chosen(told, ROUGHNESS, scale)[0][0] < 0.6


def test_kin_leave_it_to_the_part_whether_it_is_metal() -> None:
    """One fits metal and dark plastic of 0.4 alike; its kin are plastic."""
    costs = costs_of([(0, 4, -1.0)] * 5)
    costs[1, 4, 0] = -1.0
    np.testing.assert_allclose(kin_say(costs, np.ones((5, 5))), [[0.4] * 5, [0.5, 0, 0, 0, 0]], atol=1e-6)


def test_who_has_no_kin_is_judged_alone() -> None:
    costs = np.random.default_rng(0).normal(0.0, 3.0 * SCALE, (2, len(ROUGHNESS), 5))
    costs[0, -1] = 100.0
    scale = np.full(5, SCALE)
    told = _as_kin_say(costs, ROUGHNESS, scale, np.full(5, 1000.0), np.eye(5))
    np.testing.assert_allclose(told, costs, atol=1e-9)


def test_the_same_residuals_say_less_in_a_small_part() -> None:
    """A tenth of the pixels of a faint gloss are nearer to none."""
    (_, diffuse, specular), cell, part, color = synthetic(np.random.default_rng(2), [(1.0, 0.0)], 0.0, 0.0)
    gloss = 0.04 * specular[:, :, 0] + specular[:, :, 1]
    noise = 1.0 + 0.2 * np.random.default_rng(3).normal(size=color.shape)
    radiance = ((color * diffuse + gloss[:, 3]) * noise).clip(0.0).astype(np.float32)
    view = np.arange(len(part)) % VIEWS
    arrays = (radiance, diffuse, specular)

    def found(cells: int, kin: np.ndarray | None = None) -> float:
        some = slice(0, cells * VIEWS)
        columns = (cell[some], cell[some], part[some], view[some])
        return float(part_materials(*(a[some] for a in arrays), LEVELS, *columns, kin)[0][0])

    assert found(CELLS) < 0.5
    assert found(CELLS) < found(4) <= 1.0
    assert found(4, np.ones((1, 1))) < found(4)  # no caution where kin could contradict


def test_large_parts_are_told_by_whole_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_input, "PART_PIXELS", 1000)
    part = np.repeat([0, 1], [800, 20_000])
    cell = np.arange(len(part)) // 5
    some = training_input._some_of_each(part, cell, np.random.default_rng(0))
    assert some[part == 0].all()
    assert some[part == 1].sum() == pytest.approx(1000, rel=0.2)
    assert set(np.bincount(cell, some)) == {0.0, 5.0}
