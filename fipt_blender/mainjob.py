# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job: a capture in; a .blend with estimated materials and lights, renders and a report out.

The same `Job` runs behind the command line, background Blender and the buttons. bpy is imported only when a
step on Blender's data runs.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from .bridge.process import Message
from .bridge.sequence import Job
from .bridge.step import Step
from .core.job.errors import FiptError
from .core.job.runfolder import PRODUCT_VERSION, RunFolder
from .core.job.settings import Settings
from .runjob import find_launch, open_job, refuse_busy

if TYPE_CHECKING:
    from .blend.steps import RoomSteps

BLEND_NAME = "room.blend"
PARTS = ("auto", "masks", "semantics", "materials", "objects", "loose", "none")
RENDER_KINDS = ("rerender", "relight", "insert")
TEXTURE_SETTINGS = ("texel_density", "texture_size", "atlas_mode", "write_back")
EXPORT_TEXT = "Preparing the room for the engine"
_RENDER_TEXTS = {
    "rerender": "Rendering held-back views with the estimated room",
    "relight": "Rendering the view with the estimated lights off and a new area light",
    "insert": "Rendering the view with an inserted object",
}
# Seconds on a small capture with two CPU cores; they only shape the progress bar.
_ESTIMATE_SECONDS = {"draft": 120.0, "medium": 360.0, "high": 2400.0}


@dataclass(frozen=True)
class MainJobOptions:
    """What the user chooses for one run of the main job.

    Attributes:
        capture: folder or camera file of the capture.
        output: the run folder, made when it does not exist.
        mesh: the room's mesh file, or None for the one found beside the cameras.
        settings: constants of the method.
        format: reader of the capture, "auto" to recognise it.
        up_axis: up axis of the source's coordinates, "auto" for the reader's own.
        scale: metres per source unit.
        hold_back: every how-manieth view is held back where the capture names none; 0 for none, None for
            the engine's default.
        images: folder to look for the photographs in first.
        clamp_negative: whether negative radiance is taken as zero.
        undo_applied_transform: transforms.json only: see `ingest`.
        parts: where material parts come from; one of PARTS.
        renders: which Cycles renders to make; of RENDER_KINDS.
        render_view: name of the view to render; "" chooses a held-back one.
        render_spp: Cycles' samples a pixel.
        resume: whether finished steps of an earlier run are kept.
        engine_python: interpreter of the engine, or None for the one found.
        cluster: address of a Dask scheduler whose workers share the work on the views; None for this machine
            alone. The results are the same.
        own_file: whether the job may replace the open .blend (background); otherwise it adds to it.
    """

    capture: Path
    output: Path
    mesh: Path | None = None
    settings: Settings = field(default_factory=Settings)
    format: str = "auto"
    up_axis: str = "auto"
    scale: float = 1.0
    hold_back: int | None = None
    images: Path | None = None
    clamp_negative: bool = False
    undo_applied_transform: bool = False
    parts: str = "auto"
    renders: tuple[str, ...] = RENDER_KINDS
    render_view: str = ""
    render_spp: int = 64
    resume: bool = False
    engine_python: str | None = None
    cluster: str | None = None
    own_file: bool = True


def make_main_job(options: MainJobOptions) -> Job:
    """Check what can be checked at once, make the run folder and return the job, ready to run.

    Raises:
        FiptError: ``capture-missing``, ``mesh-missing``, ``output-inside-capture``, ``engine-missing``,
            ``run-busy`` or those of ``RunFolder.create``.
    """
    check_options(options)
    engine = find_launch(options.engine_python)
    run = RunFolder(options.output)
    refuse_busy(run)
    run.create(options.settings)
    return open_job(
        run,
        _steps(options, run),
        resume=options.resume,
        result=lambda: list_files(run),
        launch=engine,
    )


def check_options(options: MainJobOptions) -> None:
    """Find out what is wrong with the paths before anything is written.

    Raises:
        FiptError: see ``make_main_job``.
    """
    if not options.capture.exists():
        raise FiptError(
            "capture-missing",
            f"The capture {options.capture} does not exist.",
            "Name the capture's folder or its camera file.",
        )
    if options.mesh is not None and not options.mesh.is_file():
        raise FiptError(
            "mesh-missing", f"The mesh file {options.mesh} does not exist.", "Name the room's mesh file."
        )
    if options.output.exists() and not options.output.is_dir():
        raise FiptError(
            "run-foreign", f"{options.output} is a file.", "Choose a new or empty folder for the output."
        )
    if options.output.resolve() == options.capture.resolve():
        raise FiptError(
            "output-inside-capture",
            f"The output folder {options.output} is the capture itself.",
            "Choose a new or empty folder for the output.",
        )
    if not set(options.renders) <= set(RENDER_KINDS):
        raise FiptError(
            "render-unknown",
            f"There is no render of kind {', '.join(sorted(set(options.renders) - set(RENDER_KINDS)))}.",
            f"Use some of: {', '.join(RENDER_KINDS)}.",
        )


def fingerprint(path: Path, exclude: Path | None = None) -> str:
    """A short hash of the names, sizes and times of a file or of all files below a folder.

    Args:
        path: file or folder; for a file, its folder counts as well (a camera file names images beside it).
        exclude: folder that is left out, because the job itself writes there.
    """
    folder = path if path.is_dir() else path.parent
    found = []
    for parent, folders, names in os.walk(folder):
        here = Path(parent)
        folders[:] = sorted(name for name in folders if exclude is None or (here / name) != exclude)
        for name in names:
            file = here / name
            try:
                status = file.stat()
            except OSError:  # a dangling link: its target may come and go
                continue
            found.append(f"{file.relative_to(folder)}|{status.st_size}|{status.st_mtime_ns}")
    return hashlib.sha256("\n".join([str(path), *sorted(found)]).encode()).hexdigest()[:24]


