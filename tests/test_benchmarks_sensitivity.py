# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sensitivity table: which settings it varies, what it scores, and a stored estimate made again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import sensitivity
from benchmarks.metrics import Maps
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.settings import make_settings
from samples.small_captures import COLORS, panel_capture, run_here, write_run


def make_maps(rows: int, columns: int) -> Maps:
    """Maps whose first pixel emits; the second is glossy."""
    grey, value = np.full((rows, columns, 3), 0.5), np.ones((rows, columns))
    roughness, emission = value.copy(), 0 * grey
    roughness[0, 1], emission[0, 0] = 0.3, 5.0
    return Maps(grey, grey, grey, roughness, 0 * value, emission, value > 0)


def test_each_setting_is_halved_and_doubled() -> None:
    settings = make_settings("draft", {"lambda_diffuse": 0.25, "roughness_levels": 5})
    made = sensitivity.variants(settings, ["lambda_diffuse", "roughness_levels"], 2)
    assert [each.label for each in made] == [
        "as it is", "seed 1", "lambda_diffuse = 0.125", "lambda_diffuse = 0.5",
        "roughness_levels = 2", "roughness_levels = 10",
    ]  # fmt: skip
    assert made[0].settings == settings and made[1].settings == replace(settings, seed=1)
    assert made[4].settings == replace(settings, roughness_levels=2)


@pytest.mark.parametrize("name", ["no_such_setting", "denoise", "masking"])
def test_only_numbers_are_varied(name: str) -> None:
    with pytest.raises(FiptError, match=name):
        sensitivity.variants(make_settings("draft", {}), [name], 1)


def test_scores_count_surfaces_and_for_kd_sampled_diffuse_ones() -> None:
    true = sensitivity.joined([make_maps(1, 2), make_maps(2, 2)])
    assert true.roughness.shape == (6, 1) and true.kd.shape == (6, 1, 3)
    roughness, metallic = true.roughness[:, 0].copy(), np.zeros(6)
    roughness[0] = metallic[2] = 9.0  # emitters
    roughness[1] += 0.2
    roughness[5] = metallic[5] = np.nan  # of a view that was left out
    rows = np.array([1, 4])  # the first is glossy
    found = sensitivity.ClosedForm(rows, np.array([[9.0] * 3, [0.6] * 3]), roughness, metallic)
    scores = sensitivity.scores(found, true)
    assert scores["kd_psnr"] == pytest.approx(20.0)
    assert scores["sigma_psnr"] == pytest.approx(-10 * np.log10(0.04 / 3))
    assert scores["metallic_psnr"] == 100.0


def test_table_has_a_row_for_each_variant() -> None:
    one = {"as it is": {"kd_psnr": 1.5, "sigma_psnr": None, "metallic_psnr": 3.0}}
    other = {**one, "seed 1": {"kd_psnr": 4.0, "sigma_psnr": 5.0, "metallic_psnr": 6.0}}
    lines = sensitivity.format_table({"a": other, "b": one}).splitlines()
    assert lines[2:] == [
        "| as it is | 1.50 / - / 3.00 | 1.50 / - / 3.00 |",
        "| seed 1 | 4.00 / 5.00 / 6.00 |  |",
    ]


@pytest.mark.usefixtures("one_thread")
def test_a_stored_run_gives_its_estimate_again(tmp_path: Path) -> None:
    """A lit box of diffuse walls: the same twice, near the truth, and the run stays as it was."""
    capture = panel_capture()
    run = write_run(tmp_path / "run", capture, rounds=0, training_steps=1)
    run_here(run)
    before = {path: path.stat().st_mtime_ns for path in run.stage.rglob("*") if path.is_file()}
    from benchmarks.stored import StoredEstimate

    settings = run.read()
    (tmp_path / "scratch").mkdir()
    stored = StoredEstimate(run, settings, tmp_path / "scratch")
    found, again = stored.closed_form(settings), stored.closed_form(settings)
    assert np.array_equal(found.kd, again.kd) and np.array_equal(found.roughness, again.roughness)
    triangle = np.asarray(stored.pixels.triangle)
    assert len(found.roughness) == len(found.metallic) == len(triangle)
    walls = (triangle[found.rows] >= 0) & (triangle[found.rows] < 2 * len(COLORS))
    wrong = np.abs(found.kd[walls] - np.array(COLORS)[triangle[found.rows][walls] // 2])
    assert walls.mean() > 0.9 and np.median(wrong) < 0.06
    assert before == {path: path.stat().st_mtime_ns for path in run.stage.rglob("*") if path.is_file()}
