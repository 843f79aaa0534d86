"""What the JSON documents of a run folder hold, as `kinds` reads them. Standard library only.

docs/architecture.md describes who writes and reads them. Names of files are relative to the run folder, or
absolute.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from .errors import FiptError, Problem
from .kinds import Count, Matrix, NotNegative, Number, Pixels, Vector, choice
from .shapes import FARTHEST, FARTHEST_UNITS, UP_AXES, UP_SOURCES


@dataclass(frozen=True)
class RunNote:
    """run.json: settings, and the version of the add-on that has written them."""

    document: ClassVar[str] = "run"
    product_version: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class CapturedView:
    """A photograph with its camera in capture.json; see `capture.views.View`.

    `split` may be ``"unused"``; `preview` is a smaller copy of the photograph; `panorama` is the name of the
    photograph out of which the view is cut.
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
    panorama: str | None = None


@dataclass(frozen=True)
class UpAxis:
    """Which axis of the source is up, what tells so, and by how many degrees it is off."""

    axis: Annotated[str, choice(*UP_AXES)]
    source: Annotated[str, choice(*UP_SOURCES)]
    angle: NotNegative


@dataclass(frozen=True)
class PoseErrors:
    """Mean reprojection errors of the given poses and of those that are used, in pixels of photographs of 960
    pixels; equal where the given ones are used."""

    before: float
    after: float
    photographs: int


@dataclass(frozen=True)
class CapturedViews:
    """capture.json, and ingest.json with all views, `up` and `poses`.

    `world_from_source` is the similarity for anything in source coordinates, `mesh` included; these are the
    camera file's without `offset`, by which far ones were moved to the origin.
    """

    document: ClassVar[str] = "capture"
    source: str
    world_from_source: Annotated[Matrix, Number(-FARTHEST_UNITS, FARTHEST_UNITS)]
    mesh: str | None
    views: tuple[CapturedView, ...]
    up: UpAxis | None = None
    poses: PoseErrors | None = None
    offset: Vector = (0.0, 0.0, 0.0)

    def view(self, name: str) -> CapturedView:
        """The view of a name.

        Raises:
            FiptError: ``view-missing``.
        """
        for view in self.views:
            if view.name == name:
                return view
        raise FiptError("view-missing.view", name=name)


@dataclass(frozen=True, kw_only=True)
class RoomNames:
    """room.json: the names that the indices in room.npz stand for.

    Attributes:
        object_ids: by which the objects are found when they have other names.
        matrices: of each object to the world when it was exported; not of those of the engine.
        parts: source of the part labels, one of `jobs.options.PARTS`.
        completed: the artist has completed the scan, the engine adds nothing.
    """

    objects: tuple[str, ...]
    materials: tuple[str, ...]
    object_ids: tuple[str, ...] = ()
    matrices: tuple[Matrix, ...] = ()
    parts: str = "masks"
    completed: bool = False


@dataclass(frozen=True)
class JobNote:
    """job.json: of the last job that estimates, seconds by the names of its finished steps, and warnings."""

    seconds: Mapping[str, NotNegative]
    warnings: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class SurveyedView:
    """What the survey found of a view; `warning` is "" without one, `misfit` as in `checks.misfit`."""

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
    """align.json: a similarity that places the cameras on the mesh, and how well it fits."""

    similarity: Matrix
    text: str