def list_files(run: RunFolder) -> list[str]:
    """Absolute paths of what the user asked for, in the order in which he will want to open it."""
    wanted = [run.root / BLEND_NAME, run.report / "index.html"]
    wanted += sorted(run.renders.glob("*/*.exr")) + sorted(run.textures.glob("*.exr"))
    wanted += sorted(run.textures.glob("*.png"))
    wanted += [run.fields_npz, run.emitters_json, run.environment_exr, run.statistics_json, run.log]
    return [str(path) for path in wanted if path.exists()]


def _remove(*paths: Path) -> None:
    for path in paths:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _empty(*folders: Path) -> None:
    _remove(*folders)
    for folder in folders:
        folder.mkdir()


def _ingest_arguments(options: MainJobOptions) -> list[str]:
    # One word each, because "-y" alone would be taken for an option.
    arguments = [f"--format={options.format}", f"--up-axis={options.up_axis}", f"--scale={options.scale!r}"]
    if options.mesh is not None:
        arguments.append(f"--mesh={options.mesh.absolute()}")
    if options.hold_back is not None:
        arguments.append(f"--hold-back={options.hold_back}")
    if options.images is not None:
        arguments.append(f"--images={options.images.absolute()}")
    if options.clamp_negative:
        arguments.append("--clamp-negative")
    if options.undo_applied_transform:
        arguments.append("--undo-applied-transform")
    return arguments


def estimate_step(
    run: RunFolder, settings: Settings, resume: bool = False, cluster: str | None = None
) -> Step:
    """The engine's estimation on the capture.json and the room.npz of a run folder.

    Args:
        resume: whether stages that other settings leave as they are may be kept; the engine knows which.
        cluster: see `MainJobOptions`; no input, as results do not depend on it.
    """
    values = {name: value for name, value in asdict(settings).items() if name not in TEXTURE_SETTINGS}
    return Step(
        "estimate",
        "Estimating materials and lights",
        _ESTIMATE_SECONDS.get(settings.preset, 360.0),
        inputs=values,
        command=["estimate", str(run.root), *([] if cluster is None else [f"--cluster={cluster}"])],
        outputs=[run.fields_npz, run.emitters_json],
        reset=lambda: _empty(*([] if resume else [run.stage]), run.results),
    )


def _steps(options: MainJobOptions, run: RunFolder) -> list[Step]:
    @functools.cache
    def room() -> RoomSteps:
        from .blend.steps import RoomSteps

        return RoomSteps(options, run)

    texture_values = {name: getattr(options.settings, name) for name in TEXTURE_SETTINGS}
    renders: dict[str, Callable[[], list[Message] | None]] = {
        "rerender": lambda: room().rerender(),
        "relight": lambda: room().relight(),
        "insert": lambda: room().insert(),
    }
    capture, ingest = options.capture.absolute(), _ingest_arguments(options)
    mesh = None if options.mesh is None else fingerprint(options.mesh.absolute(), exclude=run.root)
    steps = [
        Step(
            "ingest",
            "Reading the capture",
            5.0,
            inputs={
                "version": PRODUCT_VERSION,
                "capture": fingerprint(capture, exclude=run.root),
                "mesh": mesh,
                "arguments": ingest,
            },
            command=["ingest", str(capture), str(run.root), *ingest],
            outputs=[run.capture_json],
            reset=lambda: _remove(run.capture_json, run.images),
        ),
        Step(
            "import",
            "Importing the room and its cameras",
            5.0,
            function=lambda: room().import_room(),
            repeat=True,
        ),
        Step(
            "export",
            EXPORT_TEXT,
            2.0,
            inputs={"parts": options.parts},
            function=lambda: room().export_room(),
            outputs=[run.room_npz, run.room_json],
            reset=lambda: _remove(run.room_npz, run.room_json),
        ),
        estimate_step(run, options.settings, options.resume, options.cluster),
        Step(
            "atlas",
            "Laying out texture coordinates",
            5.0,
            inputs=texture_values,
            function=lambda: room().make_atlas(),
            outputs=[run.atlas_npz, run.atlas_json],
            repeat=True,
        ),
        Step(
            "textures",
            "Baking textures",
            20.0,
            command=["textures", str(run.root)],
            outputs=[run.textures],
            reset=lambda: _remove(run.textures),
        ),
        Step(
            "save",
            "Building materials and lights, saving the .blend",
            5.0,
            function=lambda: room().apply_and_save(),
            outputs=[run.root / BLEND_NAME],
            reset=lambda: _remove(run.root / BLEND_NAME, run.renders),
            restore=(lambda: room().open_blend()) if options.own_file else None,
        ),
    ]
    for kind in options.renders:
        steps.append(
            Step(
                f"render-{kind}",
                _RENDER_TEXTS[kind],
                20.0,
                inputs={"spp": options.render_spp, "view": options.render_view},
                function=renders[kind],
                outputs=[run.renders_json],
                reset=(lambda: _remove(run.renders)) if kind == options.renders[0] else None,
            )
        )
    steps.append(
        Step(
            "report",
            "Writing the report",
            5.0,
            command=["report", str(run.root)],
            outputs=[run.report / "index.html"],
            reset=lambda: _remove(run.report),
        )
    )
    return steps
