# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a run, what users and ablations vary, and the presets.

Further tuned constants are module constants beside the code that uses them; a change of those changes the
stage keys too (:mod:`.method`). A help text says where a default departs from the paper, or which code or
paper it follows where the two differ. Standard library only: both processes import it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .errors import FiptError
from .stage_settings import (
    CheckSettings,
    MaterialSettings,
    PhotometrySettings,
    RefinementSettings,
    RefitSettings,
    ResultSettings,
    RoomSettings,
    TextureSettings,
    TrainingSettings,
    ViewSettings,
    setting,
)

Value = str | int | float | bool

# Settings of earlier versions, which their runs name; what they stood for is gone.
_REMOVED = ("doubt_pixels", "lamp_outlines", "emission", "lambda_joint", "joint_threshold", "kept_versions")

# The settings of Apply Results; no stage of an estimation reads them.
TEXTURE_SETTINGS = ("texel_density", "texture_size", "atlas_images", "atlas_mode", "write_back", "clean_mesh")


@dataclass(frozen=True)
class RunSettings:
    """What the stages are, and where they run."""

    preset: str = setting("medium", "draft, medium or high: the preset that other settings start from")
    device: str = setting("auto", "auto, cuda or llvm (CPU)")
    rounds: int = setting(1, "number of times that stages 3 and 2 are repeated after stages 1 and 2")


@dataclass(frozen=True)
class Settings(
    TextureSettings,
    ResultSettings,
    TrainingSettings,
    MaterialSettings,
    RefinementSettings,
    RefitSettings,
    PhotometrySettings,
    CheckSettings,
    RoomSettings,
    ViewSettings,
    RunSettings,
):
    """All settings of one run; JSON-serialisable. Runs with equal settings have equal results."""


PRESETS: dict[str, dict[str, Value]] = {
    "draft": {"light_pixels": 2.0, "training_steps": 250, "batch_size": 4096},
    "medium": {},
    "high": {
        "rounds": 2,
        "light_pixels": 8.0,
        "diffuse_spp": 64,
        "specular_spp": 16,
        "light_spp": 32,
        "refine_diffuse_spp": 128,
        "refine_specular_spp": 32,
        "refine_light_spp": 64,
        "training_steps": 4000,
        "learning_rate": 1e-3,
        "hash_learning_rate": 3e-3,
        "roughness_levels": 12,
    },
}


def make_settings(preset: str = "medium", changes: Mapping[str, Value] | None = None) -> Settings:
    """Settings of a preset with some values changed.

    Args:
        preset: a key of ``PRESETS``.
        changes: field name to value; strings are converted to the field's type.

    Raises:
        FiptError: ``setting-unknown`` or ``setting-invalid``.
    """
    if not isinstance(preset, str) or preset not in PRESETS:
        raise FiptError(
            "setting-unknown", f"There is no preset '{preset}'.", f"Use one of: {', '.join(PRESETS)}."
        )
    values: dict[str, Any] = {"preset": preset, **PRESETS[preset]}
    return Settings(**values | converted(Settings, changes or {}, _LIMITS))


def stored_settings(values: Mapping[str, Any]) -> Settings:
    """Settings as a run has stored them; those that versions since have removed are left out.

    Raises:
        FiptError: see `make_settings`.
    """
    kept = {name: value for name, value in values.items() if name not in _REMOVED}
    return make_settings(kept.pop("preset", "medium"), kept)


def converted(
    kind: Any, changes: Mapping[str, Any], limits: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Changed values of settings, in the types of the defaults.

    Args:
        kind: a dataclass of settings.
        changes: field name to value; texts are converted.
        limits: of fields: `choices` of a text; `low` and `high` of a number, which otherwise is above zero;
            `zero` if 0 is allowed, too.

    Raises:
        FiptError: ``setting-unknown`` or ``setting-invalid``.
    """
    known = {item.name: item for item in dataclasses.fields(kind)}
    values = {}
    for name, value in changes.items():
        if name not in known:
            raise FiptError(
                "setting-unknown", f"There is no setting '{name}'.", f"Use one of: {', '.join(known)}."
            )
        try:
            values[name] = _converted(value, known[name].default, limits.get(name, {}))
        except ValueError as error:
            raise FiptError(
                "setting-invalid",
                f"'{str(value)[:80]}' is not a valid value of the setting '{name}'.",
                f"Give {error}.",
            ) from None
    return values


def _converted(value: Any, default: Any, limits: Mapping[str, Any]) -> Any:
    """A setting's value in the type of its default.

    Raises:
        ValueError: what the setting takes.
    """
    if isinstance(default, str):
        choices = limits.get("choices", (value,))
        if not isinstance(value, str) or value not in choices:
            raise ValueError(f"one of: {', '.join(map(str, choices))}")
        if len(value) > 4096 or not value.isprintable():
            raise ValueError("a text of at most 4096 letters")
        return value
    if isinstance(default, bool):
        truths = {"true": True, "1": True, "false": False, "0": False}
        if str(value).lower() not in truths:
            raise ValueError("true or false")
        return truths[str(value).lower()]
    low, high = limits.get("low"), limits.get("high", _MOST)
    whole = isinstance(default, int) and isinstance(value, float) and value.is_integer()
    try:
        number = type(default)(str(int(value) if whole else value))
    except ValueError:
        number = math.nan
    if not ((number > 0 if low is None else number >= low) and number <= high):  # NaN is neither
        if number != 0 or not limits.get("zero"):
            kind = "a whole number" if isinstance(default, int) else "a number"
            least = "above zero" if low is None else f"of at least {low}"
            raise ValueError(f"{'0, or ' if limits.get('zero') else ''}{kind} {least}, at most {high}")
    return number


# Largest value of any setting: counts and seeds must fit into the integers of all libraries.
_MOST = 2**31 - 1
_ZERO = (
    *("seed", "rounds", "lambda_diffuse", "lambda_emission", "lambda_part"),
    *("lambda_semantic", "brdf_depth"),
)
_LIMITS: dict[str, dict[str, Any]] = {
    **{key: {"zero": True} for key in _ZERO},
    **{key: {"high": 1} for key in ("view_share", "view_outliers")},
    # The time to close a hole grows with the cube of its edges.
    "close_holes_edges": {"zero": True, "high": 1000},
    # With smaller values there is nothing to interpolate between, or no room inside the grid's empty border.
    "roughness_levels": {"low": 3},
    "voxel_resolution": {"low": 8},
    "environment_width": {"low": 4},
    "device": {"choices": ("auto", "cuda", "llvm")},
    "atlas_images": {"choices": ("room", "object", "part")},
    "atlas_mode": {"choices": ("uv", "color_attribute")},
    "write_back": {"choices": ("cycles", "paper")},
    "masking": {"choices": ("schlick", "smith")},
}
