"""What each stage of an estimation can be told: one dataclass each, with all that the stage reads.

A stage is done again when one of its own settings changes, and no other. Help texts compare the defaults with
the paper (main text or supplementary) and with the authors' released code. `settings.Settings` holds all of
them. Standard library only: both processes import it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeVar

from .declared import Option

Kind = TypeVar("Kind")

ATLAS_MODES = (  # identifier, label, tooltip, icon
    ("uv", "Image Textures", "Images on a separate UV map", "IMAGE_DATA"),
    (
        "color_attribute",
        "Color Attributes",
        "Values at the face corners of the mesh, for dense scans that can't be unwrapped",
        "GROUP_VCOL",
    ),
)
ATLAS_IMAGES = (
    ("room", "Shared", "As few images as the room needs, which its parts share", "IMAGE_DATA"),
    (
        "object",
        "One per Object",
        "Images and UVs of its own for each object, to hand objects on. A part that lies on several"
        " objects"
        " has a material for each; its sliders are one",
        "OBJECT_DATA",
    ),
    (
        "part",
        "One per Part",
        "Images and UVs of its own for each part, as large as it needs, to hand materials on",
        "MATERIAL",
    ),
)
WRITE_BACKS = (
    (
        "cycles",
        "For Cycles",
        "Use a node group that makes Cycles match the reflection model of the estimation",
    ),
    # What a room without the node group loses: docs/results.md "Materials to hand on".
    (
        "paper",
        "Plain Principled",
        "Use the Principled BSDF alone, which is easier to hand on. Renders of the example room are 2.2 dB"
        " farther from the photographs, most of all at grazing angles",
    ),
)


def chosen(settings: Any, kind: type[Kind]) -> Kind:
    """The settings of one stage, by the names of its fields, out of all."""
    return kind(**{item.name: getattr(settings, item.name) for item in fields(kind)})  # type: ignore[arg-type]


@dataclass(frozen=True)
class Seeded:
    """The seed of the random numbers."""

    seed: Annotated[
        int, Option("seed of all random numbers: the same seed gives the same result", zero=True)
    ] = 0


@dataclass(frozen=True)
class Voxels(Seeded):
    """The radiance cache."""

    voxel_resolution: Annotated[
        int,
        Option(
            "cells of the radiance cache along the room's longest side: use more for large rooms",
            "Light Resolution",
            low=8,
            shown={"soft_max": 1024},
        ),
    ] = 256


@dataclass(frozen=True)
class Levels:
    """The roughness levels of the shadings, and the BRDF that they integrate."""

    masking: Annotated[
        str,
        Option(
            "G of the BRDF: schlick as in the authors' code, smith as in Cycles",
            choices=(("schlick",), ("smith",)),
        ),
    ] = "schlick"
    roughness_levels: Annotated[
        int,
        Option(
            "number of roughness levels of computed reflections (paper: 6)",
            "Gloss Levels",
            low=3,
            shown={"soft_max": 32},
        ),
    ] = 8
    roughness_spacing: Annotated[
        float, "exponent of the spacing of the roughness levels (paper: 1, linear)"
    ] = 1.5
    roughness_min: Annotated[
        float, "lowest roughness level, as in the authors' code (paper: 0, where GGX is singular)"
    ] = 0.02


@dataclass(frozen=True)
class Denoising:
    """What is denoised."""

    denoise: Annotated[
        bool,
        "denoise the computed light, so that fewer samples are needed: diffuse shading, by Open Image"
        " Denoise (paper: OptiX denoiser)",
    ] = True
    denoise_specular: Annotated[
        bool, "denoise the brightness of the specular shadings too (paper: their channels)"
    ] = True


@dataclass(frozen=True)
class ViewSettings:
    """Which photographs are used, and at which size."""

    view_share: Annotated[
        float, Option("share of the training views that is used, spread evenly", high=1)
    ] = 1.0
    light_pixels: Annotated[
        float,
        Option(
            "millions of pixels of all photographs together at which light is solved. Larger photographs"
            " are averaged: more pixels are slower and show smaller surfaces and shadows (not in the"
            " paper)",
            shown={"min": 0.01, "max": 1000.0, "precision": 2},
        ),
    ] = 4.0


@dataclass(frozen=True)
class ScanSettings:
    """What is done to a scan alone."""

    clean_scan: Annotated[
        bool, "work on a cleaned copy of a scanned mesh; exact meshes stay as they are (not in the paper)"
    ] = True
    close_holes_edges: Annotated[
        int,
        Option(
            "close holes of a scanned mesh that have at most so many edges, 0 for none; flat ones of over 100"
            " squared edges may be windows and are closed where photographs say so (not in the paper)",
            zero=True,
            high=1000,
        ),
    ] = 120


@dataclass(frozen=True)
class CompletionSettings:
    """What is looked for that a scan lacks."""

    panes: Annotated[
        bool, "close flat holes of a scan in which photographs show a surface (not in the paper)"
    ] = True
    lost_surfaces: Annotated[
        bool, "add things that photographs show and a scan lacks, as prisms (not in the paper)"
    ] = True
    torn_parts: Annotated[bool, "complete parts that a scan tore (not in the paper)"] = True


@dataclass(frozen=True)
class OutlineSettings:
    """The outlines of a scan's parts."""

    outlines: Annotated[
        bool, "move the outlines of a scan's parts to those of the masks (not in the paper)"
    ] = True


