# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy command's metrics on small arrays whose answers are known."""

import dataclasses

import numpy as np
import pytest

from benchmarks import metrics, truth
from benchmarks.metrics import Maps
from fipt_blender.core.report import comparison


def make_maps() -> Maps:
    """2 x 4 pixels: one misses the mesh, one emits, two are glossy, four are diffuse."""
    shape = (2, 4)
    roughness = np.ones(shape)
    roughness[0, 2:] = 0.3
    emission = np.zeros((*shape, 3))
    emission[0, 1] = [0.0, 2.0, 0.0]
    hit = np.ones(shape, bool)
    hit[0, 0] = False
    grey = np.full((*shape, 3), 0.4)
    return Maps(grey, grey, grey, roughness, np.zeros(shape), emission, hit)


def test_protocols_differ_in_what_counts() -> None:
    """An error of 0.2 in kd everywhere: four of eight pixels count, or are averaged with four right ones."""
    true = make_maps()
    predicted = dataclasses.replace(true, kd=true.kd + 0.2)
    strict = metrics.map_metrics([predicted], [true], True)["kd_psnr"]
    paper = metrics.map_metrics([predicted], [true], False)["kd_psnr"]
    assert strict == pytest.approx(-10 * np.log10(0.04), abs=1e-9)
    assert paper == pytest.approx(-10 * np.log10(0.02), abs=1e-9)


def test_only_diffuse_pixels_count_for_kd_and_emitters_for_none() -> None:
    true = make_maps()
    kd = true.kd.copy()
    kd[0] = 9.0
    roughness = true.roughness.copy()
    roughness[0, :2] = 0.0
    predicted = dataclasses.replace(true, kd=kd, roughness=roughness)
    found = metrics.map_metrics([predicted], [true], True)
    assert found["kd_psnr"] == found["sigma_psnr"] == 100.0


def test_errors_at_borders_and_inside_are_told_apart() -> None:
    """Errors of 0.2 at the two columns of a border and of 0.02 elsewhere, in views of different size."""

    def view(rows: int) -> tuple[Maps, Maps]:
        shape = (rows, 6)
        grey, rough = np.full((*shape, 3), 0.4), np.ones(shape)
        material = np.repeat([[1, 1, 1, 2, 2, 2]], rows, axis=0)
        true = Maps(grey, grey, grey, rough, 0 * rough, 0 * grey, np.ones(shape, bool), material)
        off = np.where(metrics.near_borders(material), 0.2, 0.02)
        wrong = dataclasses.replace(true, kd=grey + off[..., None], roughness=rough + off, metallic=off)
        return wrong, true

    pairs = [view(2), view(5)]
    found = metrics.border_metrics([wrong for wrong, _ in pairs], [true for _, true in pairs])
    for name in ("kd_psnr", "sigma_psnr", "metallic_psnr"):
        assert found["edge"][name] == pytest.approx(-20 * np.log10(0.2))
        assert found["inside"][name] == pytest.approx(-20 * np.log10(0.02))
    assert found["edge"]["a_prime_psnr"] == found["inside"]["a_prime_psnr"] == 100.0
    assert found["edge_share"] == pytest.approx(1.0 / 3.0)


def test_errors_are_pooled_over_views() -> None:
    kept = [np.ones((1, 1), bool), np.ones((1, 3), bool)]
    true = [np.zeros((1, 1)), np.zeros((1, 3))]
    predicted = [np.full((1, 1), 0.2), np.zeros((1, 3))]
    assert metrics.pooled_psnr(predicted, true, kept, True) == pytest.approx(20.0)
    nothing = [np.zeros((1, 1), bool), np.zeros((1, 3), bool)]
    assert metrics.pooled_psnr(predicted, true, nothing, True) is None


def test_quantisation_hides_small_errors_only_in_the_papers_protocol() -> None:
    kept, true = [np.ones((2, 2), bool)], [np.full((2, 2), 100.0 / 255.0)]
    predicted = [true[0] + 0.4 / 255.0]
    assert metrics.pooled_psnr(predicted, true, kept, False) == 100.0
    assert metrics.pooled_psnr(predicted, true, kept, True) == pytest.approx(-20 * np.log10(0.4 / 255.0))


def test_emission() -> None:
    true, predicted = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
    true[0] = [np.e - 1.0, 0.0, 0.0]
    predicted[:, 0] = [0.0, 0.0, np.e - 1.0]
    assert metrics.emission_iou([predicted], [true]) == pytest.approx(1.0 / 3.0)
    assert metrics.log_l2([predicted], [true]) == pytest.approx(4.0 / 12.0)
    assert metrics.emission_iou([np.zeros((1, 1, 3))], [np.zeros((1, 1, 3))]) == 1.0


def test_rendered_images() -> None:
    true = np.full((2, 2, 3), 0.5)
    true[0] = 7.0
    predicted = true.copy()
    predicted[1] = (0.5**comparison.GAMMA + 0.1) ** 2.2
    predicted[0] = 3.0  # clipped in both
    assert metrics.image_psnr(predicted, true) == pytest.approx(-10 * np.log10(0.005))
    assert metrics.image_psnr(predicted, true, strict=True) == pytest.approx(20.0)
    assert metrics.image_psnr(true * 0 + 2, true * 0 + 2, strict=True) is None
    mean = metrics.mean_image_psnr([predicted, predicted], [true, predicted])
    assert mean == pytest.approx((metrics.image_psnr(predicted, true) + 100.0) / 2.0)
    assert metrics.mean_image_psnr([], []) is None


@pytest.mark.parametrize("filtered", [False, True])
def test_filtered_ground_truth_is_recognised(filtered: bool) -> None:
    """A disc of roughness 0.3 on 1, sampled at pixel centres or averaged over 8 x 8 positions a pixel."""
    side, fine = 32, 8
    x, y = np.meshgrid(*[(np.arange(side * fine) + 0.5) / fine] * 2)
    disc = np.where((x - 15.3) ** 2 + (y - 17.1) ** 2 < 90.0, 0.3, 1.0).reshape(side, fine, side, fine)
    roughness = disc.mean(axis=(1, 3)) if filtered else disc[:, fine // 2, :, fine // 2]
    maps = dataclasses.replace(make_maps(), roughness=roughness)
    assert truth.maps_are_filtered([maps]) is filtered
    assert truth.maps_are_filtered([dataclasses.replace(maps, roughness=np.ones((9, 9)))]) is False
