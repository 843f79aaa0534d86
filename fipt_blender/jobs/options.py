# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of the main job."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..core.capture.options import CaptureOptions
from ..core.run.errors import FiptError
from ..core.run.settings import Settings

BLEND_NAME = "room.blend"
PARTS = ("auto", "masks", "semantics", "materials", "objects", "loose", "none")
RENDER_KINDS = ("rerender", "relight", "insert")
MOST_RERENDERED = 3  # held-back views that are rendered


@dataclass(frozen=True, kw_only=True)
class MainJobOptions(CaptureOptions):
    """What the user chooses for one run of the main job, besides how the capture is read.

    Attributes:
        capture: folder or camera file of the capture.
        output: the run folder, created if it does not exist.
        settings: constants of the method.
        parts: source of the material parts; one of PARTS.
        renders: Cycles renders to make; of RENDER_KINDS.
        render_view: name of the view to render; "" chooses a held-back one.
        render_spp: Cycles samples per pixel.
        resume: whether finished steps of an earlier run are kept.
        engine_python: the engine's interpreter, or None to find it.
        cluster: address of a Dask scheduler whose workers share the work on the views; None for this machine
            alone. The results are the same.
        hints: file of what is known of surfaces (hints.json), for the whole estimation; None: none or, with
            `resume`, those of the run.
        hints_again: the same for an estimate again, from the stages of a finished run.
    """

    capture: Path
    output: Path
    settings: Settings = field(default_factory=Settings)
    parts: str = "auto"
    renders: tuple[str, ...] = RENDER_KINDS
    render_view: str = ""
    render_spp: int = 64
    resume: bool = False
    engine_python: str | None = None
    cluster: str | None = None
    hints: Path | None = None
    hints_again: Path | None = None


def capture_source(path: Path) -> Path:
    """The folder of a model's file: of all files, only transforms.json is a capture by itself."""
    return path.parent if path.is_file() and path.suffix.lower() != ".json" else path


def check_options(options: MainJobOptions) -> None:
    """Check the paths before anything is written.

    Raises:
        FiptError: see ``make_main_job``.
    """
    if not options.capture.exists():
        raise FiptError(
            "capture-missing",
            f"The capture {options.capture} does not exist.",
            "Give the capture's folder or its camera file.",
        )
    if options.mesh is not None and not options.mesh.is_file():
        raise FiptError(
            "mesh-missing",
            f"The mesh file {options.mesh} does not exist.",
            "Give the room's mesh file (--mesh).",
        )
    if options.output.exists() and not options.output.is_dir():
        raise FiptError(
            "run-foreign",
            f"{options.output} is a file.",
            "Choose a new or empty folder for the output (--output).",
        )
    if options.output.resolve() == options.capture.resolve():
        raise FiptError(
            "output-inside-capture",
            f"The output folder {options.output} is the capture itself.",
            "Choose a new or empty folder for the output (--output).",
        )
    if not set(options.renders) <= set(RENDER_KINDS):
        raise FiptError(
            "render-unknown",
            f"There is no render of kind {', '.join(sorted(set(options.renders) - set(RENDER_KINDS)))}.",
            f"Choose from: {', '.join(RENDER_KINDS)}.",
        )
