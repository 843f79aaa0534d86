# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What each stage of an estimation can be told: one dataclass each, with all that the stage reads.

A stage is done again when one of its own settings changes, and no other. Help texts compare the defaults with
the paper (main text or supplementary) and with the authors' released code. `settings.Settings` holds all of
them. Standard library only: both processes import it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

Kind = TypeVar("Kind")


def setting(default: Any, text: str, keyed: bool = True) -> Any:
    """A field with a help text; `keyed`: whether the results depend on it."""
    return field(default=default, metadata={"help": text, "keyed": keyed})


def switch(text: str) -> Any:
    """Of a mechanism that the paper does not have; benchmarks/trial.py measures what each one brings."""
    return setting(True, f"{text} (not in the paper)")


def chosen(settings: Any, kind: type[Kind]) -> Kind:
    """The settings of one stage, by the names of its fields, out of all."""
    return kind(**{item.name: getattr(settings, item.name) for item in fields(kind)})  # type: ignore[arg-type]


@dataclass(frozen=True)
class NoSettings:
    """Of stages that can't be told anything."""


@dataclass(frozen=True)
class Seeded:
    """The seed of the random numbers."""

    seed: int = setting(0, "seed of all random numbers of the run")


@dataclass(frozen=True)
class Voxels(Seeded):
    """The radiance cache."""

    voxel_resolution: int = setting(256, "radiance cache: voxels along each axis of the room's bounds")


@dataclass(frozen=True)
class Levels:
    """The roughness levels of the shadings, and the BRDF that they integrate."""

    masking: str = setting("schlick", "G of the BRDF: schlick as in the authors' code, smith as in Cycles")
    roughness_levels: int = setting(
        8, "number of roughness levels at which specular shading is baked (paper: 6)"
    )
    roughness_spacing: float = setting(
        1.5, "exponent of the spacing of the roughness levels (paper: 1, linear)"
    )
    roughness_min: float = setting(
        0.02, "lowest roughness level, as in the authors' code (paper: 0, where GGX is singular)"
    )


@dataclass(frozen=True)
class Denoising:
    """What is denoised."""

    denoise: bool = setting(True, "denoise diffuse shading with Open Image Denoise (paper: OptiX denoiser)")
    denoise_specular: bool = setting(
        True, "denoise the brightness of the specular shadings too (paper: their channels)"
    )


@dataclass(frozen=True)
class ViewSettings:
    """Which photographs are used, and at which size."""

    view_share: float = setting(1.0, "share of the training views that is used, spread evenly")
    light_pixels: float = setting(
        4.0,
        "millions of pixels of all views together at which light is solved; larger photographs are averaged"
        " (not in the paper)",
    )


@dataclass(frozen=True)
class RoomSettings:
    """What is done to a scan."""

    clean_scan: bool = setting(
        True, "work on a cleaned copy of a scanned mesh; exact meshes stay as they are (not in the paper)"
    )
    close_holes_edges: int = setting(
        120,
        "close holes of a scanned mesh that have at most so many edges, 0 for none; flat ones of over 100"
        " squared edges may be windows and are closed where photographs say so (not in the paper)",
    )
    panes: bool = switch("close flat holes of a scan in which photographs show a surface")
    lost_surfaces: bool = switch("add things that photographs show and a scan lacks, as prisms")
    torn_parts: bool = switch("complete parts that a scan tore")
    outlines: bool = switch("move the outlines of a scan's parts to those of the masks")


@dataclass(frozen=True)
class Forced:
    """Whether input that looks useless is used."""

    force: bool = setting(
        False, "estimate although input, mesh or poses look useless, or the disk too small (not in the paper)"
    )


@dataclass(frozen=True)
class CheckSettings(Seeded, Forced):
    """The check of the views."""

    reject_views: bool = setting(
        True, "leave out photographs that contradict their camera poses (not in the paper)"
    )
    correct_exposure: bool = setting(
        True, "correct photographs whose exposure differs from the others' (not in the paper)"
    )
    unmeshed_lamps: bool = switch("leave out pixels of lamps that the mesh lacks")


@dataclass(frozen=True)
class PhotometrySettings(Voxels):
    """Radiance of photographs that are not HDR."""

    clipped_lamps: bool = switch(
        "find the radiance of clipped lamps by the light that they cast, where photographs are not HDR"
    )


@dataclass(frozen=True)
class UnmixSettings:
    """Mixed pixels."""

    unmix: bool = switch("use mixed pixels by their share of each surface's radiance")


@dataclass(frozen=True)
class LightSettings(Voxels):
    """The radiance cache and the environment."""

    environment_width: int = setting(256, "width of the estimated environment map in pixels")
    unseen_light: bool = switch("infer the light that enters an open mesh from unseen directions")


@dataclass(frozen=True)
class ShadingSettings(Seeded, Levels, Denoising):
    """Stage 1."""

    diffuse_spp: int = setting(16, "stage 1: cosine samples per pixel (paper: 128; authors' code: 256)")
    specular_spp: int = setting(
        4,
        "stage 1: visible-normal samples per pixel and roughness level (paper: 64; authors' code: 64 for the"
        " first level, 128 for each other)",
    )
    light_spp: int = setting(8, "stage 1: samples per pixel aimed at bright triangles (not in the paper)")
    presumed_lamps: bool = switch(
        "stage 1: give bright surfaces of constant radiance that of their fixture, not of the cache"
    )


