"""What the steps of `prepare` have found out (stage/STEP.json), as the report and the panel read it.

Standard library only: Blender's side imports it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..core.run.contents import Problem
from ..core.run.documents import read_document
from ..core.run.kinds import Count, Matrix, NotNegative, Share, T
from .preparation import PreparationFolder


@dataclass(frozen=True)
class FinishedStep:
    """What stage/STEP.json says of every step, beside its facts: key, time and warnings."""

    key: str
    messages: tuple[Problem, ...]
    seconds: NotNegative = 0.0


@dataclass(frozen=True)
class LeftOut:
    """A file that is not used or a view without a pose, why, and what to do about it."""

    name: str
    reason: str
    remedy: str = ""


@dataclass(frozen=True)
class ReadFacts:
    """Of the step `read`: the files that can't be used, and how many others and groups there are."""

    skipped: tuple[LeftOut, ...] = ()
    photographs: Count = 0
    groups: Count = 0


@dataclass(frozen=True)
class MergedImage:
    """A merged group: shares of clipped and moved pixels, and paths of photographs that were left out."""

    name: str
    clipped_share: Share | None = None
    moved_share: Share | None = None
    shift_pixels: NotNegative | None = None
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResponseFacts:
    """The response of each channel, and the median standard deviation of its logarithm."""

    curves: tuple[tuple[float, ...], ...]
    uncertainty: NotNegative | None = None


@dataclass(frozen=True)
class MergeFacts:
    """Of the step `merge`; `scale` is the exposure by which radiance was divided."""

    images: tuple[MergedImage, ...] = ()
    scale: float = 1.0
    response: ResponseFacts | None = None


@dataclass(frozen=True)
class Registered:
    """A solved camera; the error in pixels."""

    name: str
    points: NotNegative | None = None
    reprojection_error: NotNegative | None = None


@dataclass(frozen=True)
class SolveFacts:
    """Of the step `solve`; `models` are the numbers of views of the unconnected sets."""

    registered: tuple[Registered, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    models: tuple[int, ...] = ()
    reprojection_error: NotNegative | None = None


@dataclass(frozen=True)
class LensFacts:
    """The vignetting of a lens: radiance in the corner relative to the middle, and what tells it."""

    lens: str
    applied: bool
    views: Count = 0
    source: str = ""
    corner: NotNegative | None = None
    corner_error: NotNegative | None = None
    noise: NotNegative | None = None


@dataclass(frozen=True)
class VignettingFacts:
    """Of the step `vignetting`."""

    lenses: tuple[LensFacts, ...] = ()


@dataclass(frozen=True)
class ScaleFacts:
    """Of the step `scale`; `difference` is the relative disagreement of a marker's edges."""

    source: str = ""
    meters_per_unit: NotNegative | None = None
    room_from_solve: Matrix | None = None
    difference: NotNegative | None = None


def read_facts(folder: PreparationFolder, step: str, kind: type[T]) -> T | None:
    """What a step has noted, of one of the kinds above; None if it has not run."""
    path: Path = folder.facts(step)
    return read_document(path, kind, f"Repeat the step '{step}'.") if path.exists() else None


def shutter_text(seconds: float | None) -> str:
    """A shutter time as cameras show it: "1/250 s", "0.5 s"; "?" if it is unknown."""
    if not seconds:
        return "?"
    # Cameras write shorter times as fractions.
    return f"{seconds:.3g} s" if seconds >= 0.4 else f"1/{1.0 / seconds:.0f} s"
