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
from dataclasses import dataclass, field
from typing import Any

from .errors import FiptError

# The first stage of an estimation that reads a setting: if the setting changes, the stages before it are
# kept. None if no stage's result depends on it.
PIXELS, SHADINGS, ESTIMATE = "pixels", "shadings", "estimate-0"
REFINEMENT, TRAINING = "refinement-1", "training"

Value = str | int | float | bool

# Settings of earlier versions, which their runs name; what they stood for is gone.
_REMOVED = ("doubt_pixels", "lamp_outlines", "emission", "lambda_joint", "joint_threshold")

# The settings of Apply Results; no stage of an estimation reads them.
TEXTURE_SETTINGS = ("texel_density", "texture_size", "atlas_images", "atlas_mode", "write_back", "clean_mesh")


def _setting(default: Any, text: str, stage: str | None) -> Any:
    return field(default=default, metadata={"help": text, "stage": stage})


def _switch(text: str, stage: str | None) -> Any:
    """Of a mechanism that the paper does not have; benchmarks/trial.py measures what each one brings."""
    return _setting(True, f"{text} (not in the paper)", stage)


@dataclass(frozen=True)
class Settings:
    """All settings of one run; JSON-serialisable. Runs with equal settings have equal results.

    Help texts compare defaults with the paper (main text or supplementary) and with the authors' released
    code. The metadata of each field holds its `help` and its `stage`, the first stage that reads it.
    """

    preset: str = _setting("medium", "draft, medium or high: the preset that other settings start from", None)
    seed: int = _setting(0, "seed of all random numbers of the run", PIXELS)
    device: str = _setting("auto", "auto, cuda or llvm (CPU)", PIXELS)
    rounds: int = _setting(1, "number of times that stages 3 and 2 are repeated after stages 1 and 2", None)
    view_share: float = _setting(1.0, "share of the training views that is used, spread evenly", PIXELS)
    light_pixels: float = _setting(
        4.0,
        "millions of pixels of all views together at which light is solved; larger photographs are averaged"
        " (not in the paper)",
        PIXELS,
    )
    reject_views: bool = _setting(
        True, "leave out photographs that contradict their camera poses (not in the paper)", PIXELS
    )
    force: bool = _setting(
        False,
        "estimate although input, mesh or poses look useless, or the disk too small (not in the paper)",
        PIXELS,
    )
    correct_exposure: bool = _setting(
        True, "correct photographs whose exposure differs from the others' (not in the paper)", PIXELS
    )

    clean_scan: bool = _setting(
        True,
        "work on a cleaned copy of a scanned mesh; exact meshes stay as they are (not in the paper)",
        PIXELS,
    )
    close_holes_edges: int = _setting(
        120,
        "close holes of a scanned mesh that have at most so many edges, 0 for none; flat ones of over 100"
        " squared edges may be windows and are closed where photographs say so (not in the paper)",
        PIXELS,
    )
    panes: bool = _switch("close flat holes of a scan in which photographs show a surface", PIXELS)
    lost_surfaces: bool = _switch("add things that photographs show and a scan lacks, as prisms", PIXELS)
    torn_parts: bool = _switch("complete parts that a scan tore", PIXELS)
    outlines: bool = _switch("move the outlines of a scan's parts to those of the masks", PIXELS)
    unmix: bool = _switch("use mixed pixels by their share of each surface's radiance", PIXELS)
    unmeshed_lamps: bool = _switch("leave out pixels of lamps that the mesh lacks", PIXELS)
    clipped_lamps: bool = _switch(
        "find the radiance of clipped lamps by the light that they cast, where photographs are not HDR",
        PIXELS,
    )
    refit_photographs: bool = _switch(
        "adjust photographs that are not HDR once more with baked light", PIXELS
    )
    unseen_light: bool = _switch("infer the light that enters an open mesh from unseen directions", PIXELS)
    presumed_lamps: bool = _switch(
        "stage 1: give bright surfaces of constant radiance that of their fixture, not of the cache", PIXELS
    )

    masking: str = _setting(
        "schlick", "G of the BRDF: schlick as in the authors' code, smith as in Cycles", SHADINGS
    )
    voxel_resolution: int = _setting(
        256, "radiance cache: voxels along each axis of the room's bounds", SHADINGS
    )
    roughness_levels: int = _setting(
        8, "number of roughness levels at which specular shading is baked (paper: 6)", SHADINGS
    )
    roughness_spacing: float = _setting(
        1.5, "exponent of the spacing of the roughness levels (paper: 1, linear)", SHADINGS
    )
    roughness_min: float = _setting(
        0.02, "lowest roughness level, as in the authors' code (paper: 0, where GGX is singular)", SHADINGS
    )
    diffuse_spp: int = _setting(
        16, "stage 1: cosine samples per pixel (paper: 128; authors' code: 256)", SHADINGS
    )
    specular_spp: int = _setting(
        4,
        "stage 1: visible-normal samples per pixel and roughness level (paper: 64; authors' code: 64 for the"
        " first level, 128 for each other)",
        SHADINGS,
    )
    light_spp: int = _setting(
        8, "stage 1: samples per pixel aimed at bright triangles (not in the paper)", SHADINGS
    )
    refine_diffuse_spp: int = _setting(32, "stage 3: cosine samples per pixel (paper: 128)", REFINEMENT)
    refine_specular_spp: int = _setting(
        8, "stage 3: visible-normal samples per pixel and roughness level (paper: 64)", REFINEMENT
    )
    refine_light_spp: int = _setting(
        16, "stage 3: samples per pixel aimed at emitters (paper: part of its samples, by MIS)", REFINEMENT
    )
    refine_depth: int = _setting(
        5,
        "stage 3: largest number of surfaces on a path before it ends in the cache (authors' code)",
        REFINEMENT,
    )
    cache_roughness: float = _setting(
        0.6, "stage 3: paths end in the radiance cache at surfaces rougher than this", REFINEMENT
    )
    refine_cache: bool = _setting(
        True,
        "stage 3: end paths in the radiance cache; false traces them with the estimate alone (ablation)",
        REFINEMENT,
    )
    denoise: bool = _setting(
        True, "denoise diffuse shading with Open Image Denoise (paper: OptiX denoiser)", SHADINGS
    )
    denoise_specular: bool = _setting(
        True, "denoise the brightness of the specular shadings too (paper: their channels)", SHADINGS
    )

    training_steps: int = _setting(
        300,
        "stage 2: optimiser steps after the last closed-form estimate (paper: 2 epochs in each round)",
        TRAINING,
    )
    batch_size: int = _setting(8192, "stage 2: pixels per step", TRAINING)
    learning_rate: float = _setting(
        3e-3, "stage 2: initial learning rate of Adam, which falls to a tenth (paper: 1e-3)", TRAINING
    )
    hash_learning_rate: float = _setting(
        1e-2,
        "stage 2: initial learning rate of the hash grid, of which few pixels reach each entry (paper: 1e-3)",
        TRAINING,
    )
    lambda_emission: float = _setting(1.0, "weight of l_e, the L1 norm of the emission mask", TRAINING)
    lambda_diffuse: float = _setting(5e-4, "weight of l_d, the preference for diffuse surfaces", TRAINING)
    residual_degrees: float = _setting(
        3.0,
        "closed form of roughness and metallic: degrees of freedom of the residuals' t-distribution; fewer"
        " ignore more outliers (this and the next three are not in the paper)",
        ESTIMATE,
    )
    pixels_per_sample: float = _setting(
        10.0, "closed form: number of neighbouring pixels that share their errors and count as one", ESTIMATE
    )
    view_error: float = _setting(
        5e-3,
        "closed form: standard deviation of the error that a view's shadings share, relative to radiance",
        ESTIMATE,
    )
    view_outliers: float = _setting(
        0.1, "closed form: share of the views whose shadings tell nothing about a part's gloss", ESTIMATE
    )
    prior_weight: float = _setting(
        1.0, "closed form: weight of a prior over materials, as a number of parts that follow it", ESTIMATE
    )
    lambda_part: float = _setting(
        5e-2,
        "weight of l_p with part masks, towards the closed form (paper: 5e-3, towards the mean of a batch)",
        TRAINING,
    )
    lambda_semantic: float = _setting(1e-3, "weight of l_p with semantic masks", TRAINING)
    sigma_albedo: float = _setting(
        0.05 / 3.0, "semantic kernel: sigma_a, in base colour (authors' code; paper: 1.6e-2)", TRAINING
    )
    sigma_position: float = _setting(
        0.3 / 3.0,
        "semantic kernel: sigma_x, in edges of the cube around the room (authors' code; paper: 1e-2)",
        TRAINING,
    )
    hash_levels: int = _setting(32, "hash grid: levels; those finer than half a pixel are left out", TRAINING)
    hash_features: int = _setting(2, "hash grid: features per level", TRAINING)
    hash_log2_size: int = _setting(19, "hash grid: log2 of the entries per level", TRAINING)
    hash_base_resolution: int = _setting(16, "hash grid: cells along an axis at the coarsest level", TRAINING)
    hash_growth: float = _setting(
        1.3, "hash grid: factor of resolution between levels (authors' code)", TRAINING
    )
    brdf_width: int = _setting(64, "BRDF network: width of the hidden layers", TRAINING)
    brdf_depth: int = _setting(2, "BRDF network: number of hidden layers", TRAINING)
    checkpoint_steps: int = _setting(500, "stage 2: steps between checkpoints of a training", None)

    shrink_detail: bool = _switch("keep detail of a part's base color as far as it is reliable", None)
    lamp_doubt: bool = _switch("count errors of the light of uncertain lamps in the confidence", None)
    environment_width: int = _setting(256, "width of the estimated environment map in pixels", SHADINGS)

    texel_density: float = _setting(128.0, "texels per metre of the textures", None)
    texture_size: int = _setting(2048, "largest width and height of one texture image in texels", None)
    detail: bool = _setting(
        True,
        "give base colour in the textures the photographs' detail, where they have more pixels than light was"
        " solved at (not in the paper)",
        None,
    )
    atlas_images: str = _setting(
        "room", "room: parts share the texture images; object or part: images of their own", None
    )
    kept_versions: int = _setting(
        5, "number of earlier estimates without a name that the run keeps when a new one is finished", None
    )
    atlas_mode: str = _setting("uv", "uv, or color_attribute for meshes that can't have UVs", None)
    clean_mesh: bool = _setting(
        True,
        "give the room the cleaned copy of a scan with the results; false keeps the scan's vertices",
        None,
    )
    write_back: str = _setting(
        "cycles", "cycles: add nodes with which Cycles shows the fitted BRDF; paper: add none", None
    )


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
    *("seed", "kept_versions", "rounds", "lambda_diffuse", "lambda_emission", "lambda_part"),
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
