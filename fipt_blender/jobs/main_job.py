# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job: from a capture to a .blend with estimated materials and lights, renders and a report.

The command line runs it, in Blender or in a Python with bpy. bpy is imported only by steps on Blender's data.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..bridge.sequence import Job
from ..bridge.step import Step, StepFunction
from ..core.run.errors import FiptError
from ..core.run.hints import Hint, read_hints, write_hints
from ..core.run.runfolder import PRODUCT_VERSION, RunFolder
from .expected import PICTURE, render_seconds
from .fingerprints import folder_fingerprint, mesh_fingerprint
from .options import BLEND_NAME, MOST_RERENDERED, MainJobOptions, check_options
from .run_job import STEPS_NAME, find_launch, ingest_step, open_job, refuse_busy
from .scene_steps import room_steps

if TYPE_CHECKING:
    import bpy

    from .room_steps import RoomSteps

_RENDER_TEXTS = {
    "rerender": "Rendering held-back views with the estimated room",
    "relight": "Rendering the view with the estimated lights off and a new area light",
    "insert": "Rendering the view with an inserted object",
}
_PICTURES = {"rerender": MOST_RERENDERED}


def make_main_job(options: MainJobOptions) -> Job:
    """Check the options, create the run folder and return the job, ready to run.

    Raises:
        FiptError: ``capture-missing``, ``mesh-missing``, ``output-inside-capture``,
            ``engine-missing``, ``hints-missing``, ``hints-invalid``, ``run-busy`` or those of
            ``RunFolder.create``.
    """
    check_options(options)
    engine = find_launch(options.engine_python)
    run = RunFolder(options.output)
    refuse_busy(run)
    hints, hints_rerun = (_existing(path) for path in (options.hints, options.hints_again))
    run.create(options.settings)
    _take_hints(run, hints, hints_rerun, options.resume)
    job = open_job(run, _steps(options, run), STEPS_NAME, options.resume, lambda: list_files(run), engine)
    job.around = _with_panel
    return job


def _with_panel() -> AbstractContextManager[None]:
    from .room_steps import panel_state

    return panel_state()


def _scene() -> bpy.types.Scene:
    import bpy

    return bpy.context.scene


def list_files(run: RunFolder) -> list[str]:
    """Absolute paths of the results, the most important first."""
    paths = [run.root / BLEND_NAME, run.report / "index.html"]
    paths += sorted(run.renders.glob("*/*.exr")) + sorted(run.textures.glob("*.exr"))
    paths += sorted(run.textures.glob("*.png"))
    paths += [run.fields_npz, run.emitters_json, run.environment_exr, run.statistics_json, run.log]
    return [str(path) for path in paths if path.exists()]


def _remove(*paths: Path) -> None:
    for path in paths:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _existing(path: Path | None) -> list[Hint] | None:
    """The hints of a file that the user names; None without one.

    Raises:
        FiptError: ``hints-missing``; those of `read_hints`.
    """
    if path is None:
        return None
    if not path.is_file():
        raise FiptError("hints-missing", f"{path} does not exist.", "Name an existing file of hints.")
    return read_hints(path)


def _take_hints(
    run: RunFolder, hints: list[Hint] | None, hints_rerun: list[Hint] | None, resume: bool
) -> None:
    """Write the hints into the run folder; a run that is not resumed has no others, a resumed one its own."""
    if hints is not None or not resume:
        run.hints_again_json.unlink(missing_ok=True)
        run.hints_json.unlink(missing_ok=True)
    for path, given in ((run.hints_json, hints), (run.hints_again_json, hints_rerun)):
        if given is not None:
            write_hints(path, given)


def _steps(options: MainJobOptions, run: RunFolder) -> list[Step]:
    @cache
    def room() -> RoomSteps:
        from .room_steps import RoomSteps

        return RoomSteps(options, run)

    return [
        _capture_step(options, run),
        Step(
            "import",
            "Importing the room and its cameras",
            1.0,
            inputs={"parts": options.parts},
            function=lambda: room().import_room(),
            repeat=True,
        ),
        *room_steps(_scene, run, options.settings, options.resume, options.cluster),
        Step(
            "save",
            "Saving the .blend file",
            1.0,
            function=lambda: room().save(),
            outputs=[run.root / BLEND_NAME],
            reset=lambda: _remove(run.root / BLEND_NAME, run.renders),
            restore=lambda: room().open_blend(),
        ),
        *_render_steps(options, run, room),
        Step(
            "report",
            "Writing the report",
            3.0,
            command=["report", str(run.root)],
            outputs=[run.report / "index.html"],
            reset=lambda: _remove(run.report),
        ),
    ]


def _capture_step(options: MainJobOptions, run: RunFolder) -> Step:
    capture = options.capture.absolute()
    files = options.mesh, options.images, options.panorama
    mesh, images, panorama = (None if path is None else path.absolute() for path in files)
    return replace(
        ingest_step(run, capture, options, "Reading the capture", 2.0),
        inputs={
            "version": PRODUCT_VERSION,
            "capture": folder_fingerprint(capture, exclude=run.root),
            "mesh": None if mesh is None else mesh_fingerprint(mesh, exclude=run.root),
            "images": None if images is None else folder_fingerprint(images, exclude=run.root),
            "panorama": None if panorama is None else folder_fingerprint(panorama, exclude=run.root),
            "arguments": options.arguments(),
        },
        outputs=[run.capture_json],
    )


def _render_steps(options: MainJobOptions, run: RunFolder, room: Callable[[], RoomSteps]) -> list[Step]:
    functions: dict[str, StepFunction] = {
        "rerender": lambda: room().rerender(),
        "relight": lambda: room().relight(),
        "insert": lambda: room().insert(),
    }
    return [
        Step(
            f"render-{kind}",
            _RENDER_TEXTS[kind],
            PICTURE * _PICTURES.get(kind, 1),
            inputs={"spp": options.render_spp, "view": options.render_view},
            function=functions[kind],
            outputs=[run.renders_json],
            reset=(lambda: _remove(run.renders)) if kind == options.renders[0] else None,
            expected=partial(render_seconds, run, _PICTURES.get(kind, 1), options.render_spp),
        )
        for kind in options.renders
    ]