@dataclass(frozen=True)
class Forced:
    """Whether input that looks useless is used."""

    force: Annotated[
        bool,
        "estimate although mesh, poses or photographs look useless, or the disk too small (not in the paper)",
    ] = False


@dataclass(frozen=True)
class CheckSettings(Seeded, Forced):
    """The check of the views."""

    reject_views: Annotated[
        bool, "leave out photographs that do not agree with their camera poses (not in the paper)"
    ] = True
    correct_exposure: Annotated[
        bool, "correct photographs whose exposure differs from that of the others (not in the paper)"
    ] = True


@dataclass(frozen=True)
class PhotometrySettings(Voxels):
    """Radiance of photographs that are not HDR."""

    clipped_lamps: Annotated[
        bool,
        "find the radiance of clipped lamps by the light that they cast, where photographs are not"
        " HDR (not in the paper)",
    ] = True


@dataclass(frozen=True)
class UnmixSettings:
    """Mixed pixels."""

    unmix: Annotated[
        bool, "use mixed pixels by their share of each surface's radiance (not in the paper)"
    ] = True


@dataclass(frozen=True)
class LightSettings(Voxels):
    """The radiance cache and the environment."""

    environment_width: Annotated[int, Option("width of the estimated environment map in pixels", low=4)] = 256
    unseen_light: Annotated[
        bool, "infer the light that enters an open mesh from unseen directions (not in the paper)"
    ] = True


@dataclass(frozen=True)
class ShadingSettings(Seeded, Levels, Denoising):
    """Stage 1."""

    diffuse_spp: Annotated[
        int,
        Option(
            "rays per pixel for diffuse light: fewer rays are faster and noisier (stage 1: cosine"
            " samples; paper: 128; authors' code: 256)",
            "Diffuse Samples",
        ),
    ] = 16
    specular_spp: Annotated[
        int,
        Option(
            "rays per pixel and roughness level for reflections: fewer rays are faster and noisier (stage"
            " 1: visible-normal samples; paper: 64; authors' code: 64 for the first level, 128 for each"
            " other)",
            "Glossy Samples",
        ),
    ] = 4
    light_spp: Annotated[
        int,
        Option(
            "rays per pixel toward lamps: more rays reduce noise in shadows (stage 1: aimed at bright"
            " triangles; not in the paper)",
            "Light Samples",
        ),
    ] = 8
    presumed_lamps: Annotated[
        bool,
        "stage 1: give bright surfaces of constant radiance that of their fixture, not of the cache"
        " (not in the paper)",
    ] = True


@dataclass(frozen=True)
class RefitSettings(LightSettings, ShadingSettings, UnmixSettings):
    """Radiance of photographs that are not HDR, again with baked light."""

    refit_photographs: Annotated[
        bool, "adjust photographs that are not HDR once more with baked light (not in the paper)"
    ] = True


@dataclass(frozen=True)
class ReflectionSettings(Seeded):
    """What stage 3 needs of an estimate."""

    cache_roughness: Annotated[
        float, "stage 3: paths end in the radiance cache at surfaces rougher than this"
    ] = 0.6


@dataclass(frozen=True)
class RefinementSettings(ReflectionSettings, Levels, Denoising):
    """Stage 3."""

    refine_diffuse_spp: Annotated[int, "stage 3: cosine samples per pixel (paper: 128)"] = 32
    refine_specular_spp: Annotated[
        int, "stage 3: visible-normal samples per pixel and roughness level (paper: 64)"
    ] = 8
    refine_light_spp: Annotated[
        int, "stage 3: samples per pixel aimed at emitters (paper: part of its samples, by MIS)"
    ] = 16
    refine_depth: Annotated[
        int, "stage 3: largest number of surfaces on a path before it ends in the cache (authors' code)"
    ] = 5
    refine_cache: Annotated[
        bool, "stage 3: end paths in the radiance cache; false traces them with the estimate alone (ablation)"
    ] = True


