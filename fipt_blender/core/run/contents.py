# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the JSON documents of a run folder hold, as `kinds` reads them. Standard library only.

docs/architecture.md describes who writes and reads them. Names of files are relative to the run folder, or
absolute.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from .errors import FiptError
from .kinds import Choice, Count, FileName, Key, Matrix, NotNegative, Number, Row, Share, Vector
from .shapes import FARTHEST, FARTHEST_UNITS, MOST_SIDE, UP_AXES, UP_SOURCES

Pixels = Annotated[int, Number(1, MOST_SIDE)]


@dataclass(frozen=True)
class RunNote:
    """run.json: settings, and the version of the add-on that has written them."""

    document: ClassVar[str] = "run"
    product_version: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class CapturedView:
    """A photograph with its camera, in capture.json.

    Attributes:
        name: unique in the capture, e.g. ``"train/000"``.
        split: ``"train"``, ``"held_back"`` or ``"unused"``.
        image: file of scene-linear radiance.
        width, height: pixels.
        fx, fy, cx, cy: pinhole intrinsics in pixels; the centre of the first pixel is (0.5, 0.5).
        camera_to_world: OpenCV axes, Blender world in metres.
        parts, semantics, mask: files of ids, see `capture.views.View`.
        preview: a smaller copy of the photograph.
        encoded: whether the image holds a camera's codes instead of radiance.
        exposure: of such a photograph, relative; None where the file does not say.
    """

    name: str
    split: str
    image: str
    width: Pixels
    height: Pixels
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_world: Annotated[Matrix, Number(-FARTHEST, FARTHEST)]
    parts: str | None
    semantics: str | None
    mask: str | None = None
    preview: str | None = None
    encoded: bool = False
    exposure: Annotated[float, Number(1e-12, 1e12)] | None = None


@dataclass(frozen=True)
class UpAxis:
    """Which axis of the source is up, what tells so, and by how many degrees it is off."""

    axis: Annotated[str, Choice(*UP_AXES)]
    source: Annotated[str, Choice(*UP_SOURCES)]
    angle: NotNegative


@dataclass(frozen=True)
class CapturedViews:
    """capture.json, and ingest.json with all views.

    Attributes:
        source: the format it was read from.
        world_from_source: similarity for anything in source coordinates, the mesh included.
        mesh: mesh file in source coordinates, None where none was found.
        views: all that the artist selects.
        up: of ingest.json; None in runs of earlier versions.
    """

    document: ClassVar[str] = "capture"
    source: str
    world_from_source: Annotated[Matrix, Number(-FARTHEST_UNITS, FARTHEST_UNITS)]
    mesh: str | None
    views: tuple[CapturedView, ...]
    up: UpAxis | None = None

    def view(self, name: str) -> CapturedView:
        """The view of a name.

        Raises:
            FiptError: ``view-missing``.
        """
        for view in self.views:
            if view.name == name:
                return view
        raise FiptError(
            "view-missing", f"The capture of this run has no view '{name}'.", "Choose one of its views."
        )


@dataclass(frozen=True)
class RoomNames:
    """room.json: the names that the indices in room.npz stand for.

    Attributes:
        objects, materials: names.
        object_ids: by which the objects are found when they have other names; those without are the names.
        matrices: of each object to the world when it was exported; empty in runs of earlier versions.
        parts: source of the part labels, one of `jobs.options.PARTS`.
        completed: the artist has completed the scan, the engine adds nothing.
    """

    objects: tuple[str, ...]
    materials: tuple[str, ...]
    object_ids: tuple[str, ...] = ()
    matrices: tuple[Matrix, ...] = ()
    parts: str = "masks"
    completed: bool = False

    @property
    def ids(self) -> tuple[str, ...]:
        """One id for each object."""
        return self.object_ids or self.objects


@dataclass(frozen=True)
class Problem:
    """What a step has warned of."""

    code: str
    text: str
    remedy: str


@dataclass(frozen=True)
class StepNote:
    """What steps.json keeps of a step of a sequence: its key, whether it has finished, time, warnings."""

    key: str
    finished: bool
    seconds: NotNegative = 0.0
    warnings: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class Steps:
    """steps.json, or apply.json: the steps by their names."""

    version: int
    steps: Mapping[str, StepNote]


@dataclass(frozen=True)
class VersionNote:
    """version.json: the name that the user gave to results, and the seconds since 1970 of their end."""

    document: ClassVar[str] = "version"
    name: str
    time: NotNegative


