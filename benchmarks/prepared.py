# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run folders that are ready for the engine's estimation: made of a capture, copied for several runs.

python benchmarks/prepared.py CAPTURE RUN [OPTION ...]: the main job's steps before the estimation, in a
process of its own because Blender's module and Mitsuba don't share one here. The options are `estimate`'s.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.bridge.interpreter import engine_command, engine_environment
from fipt_blender.core.job.errors import FiptError
from fipt_blender.core.job.runfolder import RunFolder
from fipt_blender.core.job.settings import Settings


def prepare(capture: Path, root: Path, options: Sequence[str] = ()) -> RunFolder:
    """A new run folder with a capture's views and mesh; what was there is removed.

    Args:
        options: of the product's `estimate`: --parts, --mesh.

    Raises:
        FiptError: ``run-foreign`` where something else lies there, ``run-failed`` where a step fails.
    """
    run = RunFolder(root)
    clear(run)
    command = [sys.executable, str(Path(__file__).resolve()), str(capture), str(run.root), *options]
    if subprocess.run(command, stdout=sys.stderr, check=False).returncode:
        raise FiptError("run-failed", f"{capture} could not be prepared.", "Mend what is reported above.")
    return run


def clear(run: RunFolder) -> None:
    """Remove a run folder, of whatever version.

    Raises:
        FiptError: ``run-foreign`` where something else lies there.
    """
    if run.root.exists():
        if not run.run_json.exists() and any(run.root.iterdir()):
            raise FiptError("run-foreign", f"{run.root} is no run folder.", "Choose another folder.")
        shutil.rmtree(run.root)


def copy_input(source: RunFolder, target: RunFolder, settings: Settings) -> None:
    """Make `target` the same run with other settings; what it finished with the same input is kept."""
    target.create(settings)
    for path in (source.room_npz, source.room_json, source.capture_json):
        shutil.copyfile(path, target.root / path.name)
    if source.images.exists():
        shutil.copytree(source.images, target.images, dirs_exist_ok=True)


def main(argv: Sequence[str]) -> int:
    """Ingest, import and export; 0, or 1 for a failure."""
    from fipt_blender import cli
    from fipt_blender.mainjob import check_options

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
            ended = subprocess.run(
                command, stdout=log, stderr=log, env=engine_environment(python), check=False
            )
        if ended.returncode:
            raise FiptError("run-failed", "The capture could not be read.", f"{run.log} tells why.")
        from fipt_blender.blend.steps import RoomSteps  # bpy

        steps = RoomSteps(options, run)
        steps.import_room()
        for _ in steps.export_room():
            pass
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