@dataclass(frozen=True)
class MaterialSettings(Seeded, Levels):
    """The closed-form estimate."""

    residual_degrees: Annotated[
        float,
        "closed form of roughness and metallic: degrees of freedom of the residuals' t-distribution; fewer"
        " ignore more outliers (this and the next three are not in the paper)",
    ] = 3.0
    pixels_per_sample: Annotated[
        float, "closed form: number of neighbouring pixels that share their errors and count as one"
    ] = 10.0
    view_error: Annotated[
        float,
        "closed form: standard deviation of the error that a view's shadings share, relative to radiance",
    ] = 5e-3
    view_outliers: Annotated[
        float,
        Option("closed form: share of the views whose shadings tell nothing about a part's gloss", high=1),
    ] = 0.1
    prior_weight: Annotated[
        float, "closed form: weight of a prior over materials, as a number of parts that follow it"
    ] = 1.0


@dataclass(frozen=True)
class NetworkSettings(Seeded, Levels):
    """The BRDF network."""

    hash_levels: Annotated[int, "hash grid: levels; those finer than half a pixel are left out"] = 32
    hash_features: Annotated[int, "hash grid: features per level"] = 2
    hash_log2_size: Annotated[int, "hash grid: log2 of the entries per level"] = 19
    hash_base_resolution: Annotated[int, "hash grid: cells along an axis at the coarsest level"] = 16
    hash_growth: Annotated[float, "hash grid: factor of resolution between levels (authors' code)"] = 1.3
    brdf_width: Annotated[int, "BRDF network: width of the hidden layers"] = 64
    brdf_depth: Annotated[int, Option("BRDF network: number of hidden layers", zero=True)] = 2


@dataclass(frozen=True)
class TrainingSettings(NetworkSettings):
    """Stage 2."""

    training_steps: Annotated[
        int,
        "steps of the training: more steps give sharper textures (stage 2, after the last closed-form"
        " estimate; paper: 2 epochs in each round)",
    ] = 300
    batch_size: Annotated[int, "stage 2: pixels per step"] = 8192
    learning_rate: Annotated[
        float, "stage 2: initial learning rate of Adam, which falls to a tenth (paper: 1e-3)"
    ] = 3e-3
    hash_learning_rate: Annotated[
        float,
        "stage 2: initial learning rate of the hash grid, of which few pixels reach each entry (paper: 1e-3)",
    ] = 1e-2
    lambda_emission: Annotated[
        float, Option("weight of l_e, the L1 norm of the emission mask", zero=True)
    ] = 1.0
    lambda_diffuse: Annotated[
        float, Option("weight of l_d, the preference for diffuse surfaces", zero=True)
    ] = 5e-4
    lambda_part: Annotated[
        float,
        Option(
            "weight of l_p with part masks, towards the closed form (paper: 5e-3, to the mean of a batch)",
            zero=True,
        ),
    ] = 5e-2
    lambda_semantic: Annotated[float, Option("weight of l_p with semantic masks", zero=True)] = 1e-3
    sigma_albedo: Annotated[
        float, "semantic kernel: sigma_a, in base colour (authors' code; paper: 1.6e-2)"
    ] = 0.05 / 3.0
    sigma_position: Annotated[
        float, "semantic kernel: sigma_x, in edges of the cube around the room (authors' code; paper: 1e-2)"
    ] = 0.3 / 3.0
    checkpoint_steps: Annotated[
        int, Option("stage 2: steps between checkpoints of a training", keyed=False)
    ] = 500


@dataclass(frozen=True)
class ResultSettings(Seeded):
    """What is written of an estimate."""

    shrink_detail: Annotated[
        bool, "keep detail of a part's base color as far as it is reliable (not in the paper)"
    ] = True
    lamp_doubt: Annotated[
        bool, "count errors of the light of uncertain lamps in the confidence (not in the paper)"
    ] = True


@dataclass(frozen=True)
class TextureSettings:
    """Apply Results; no stage of an estimation reads these."""

    texel_density: Annotated[
        float,
        Option(
            "resolution of the textures in texels per meter. Photographs rarely show more than 500",
            shown={"min": 1.0, "soft_min": 16.0, "soft_max": 1024.0, "precision": 0},
        ),
    ] = 128.0
    texture_size: Annotated[int, "largest width and height of an image. A room uses up to 16 images"] = 2048
    detail: Annotated[
        bool,
        "give base colour in the textures the photographs' detail, where they have more pixels than"
        " light was"
        " solved at (not in the paper)",
    ] = True
    atlas_images: Annotated[str, Option("which surfaces share an image", "Images", choices=ATLAS_IMAGES)] = (
        "room"
    )
    atlas_mode: Annotated[
        str, Option("where the estimated values are stored", "Store In", choices=ATLAS_MODES)
    ] = "uv"
    clean_mesh: Annotated[
        bool,
        Option(
            "give a scanned room the geometry on which the estimation has worked: walls are planar and"
            " the scan's bumps are gone. Your own mesh is set aside; Revert restores it. Modelled rooms"
            " stay as they are",
            "Clean Scan",
        ),
    ] = True
    write_back: Annotated[
        str, Option("shader that renders the estimated textures", "Surface", choices=WRITE_BACKS)
    ] = "cycles"
