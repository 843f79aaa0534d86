"""The options of the main job."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from ..core.capture.options import PART_SOURCES, CaptureOptions
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..core.run.settings import Settings

BLEND_NAME = "room.blend"
MOST_RERENDERED = 3  # held-back views that are rendered
# Kinds of renders: what is told meanwhile, and the number of pictures.
RENDERS = {
    "rerender": ("Rendering held-back views with the estimated room", MOST_RERENDERED),
    "relight": ("Rendering the view with the estimated lights off and a new area light", 1),
    "insert": ("Rendering the view with an inserted object", 1),
}


@dataclass(frozen=True, kw_only=True)
class MainJobOptions(CaptureOptions):
    """What the user chooses for one run of the main job, besides how the capture is read.

    Attributes:
        capture: folder or camera file of the capture.
        output: the run folder, created if it does not exist.
        settings: constants of the method.
        renders: whether RENDERS are made in Cycles.
    """

    capture: Path
    output: Path
    settings: Settings = field(default_factory=Settings)
    renders: bool = True
    parts: Annotated[
        str,
        Option(
            "How surfaces of the same material are recognized",
            choices=tuple(each for each in PART_SOURCES if each[0] != "folder"),
        ),
    ] = "auto"
    hints: Annotated[
        Path | None,
        "What is known of surfaces (hints.json), for the whole estimation; without it none or, with --resume,"
        " those of the run",
    ] = None
    hints_again: Annotated[
        Path | None, "With --resume: estimate materials again with these hints; the computed light is kept"
    ] = None
    render_view: Annotated[str, "Name of the view to render; a held-back one if empty"] = ""
    render_spp: Annotated[int, "Cycles samples per pixel"] = 64
    resume: Annotated[bool, "Keep finished steps of an earlier run in the same folder"] = False
    cluster: Annotated[
        str | None,
        "Address of a Dask scheduler whose workers share the work on the views; the results are the same",
    ] = None
    engine_python: Annotated[str | None, "Python interpreter with the engine's packages"] = None


def capture_source(path: Path) -> Path:
    """The folder of a model's file: of all files, only transforms.json is a capture by itself."""
    return path.parent if path.is_file() and path.suffix.lower() != ".json" else path


def check_options(options: MainJobOptions) -> None:
    """Check the paths before anything is written."""
    if not options.capture.exists():
        raise FiptError("capture-missing.check-options", capture=options.capture)
    options.refuse_missing()
    if options.output.exists() and not options.output.is_dir():
        raise FiptError("run-foreign.check-options", output=options.output)
    if options.output.resolve() == options.capture.resolve():
        raise FiptError("output-inside-capture", output=options.output)
