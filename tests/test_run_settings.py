# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings: presets, conversion of strings, invalid values."""

import dataclasses
from typing import Any

import pytest

from fipt_blender.core.run.settings import PRESETS, Settings, make_settings
from samples.refusals import error_of


def test_presets_and_changes() -> None:
    assert make_settings() == Settings()
    for preset, values in PRESETS.items():
        settings = dataclasses.asdict(make_settings(preset))
        assert settings["preset"] == preset and values.items() <= settings.items()
    changed = make_settings("draft", {"seed": "7", "denoise": "false", "lambda_part": "0", "batch_size": 64.0})
    assert (changed.seed, changed.denoise, changed.lambda_part, changed.batch_size) == (7, False, 0.0, 64)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("batch_size", ["many", 1.5, 0, float("inf"), "1" * 30]),
        ("learning_rate", [float("nan"), float("inf"), "inf", 10**400, True]),
        ("denoise", ["perhaps", 2, "yes", ["false"], None]),
        ("device", ["abacus", ["llvm"]]),
        *[("lambda_part", [-1.0]), ("roughness_levels", [2]), ("voxel_resolution", [2]), ("rounds", [True])],
        ("seed", [1e30]),
    ],
)
def test_values_that_make_no_sense(name: str, values: list[Any]) -> None:
    for value in values:
        caught = error_of(make_settings, "medium", {name: value})
        assert caught.code == "setting-invalid" and name in caught.text, value
    assert error_of(make_settings, "medium", {"no_such": 1}).code == "setting-unknown"


def test_every_setting_explains_itself() -> None:
    for item in dataclasses.fields(Settings):
        assert item.metadata["help"]


def test_presets_that_do_not_exist() -> None:
    for preset in ("ultra", ["draft"], None):
        assert "no preset" in str(error_of(make_settings, preset))


@pytest.mark.parametrize(("values", "expected"), [((True, 1, "TRUE"), True), ((False, 0, "0"), False)])
def test_switches_take_true_false_one_and_zero(values: tuple, expected: bool) -> None:
    assert all(make_settings("draft", {"denoise": value}).denoise is expected for value in values)
