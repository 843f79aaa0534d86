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
    "changes, code",
    [
        ({"no_such": 1}, "setting-unknown"),
        ({"batch_size": "many"}, "setting-invalid"),
        ({"batch_size": 1.5}, "setting-invalid"),
        ({"batch_size": 0}, "setting-invalid"),
        ({"learning_rate": float("nan")}, "setting-invalid"),
        ({"lambda_part": -1.0}, "setting-invalid"),
        ({"denoise": "perhaps"}, "setting-invalid"),
        ({"device": "abacus"}, "setting-invalid"),
        ({"roughness_levels": 2}, "setting-invalid"),
        ({"voxel_resolution": 2}, "setting-invalid"),
        ({"batch_size": float("inf")}, "setting-invalid"),
        ({"batch_size": "1" * 30}, "setting-invalid"),
        ({"seed": 1e30}, "setting-invalid"),
        ({"learning_rate": float("inf")}, "setting-invalid"),
        ({"learning_rate": "inf"}, "setting-invalid"),
        ({"learning_rate": 10**400}, "setting-invalid"),
        ({"learning_rate": True}, "setting-invalid"),
        ({"rounds": True}, "setting-invalid"),
        ({"denoise": 2}, "setting-invalid"),
        ({"denoise": "yes"}, "setting-invalid"),
        ({"denoise": ["false"]}, "setting-invalid"),
        ({"denoise": None}, "setting-invalid"),
        ({"device": ["llvm"]}, "setting-invalid"),
    ],
)
def test_values_that_make_no_sense(changes: dict, code: str) -> None:
    caught = error_of(make_settings, "medium", changes)
    assert caught.code == code and next(iter(changes)) in caught.text


def test_every_setting_explains_itself() -> None:
    for item in dataclasses.fields(Settings):
        assert item.metadata["help"]


@pytest.mark.parametrize("preset", ["ultra", ["draft"], None])
def test_presets_that_do_not_exist(preset: Any) -> None:
    assert "no preset" in str(error_of(make_settings, preset))


@pytest.mark.parametrize(
    "value, expected", [(True, True), (1, True), ("TRUE", True), (False, False), (0, False), ("0", False)]
)
def test_switches_take_true_false_one_and_zero(value: Any, expected: bool) -> None:
    assert make_settings("draft", {"denoise": value}).denoise is expected
