"""What the JSON documents of a run's results hold, as `kinds` reads them. Standard library only.

docs/architecture.md describes who writes and reads them. Names of files are relative to the run folder, or
absolute.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

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
    """A photograph by which a result was judged: its view, and the files in results/quality."""

    name: str
    photograph: FileName
    render: FileName
    projection: FileName
    errors: tuple[Vector, Vector]  # mean squared, of render and projection, in each channel

    def decibels(self) -> tuple[float, ...]:
        """PSNR of render and projection."""
        return tuple(-10.0 * math.log10(max(sum(error) / 3.0, 1e-10)) for error in self.errors)


@dataclass(frozen=True)
class QualityNote:
    """quality.json: figures of `core.checks.quality.Quality`."""

    held_back_db: float
    projection_db: float
    on_mesh_db: float | None = None
    projection_on_mesh_db: float | None = None
    on_mesh_share: Share = 1.0
    views: tuple[JudgedPictures, ...] = ()
    exposures: Mapping[str, float] = field(default_factory=dict)

    def worst_first(self) -> list[JudgedPictures]:
        """What was judged, by the render's error."""
        return sorted(self.views, key=JudgedPictures.decibels)

    def worst(self) -> list[FileName]:
        """The pictures of what was rendered worst."""
        return [each for it in self.worst_first()[:1] for each in (it.photograph, it.render, it.projection)]


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
class Render:
    """A render of a view, and its file."""

    kind: str
    view: str
    image: str


@dataclass(frozen=True)
class Renders:
    """renders.json, in the order of the renders."""

    renders: tuple[Render, ...]