@dataclass(frozen=True)
class EmitterFixture:
    """A fixture in emitters.json; radiance of its front and back in the photographs' units.

    Attributes:
        triangles: of room.npz.
        area: square metres.
        centroid: world.
        power: watts of both sides.
        probability: that it emits.
    """

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

    image: Annotated[str, Choice("environment.exr")]
    observed_share: Share | None = None


@dataclass(frozen=True)
class MissingLamp:
    """A lamp that the mesh lacks: a ball in world metres."""

    position: Vector
    radius: NotNegative
    radiance: Vector


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
        name: for the user; unique.
        single: whether it is of one material.
        class_name: of its semantic class, None or "" where unknown.
        triangles, pixels: how many it has, and how many of the photographs' pixels saw it.
        area: square metres.
        base_color, roughness, metallic: means over what was seen; None where nothing was.
        confidence: of these three, 0 to 1.
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
    """A question about a part, and where to see it.

    Attributes:
        name: of the part.
        text: the question.
        question: what is asked.
        point: on the part, world metres.
        pixels: how many show the part.
        share: of the room's pixels that depend on the answer.
        roughness, metallic: of the estimate, and their standard errors.
        view: that shows it best, in the file `picture`; `box` is its place there, in pixels.
    """

    name: str
    question: Annotated[str, Choice("metal", "gloss", "lamp")]
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
    picture: Annotated[str, FileName()]


@dataclass(frozen=True)
class Doubts:
    """doubts.json: the questions, the most doubtful part first."""

    document: ClassVar[str] = "doubts"
    doubts: tuple[Doubt, ...]


@dataclass(frozen=True)
class StageFigures:
    """Time and rays of a stage."""

    name: str = ""
    seconds: float | None = None
    rays: float | None = None


@dataclass(frozen=True)
class Stages:
    """stages.json: the key of each stage of an estimation, and figures and warnings of the finished ones."""

    keys: Mapping[str, str]
    stages: Mapping[str, StageFigures]
    warnings: Mapping[str, tuple[Problem, ...]]


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

    Attributes:
        median_shown: value between black and white at which they show their median radiance.
        log_curve: (256,) logarithm of the radiance of each code.
    """

    median_shown: float | None = None
    log_curve: tuple[float, ...] = ()


@dataclass(frozen=True)
class Statistics:
    """statistics.json as far as it is read; the figures that only the report shows are None where missing.

    Attributes:
        stages: of the estimation.
        peak_memory_gb: of the engine, 1e9 bytes.
        radiance_scale: the photographs' median radiance, 0 where it is not recorded.
        hints: those that were honoured.
    """

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


@dataclass(frozen=True)
class AtlasImage:
    """An image of the textures; pixels."""

    name: Annotated[str, FileName()]
    width: Pixels
    height: Pixels


@dataclass(frozen=True)
class AtlasImages:
    """atlas.json: colour attributes need no images; `apart`: objects or parts have images of their own."""

    mode: Annotated[str, Choice("uv", "color_attribute")]
    images: tuple[AtlasImage, ...]
    apart: bool = False


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


@dataclass(frozen=True)
class SurveyedView:
    """What the survey found of a view.

    Attributes:
        warning: "" without one.
        room_share: of its pixels that see the room.
        clipped_share: of its pixels that are clipped.
        misfit: see `checks.misfit`; None where it is not known.
    """

    name: str
    warning: str
    image_missing: bool
    room_share: float
    clipped_share: float
    misfit: NotNegative | None = None


@dataclass(frozen=True)
class SurveyedParts:
    """The source of parts that the engine would choose, and the number of parts of each source."""

    auto: str
    counts: Mapping[str, Count]


Matrices = dict[str, Matrix]  # matrices.json: of the objects of a survey to the world, by name


@dataclass(frozen=True)
class Box:
    """A box along the axes, world metres."""

    low: Vector
    high: Vector


@dataclass(frozen=True)
class SurveyNote:
    """survey.json; `missing` is where surfaces are that the mesh lacks."""

    views: tuple[SurveyedView, ...]
    parts: SurveyedParts
    missing: tuple[Box, ...]


@dataclass(frozen=True)
class Placement:
    """A similarity that places the cameras on the mesh, its error, and the share of the points that fit."""

    similarity: Matrix
    error: NotNegative
    inliers: Share


@dataclass(frozen=True)
class Placements:
    """align.json: the placements, the best one first, and the poses of views that were aligned one by one."""

    candidates: tuple[Placement, ...]
    text: str
    poses: Mapping[str, Matrix]
