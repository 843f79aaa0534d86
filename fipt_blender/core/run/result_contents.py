# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the JSON documents of a run's results hold, as `kinds` reads them. Standard library only.

docs/architecture.md describes who writes and reads them. Names of files are relative to the run folder, or
absolute.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from .contents import Problem
from .kinds import Count, FileName, Key, NotNegative, Number, Pixels, Row, Share, Vector, choice


@dataclass(frozen=True)
class EmitterFixture:
    """A fixture in emitters.json: radiance in the photographs' units, metres, watts of both sides."""

    name: str
    triangles: tuple[Count, ...]
    radiance: Vector
    back_radiance: Vector
    area: NotNegative = 0.0
    centroid: Vector | None = None
    power: Vector | None = None
    probability: NotNegative = 1.0


@dataclass(frozen=True)
class EmitterEnvironment:
    """The file of the light from outside, and the share of all directions that photographs show of it."""

    image: Annotated[str, choice("environment.exr")]
    observed_share: Share | None = None


@dataclass(frozen=True)
class MissingLamp:
    """A lamp that the mesh lacks, in world metres: a ball, or a disc facing the side to which it shines (unit
    vector); inferred: no photograph shows it; share: of the light on the surfaces, of inferred ones."""

    position: Vector
    radius: NotNegative
    radiance: Vector
    inferred: bool = False
    facing: Vector | None = None
    share: Share = 0.0


@dataclass(frozen=True)
class Emitters:
    """emitters.json: all light of an estimate."""

    fixtures: tuple[EmitterFixture, ...]
    environment: EmitterEnvironment | None
    missing: tuple[MissingLamp, ...] = ()


@dataclass(frozen=True)
class RoomPart:
    """A part of the room: a unit of the estimate, or what no unit holds of an object.

    Attributes:
        unit: index of the unit, `parts.NO_UNIT` for the rest of an object.
        key: names the part in other estimates of the room, too, as far as the source of the parts allows.
        single: whether it is of one material.
        class_name: of its semantic class, None or "" where unknown.
        pixels: of the photographs that saw it.
        area: square metres.
        base_color, roughness, metallic: means over what was seen, with their `confidence`; None without.
    """

    unit: Annotated[int, Key("id"), Number(0)]
    key: str
    name: str
    class_name: Annotated[str | None, Key("class")] = None
    single: bool = False
    triangles: Count = 0
    pixels: Count = 0
    area: NotNegative = 0.0
    base_color: Vector | None = None
    roughness: Share | None = None
    metallic: Share | None = None
    confidence: Vector | None = None


@dataclass(frozen=True)
class PartList:
    """parts.json: the units of parts.npz; `source` is one of `core.parts.labels.choose_parts`."""

    document: ClassVar[str] = "parts"
    source: str
    parts: tuple[RoomPart, ...]


@dataclass(frozen=True)
class Doubt:
    """A question about the part `name`: `share` of the room's pixels depend on the answer.

    The part is best seen in `view`, of which `picture` is a file, within `box` there, in pixels.
    """

    name: str
    question: Annotated[str, choice("metal", "gloss", "lamp")]
    text: str
    point: Vector
    pixels: Count
    share: Share
    roughness: Share
    metallic: Share
    roughness_error: Share
    metallic_error: Share
    view: str
    box: Row
    picture: FileName


@dataclass(frozen=True)
class Doubts:
    """doubts.json: the questions, the most doubtful part first."""

    document: ClassVar[str] = "doubts"
    doubts: tuple[Doubt, ...]


@dataclass(frozen=True)
class JudgedPictures:
    """A photograph that was held back: mean squared errors of render and projection, and pictures of all."""

    name: str
    errors: tuple[Vector, ...]
    photograph: FileName
    render: FileName
    projection: FileName


@dataclass(frozen=True)
class QualityFigures:
    """quality.json: PSNR in dB of photographs that were held back, rendered and projected.

    Figures of the pixels that see the mesh are None where there are none.
    """

    held_back_db: float
    projection_db: float
    views: tuple[JudgedPictures, ...]
    on_mesh_db: float | None = None
    projection_on_mesh_db: float | None = None
    on_mesh_share: float | None = None


@dataclass(frozen=True)
class StageFigures:
    """Time and rays of a stage."""

    name: str = ""
    seconds: float | None = None
    rays: float | None = None


@dataclass(frozen=True)
class Stages:
    """stages.json: the key of each stage of an estimation, and facts and warnings of the finished ones.

    The files of the `dropped` ones are gone, as a later stage has replaced them.
    """

    keys: Mapping[str, str]
    stages: Mapping[str, dict]
    warnings: Mapping[str, tuple[Problem, ...]]
    dropped: tuple[str, ...] = ()


@dataclass(frozen=True)
class HintFigures:
    """What became of a hint: its triangles, and the values that it has decided; None for others."""

    name: str
    triangles: Count
    roughness: Share | None
    metallic: Share | None
    emits: bool | None
    left_alone: bool


@dataclass(frozen=True)
class PhotometryFigures:
    """What was found of photographs that are not HDR, as far as it is used later.

    They show their median radiance at `median_shown` between black and white; `log_curve` (256,) is the
    logarithm of the radiance of each code.
    """

    median_shown: float | None = None
    log_curve: tuple[float, ...] = ()


@dataclass(frozen=True)
class Statistics:
    """statistics.json as far as it is read; `radiance_scale` is the photographs' median radiance."""

    stages: tuple[StageFigures, ...] = ()
    peak_memory_gb: float | None = None
    pixels: int | None = None
    light_resolution: str | None = None
    expected: str | None = None
    triangles: int | None = None
    fixtures: int | None = None
    part_kind: str | None = None
    radiance_scale: float = 0.0
    variant: str | None = None
    closed_holes: int | None = None
    closed_holes_m2: float | None = None
    open_holes: int | None = None
    open_holes_m2: float | None = None
    hints: tuple[HintFigures, ...] = ()
    photometry: PhotometryFigures | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class AtlasImage:
    """An image of the textures; pixels."""

    name: FileName
    width: Pixels
    height: Pixels


@dataclass(frozen=True)
class AtlasImages:
    """atlas.json; colour attributes need no images."""

    mode: Annotated[str, choice("uv", "color_attribute")]
    images: tuple[AtlasImage, ...]


@dataclass(frozen=True)
class TextureImage:
    """The files of an image's maps."""

    name: str
    base_color: str
    roughness: str
    metallic: str
    confidence: str


@dataclass(frozen=True)
class UniformPart:
    """The key of a part that needs no textures, and its values."""

    part: str
    base_color: Vector
    roughness: Share
    metallic: Share


@dataclass(frozen=True)
class Textures:
    """textures.json."""

    images: tuple[TextureImage, ...]
    uniform: tuple[UniformPart, ...] = ()


@dataclass(frozen=True)
class ViewMaps:
    """The files of a view's maps."""

    view: str
    base_color: str
    roughness: str
    metallic: str
    emission: str
    confidence: str = ""


@dataclass(frozen=True)
class Maps:
    """maps.json."""

    views: tuple[ViewMaps, ...]


@dataclass(frozen=True)
class Render:
    """A render of a view, and its file."""

    kind: str
    view: str
    image: str


@dataclass(frozen=True)
class Renders:
    """renders.json, in the order of the renders."""

    renders: tuple[Render, ...]
