"""Run folders that are ready for the engine's estimation: made from a capture, copied for several runs.

python benchmarks/prepared.py CAPTURE RUN [OPTION ...]: the steps of the main job before the estimation, in a
separate process because Mitsuba runs in the caller's. The options are those of `estimate`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.bridge.interpreter import engine_command, engine_environment
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import Settings


def prepare(capture: Path, root: Path, options: Sequence[str] = ()) -> RunFolder:
    """A new run folder with a capture's views and mesh; an existing run is deleted.

    Args:
        capture: folder of the capture.
        root: of the run folder.
        options: of the command line's `estimate`, e.g. --parts and --mesh.

    Raises:
        FiptError: ``run-foreign`` if the folder contains something else, ``run-failed`` if a step fails.
    """
    run = RunFolder(root)
    clear(run)
    command = [sys.executable, str(Path(__file__).resolve()), str(capture), str(run.root), *options]
    if subprocess.run(command, stdout=sys.stderr, check=False).returncode:
        raise FiptError.of("run-failed", f"{capture} could not be prepared.", "See the error above.")
    return run


def clear(run: RunFolder) -> None:
    """Delete a run folder of any version.

    Raises:
        FiptError: ``run-foreign`` if the folder contains something else.
    """
    if run.root.exists():
        if not run.run_json.exists() and any(run.root.iterdir()):
            raise FiptError.of("run-foreign", f"{run.root} is not a run folder.", "Choose another folder.")
        shutil.rmtree(run.root)


def copy_input(source: RunFolder, target: RunFolder, settings: Settings) -> None:
    """Copy a run's input to another run folder, which gets new settings; its finished stages are kept."""
    target.create(settings)
    for path in (source.room_npz, source.room_json, source.capture_json):
        shutil.copyfile(path, target.root / path.name)
    if source.images.exists():
        shutil.copytree(source.images, target.images, dirs_exist_ok=True)


def main(argv: Sequence[str]) -> int:
    """Ingest the capture, import it into Blender and export the room; returns 0, or 1 after an error."""
    from fipt_blender import cli
    from fipt_blender.jobs.options import check_options

    arguments = cli.make_parser().parse_args(["estimate", argv[0], "--output", argv[1], *argv[2:]])
    try:
        options = cli.make_options(arguments)
        check_options(options)
        run = RunFolder(options.output)
        run.create(options.settings)
        ingest = ["ingest", str(options.capture.absolute()), str(run.root)]
        if options.mesh is not None:
            ingest.append(f"--mesh={options.mesh.absolute()}")
        python = Path(sys.executable)
        with open(run.log, "ab") as log:
            command = engine_command(python, *ingest)
            result = subprocess.run(
                command, stdout=log, stderr=log, env=engine_environment(python), check=False
            )
        if result.returncode:
            raise FiptError.of("run-failed", "The capture could not be read.", f"See {run.log}.")
        from fipt_blender.jobs.room_steps import RoomSteps, panel_state  # bpy
        from fipt_blender.jobs.scene_steps import export_scene_room

        with panel_state():
            for _ in (*RoomSteps(options, run).import_room(), *export_scene_room(run)):
                pass
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
