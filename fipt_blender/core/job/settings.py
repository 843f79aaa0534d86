# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every constant of the method under its own name, and the presets that choose among them.

Standard library only: both processes import it. Values without a note are the paper's (Sec. 4 and
supplementary "Implementation Details").
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .errors import FiptError

# The first stage of an estimation that reads a setting: what was finished before it is kept when the setting
# changes. None where no stage's result depends on it.
PIXELS, SHADINGS, TRAINING = "pixels", "shadings", "training-0"
REFINEMENT, LATER_TRAINING = "refinement-1", "training-1"


def _setting(default: Any, text: str, stage: str | None) -> Any:
    return field(default=default, metadata={"help": text, "stage": stage})


@dataclass(frozen=True)
class Settings:
    """All settings of one run; JSON-serialisable, equal settings give equal results."""

    preset: str = _setting("medium", "draft, medium or high: where the other settings start from", None)
    seed: int = _setting(0, "seed of every random number in the run", PIXELS)
    device: str = _setting("auto", "auto, cuda or llvm (CPU)", PIXELS)
    rounds: int = _setting(2, "how often stages 2 and 3 are repeated after stage 1", None)
    view_share: float = _setting(1.0, "share of the training views that is used, spread evenly", PIXELS)
    reject_views: bool = _setting(
        True, "leave out photographs that do not lie where their cameras say", PIXELS
    )
    correct_exposure: bool = _setting(
        True, "bring photographs that were exposed otherwise to the rest", PIXELS
    )

    masking: str = _setting(
        "schlick", "G of the BRDF: schlick as in the authors' data, smith as in Cycles", SHADINGS
    )
    voxel_resolution: int = _setting(
        256, "radiance cache: voxels along each axis of the room's bounds", SHADINGS
    )
    roughness_levels: int = _setting(8, "roughness levels at which specular shading is baked", SHADINGS)
    roughness_spacing: float = _setting(
        1.5, "exponent of the levels' spacing; 1 is the paper's linear one", SHADINGS
    )
    roughness_min: float = _setting(0.02, "lowest roughness (authors' code; 0 is singular)", SHADINGS)
    diffuse_spp: int = _setting(16, "stage 1: samples a pixel for diffuse shading", SHADINGS)
    specular_spp: int = _setting(
        4, "stage 1: samples a pixel and roughness level for specular shading", SHADINGS
    )
    light_spp: int = _setting(8, "stage 1: samples a pixel aimed at bright triangles", SHADINGS)
    refine_diffuse_spp: int = _setting(32, "stage 3: samples a pixel for diffuse shading", REFINEMENT)
    refine_specular_spp: int = _setting(
        8, "stage 3: samples a pixel and level for specular shading", REFINEMENT
    )
    refine_light_spp: int = _setting(16, "stage 3: samples a pixel aimed at emitters", REFINEMENT)
    refine_depth: int = _setting(
        5, "stage 3: most surfaces a path may meet before it ends in the cache", REFINEMENT
    )
    cache_roughness: float = _setting(
        0.6, "stage 3: rougher surfaces end a path in the radiance cache", REFINEMENT
    )
    refine_cache: bool = _setting(
        True,
        "stage 3: end paths in the radiance cache; false traces all with the estimate (ablation)",
        REFINEMENT,
    )
    denoise: bool = _setting(True, "denoise diffuse shading with Open Image Denoise", SHADINGS)
    denoise_specular: bool = _setting(
        False,
        "denoise specular shading too: costs more time than the rays that it saves",
        SHADINGS,
    )

    training_steps: int = _setting(300, "stage 2: optimiser steps of the first round", TRAINING)
    later_training_steps: int = _setting(300, "stage 2: optimiser steps of each later round", LATER_TRAINING)
    batch_size: int = _setting(8192, "stage 2: pixels a step", TRAINING)
    learning_rate: float = _setting(1e-3, "stage 2: Adam's first learning rate", TRAINING)
    hash_learning_rate: float = _setting(
        3e-3,
        "stage 2: that of the hash grid, whose entries are reached by few pixels (paper: as the rest)",
        TRAINING,
    )
    lambda_emission: float = _setting(1.0, "weight of the emission mask's L1 term l_e", TRAINING)
    lambda_diffuse: float = _setting(5e-4, "weight of l_d, which prefers diffuse surfaces", TRAINING)
    lambda_part: float = _setting(
        5e-2,
        "weight of l_p with part masks, towards the closed form (paper: 5e-3, towards a batch's mean)",
        TRAINING,
    )
    lambda_semantic: float = _setting(1e-3, "weight of l_p with semantic masks", TRAINING)
    sigma_albedo: float = _setting(0.05 / 3.0, "semantic kernel: width in base colour", TRAINING)
    sigma_position: float = _setting(0.3 / 3.0, "semantic kernel: width in the normalised box", TRAINING)
    hash_levels: int = _setting(32, "hash grid: levels", TRAINING)
    hash_features: int = _setting(2, "hash grid: features a level", TRAINING)
    hash_log2_size: int = _setting(19, "hash grid: log2 of entries a level", TRAINING)
    hash_base_resolution: int = _setting(16, "hash grid: cells along an axis at the coarsest level", TRAINING)
    hash_growth: float = _setting(1.3, "hash grid: growth of resolution between levels", TRAINING)
    brdf_width: int = _setting(64, "BRDF network: hidden width", TRAINING)
    brdf_depth: int = _setting(2, "BRDF network: hidden layers", TRAINING)
    emission_bands: int = _setting(10, "emission network: bands of the positional encoding", TRAINING)
    emission_width: int = _setting(128, "emission network: hidden width", TRAINING)
    emission_depth: int = _setting(6, "emission network: hidden layers", TRAINING)
    checkpoint_steps: int = _setting(500, "stage 2: steps between training checkpoints", None)

    emission: str = _setting(
        "mask",
        "mask: emitters by an emission mask; joint: emission fitted with the materials (ablation)",
        TRAINING,
    )
    lambda_joint: float = _setting(
        1e-2,
        "joint emission: weight of its L1 norm, in units of the capture's median (the paper names none)",
        TRAINING,
    )
    emitter_threshold: float = _setting(
        0.01, "mean emission mask above which a triangle is an emitter", TRAINING
    )
    emitter_samples: int = _setting(
        100, "positions a triangle at which the emission mask is sampled", TRAINING
    )
    environment_width: int = _setting(256, "width in pixels of the estimated environment map", SHADINGS)

    texel_density: float = _setting(128.0, "texels a metre of the textures", None)
    texture_size: int = _setting(2048, "largest width and height of one texture image", None)
    atlas_mode: str = _setting("uv", "uv, or color_attribute where UVs can't work", None)
    write_back: str = _setting(
        "cycles", "cycles: nodes that make Cycles agree with the fit; paper: none", None
    )