@dataclass(frozen=True)
class RefitSettings(LightSettings, ShadingSettings, UnmixSettings):
    """Radiance of photographs that are not HDR, again with baked light."""

    refit_photographs: bool = switch("adjust photographs that are not HDR once more with baked light")


@dataclass(frozen=True)
class ReflectionSettings(Seeded):
    """What stage 3 needs of an estimate."""

    cache_roughness: float = setting(
        0.6, "stage 3: paths end in the radiance cache at surfaces rougher than this"
    )


@dataclass(frozen=True)
class RefinementSettings(ReflectionSettings, Levels, Denoising):
    """Stage 3."""

    refine_diffuse_spp: int = setting(32, "stage 3: cosine samples per pixel (paper: 128)")
    refine_specular_spp: int = setting(
        8, "stage 3: visible-normal samples per pixel and roughness level (paper: 64)"
    )
    refine_light_spp: int = setting(
        16, "stage 3: samples per pixel aimed at emitters (paper: part of its samples, by MIS)"
    )
    refine_depth: int = setting(
        5, "stage 3: largest number of surfaces on a path before it ends in the cache (authors' code)"
    )
    refine_cache: bool = setting(
        True, "stage 3: end paths in the radiance cache; false traces them with the estimate alone (ablation)"
    )


@dataclass(frozen=True)
class MaterialSettings(Seeded, Levels):
    """The closed-form estimate."""

    residual_degrees: float = setting(
        3.0,
        "closed form of roughness and metallic: degrees of freedom of the residuals' t-distribution; fewer"
        " ignore more outliers (this and the next three are not in the paper)",
    )
    pixels_per_sample: float = setting(
        10.0, "closed form: number of neighbouring pixels that share their errors and count as one"
    )
    view_error: float = setting(
        5e-3,
        "closed form: standard deviation of the error that a view's shadings share, relative to radiance",
    )
    view_outliers: float = setting(
        0.1, "closed form: share of the views whose shadings tell nothing about a part's gloss"
    )
    prior_weight: float = setting(
        1.0, "closed form: weight of a prior over materials, as a number of parts that follow it"
    )


@dataclass(frozen=True)
class NetworkSettings(Seeded, Levels):
    """The BRDF network."""

    hash_levels: int = setting(32, "hash grid: levels; those finer than half a pixel are left out")
    hash_features: int = setting(2, "hash grid: features per level")
    hash_log2_size: int = setting(19, "hash grid: log2 of the entries per level")
    hash_base_resolution: int = setting(16, "hash grid: cells along an axis at the coarsest level")
    hash_growth: float = setting(1.3, "hash grid: factor of resolution between levels (authors' code)")
    brdf_width: int = setting(64, "BRDF network: width of the hidden layers")
    brdf_depth: int = setting(2, "BRDF network: number of hidden layers")


@dataclass(frozen=True)
class TrainingSettings(NetworkSettings):
    """Stage 2."""

    training_steps: int = setting(
        300, "stage 2: optimiser steps after the last closed-form estimate (paper: 2 epochs in each round)"
    )
    batch_size: int = setting(8192, "stage 2: pixels per step")
    learning_rate: float = setting(
        3e-3, "stage 2: initial learning rate of Adam, which falls to a tenth (paper: 1e-3)"
    )
    hash_learning_rate: float = setting(
        1e-2,
        "stage 2: initial learning rate of the hash grid, of which few pixels reach each entry (paper: 1e-3)",
    )
    lambda_emission: float = setting(1.0, "weight of l_e, the L1 norm of the emission mask")
    lambda_diffuse: float = setting(5e-4, "weight of l_d, the preference for diffuse surfaces")
    lambda_part: float = setting(
        5e-2,
        "weight of l_p with part masks, towards the closed form (paper: 5e-3, towards the mean of a batch)",
    )
    lambda_semantic: float = setting(1e-3, "weight of l_p with semantic masks")
    sigma_albedo: float = setting(
        0.05 / 3.0, "semantic kernel: sigma_a, in base colour (authors' code; paper: 1.6e-2)"
    )
    sigma_position: float = setting(
        0.3 / 3.0,
        "semantic kernel: sigma_x, in edges of the cube around the room (authors' code; paper: 1e-2)",
    )
    checkpoint_steps: int = setting(500, "stage 2: steps between checkpoints of a training", keyed=False)


@dataclass(frozen=True)
class ResultSettings(Seeded):
    """What is written of an estimate."""

    shrink_detail: bool = switch("keep detail of a part's base color as far as it is reliable")
    lamp_doubt: bool = switch("count errors of the light of uncertain lamps in the confidence")


@dataclass(frozen=True)
class TextureSettings:
    """Apply Results; no stage of an estimation reads these."""

    texel_density: float = setting(128.0, "texels per metre of the textures")
    texture_size: int = setting(2048, "largest width and height of one texture image in texels")
    detail: bool = setting(
        True,
        "give base colour in the textures the photographs' detail, where they have more pixels than light was"
        " solved at (not in the paper)",
    )
    atlas_images: str = setting(
        "room", "room: parts share the texture images; object or part: images of their own"
    )
    atlas_mode: str = setting("uv", "uv, or color_attribute for meshes that can't have UVs")
    clean_mesh: bool = setting(
        True, "give the room the cleaned copy of a scan with the results; false keeps the scan's vertices"
    )
    write_back: str = setting(
        "cycles", "cycles: add nodes with which Cycles shows the fitted BRDF; paper: add none"
    )
