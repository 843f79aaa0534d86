"""The main job: from a capture to a .blend with estimated materials and lights, renders and a report.

The command line runs it, in Blender or in a Python with bpy. bpy is imported only by steps on Blender's data.
"""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

from ..bridge.job import Job
from ..bridge.step import Step
from ..core.run.errors import FiptError
from ..core.run.hints import Hint, read_hints, write_hints
from ..core.run.runfolder import RunFolder
from .expected import PICTURE, render_seconds
from .options import BLEND_NAME, RENDERS, MainJobOptions, check_options
from .run_job import find_launch, open_job, refuse_busy
from .scene_steps import apply_steps, estimation_steps, import_steps


def make_main_job(options: MainJobOptions) -> Job:
    """Check the options, create the run folder and return the job, ready to run."""
    check_options(options)
    engine = find_launch(options.engine_python)
    run = RunFolder(options.output)
    refuse_busy(run)
    hints, hints_rerun = (_existing(path) for path in (options.hints, options.hints_again))
    run.create(options.settings)
    _take_hints(run, hints, hints_rerun, options.resume)
    if not options.resume:
        shutil.rmtree(run.made("").parent, ignore_errors=True)
    job = open_job(run, _steps(options, run), engine, note=True)
    job.result = lambda: (list_files(run), {"run": str(run.root)})
    return job


def list_files(run: RunFolder) -> list[str]:
    """Absolute paths of the results, the most important first."""
    paths = [run.root / BLEND_NAME, run.report / "index.html"]
    paths += sorted(run.renders.glob("*/*.exr")) + sorted(run.textures.glob("*.exr"))
    paths += sorted(run.textures.glob("*.png"))
    paths += [run.fields_npz, run.emitters_json, run.environment_exr, run.statistics_json, run.log]
    return [str(path) for path in paths if path.exists()]


def _existing(path: Path | None) -> list[Hint] | None:
    """The hints of a file that the user names; None without one."""
    if path is None:
        return None
    if not path.is_file():
        raise FiptError("hints-missing", path=path)
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
    from .room_steps import RoomSteps

    room, settings = RoomSteps(options, run), options.settings
    return [
        *import_steps(run, options.capture.absolute(), options, room.import_room),
        *estimation_steps(run, settings, options.resume, options.cluster),
        *apply_steps(run, settings),
        Step("save", "Saving the .blend file", 1.0, function=room.save),
        *(
            Step(
                f"render-{kind}",
                text,
                PICTURE * count,
                function=partial(room.render, kind),
                expected=partial(render_seconds, run, count, options.render_spp),
            )
            for kind, (text, count) in (RENDERS if options.renders else {}).items()
        ),
        Step("report", "Writing the report", 3.0, command=["report", str(run.root)]),
    ]