PRESETS: dict[str, dict[str, Any]] = {
    "draft": {
        "rounds": 1,
        "training_steps": 250,
        "later_training_steps": 250,
        "batch_size": 4096,
    },
    "medium": {},
    "high": {
        "diffuse_spp": 64,
        "specular_spp": 16,
        "light_spp": 32,
        "refine_diffuse_spp": 128,
        "refine_specular_spp": 32,
        "refine_light_spp": 64,
        "training_steps": 2000,
        "later_training_steps": 4000,
        "roughness_levels": 12,
        "denoise_specular": True,
    },
}


def make_settings(preset: str = "medium", changes: Mapping[str, Any] | None = None) -> Settings:
    """Settings of a preset with single values changed.

    Args:
        preset: a key of ``PRESETS``.
        changes: field name to value; strings are converted to the field's type.

    Raises:
        FiptError: ``setting-unknown`` or ``setting-invalid``.
    """
    if preset not in PRESETS:
        raise FiptError(
            "setting-unknown", f"There is no preset '{preset}'.", f"Use one of: {', '.join(PRESETS)}."
        )
    values: dict[str, Any] = {"preset": preset, **PRESETS[preset]}
    fields = {item.name: item for item in dataclasses.fields(Settings)}
    for name, value in (changes or {}).items():
        if name not in fields:
            raise FiptError(
                "setting-unknown", f"There is no setting '{name}'.", f"Use one of: {', '.join(fields)}."
            )
        values[name] = _convert(name, value, type(fields[name].default))
    settings = Settings(**values)
    _check(settings)
    return settings


def _convert(name: str, value: Any, kind: type) -> Any:
    try:
        if kind is bool:
            if isinstance(value, str):
                return {"true": True, "1": True, "false": False, "0": False}[value.lower()]
            return bool(value)
        if kind is int and isinstance(value, float) and value != int(value):
            raise ValueError
        return kind(value)
    except (KeyError, TypeError, ValueError):
        raise FiptError(
            "setting-invalid", f"'{value}' is no value for setting '{name}'.", f"Give a {kind.__name__}."
        ) from None


def _check(settings: Settings) -> None:
    choices = {
        "device": ("auto", "cuda", "llvm"),
        "atlas_mode": ("uv", "color_attribute"),
        "write_back": ("cycles", "paper"),
        "masking": ("schlick", "smith"),
        "emission": ("mask", "joint"),
    }
    for name, allowed in choices.items():
        if getattr(settings, name) not in allowed:
            raise FiptError(
                "setting-invalid",
                f"'{getattr(settings, name)}' is no value for setting '{name}'.",
                f"Use one of: {', '.join(allowed)}.",
            )
    for item in dataclasses.fields(Settings):
        value = getattr(settings, item.name)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if number and (value != value or value < 0 or (value == 0 and item.name not in _MAY_BE_ZERO)):
            raise FiptError(
                "setting-invalid", f"Setting '{item.name}' is {value}.", "Give a number above zero."
            )
        if item.name == "view_share" and value > 1.0:
            raise FiptError("setting-invalid", f"Setting 'view_share' is {value}.", "Give at most 1.")
        if number and value < _LEAST.get(item.name, value):
            raise FiptError(
                "setting-invalid",
                f"Setting '{item.name}' is {value}.",
                f"Give at least {_LEAST[item.name]}.",
            )


# Below these there is nothing to interpolate between, or no room inside the free border.
_LEAST = {"roughness_levels": 3, "voxel_resolution": 8, "environment_width": 4}
_MAY_BE_ZERO = {
    "seed",
    "rounds",
    "lambda_emission",
    "lambda_joint",
    "lambda_diffuse",
    "lambda_part",
    "lambda_semantic",
    "emitter_threshold",
    "emission_depth",
    "brdf_depth",
}
