# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The job that makes a capture from photographs; its folder is the capture's, not the scene's run folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..bridge.sequence import Job
from ..bridge.step import Step
from ..core.run.runfolder import RunFolder
from ..prepare.preparation import PreparationFolder, refuse_foreign
from .run_job import open_job

_TEXT = "Preparing the photographs"


def make_prepare_job(
    photographs: Path, folder: PreparationFolder, settings: Mapping[str, object], steps: str = ""
) -> Job:
    """A job that runs the engine's command `prepare`.

    The engine keeps the steps that are finished, so that a stopped job goes on when it is started again.

    Args:
        photographs: folder of the photographs.
        folder: of the capture; created if it does not exist.
        settings: values by name, for prepare.json.
        steps: names separated by commas; all of them if empty.

    Raises:
        FiptError: ``capture-foreign``, ``engine-missing`` or those of `open_job`.
    """
    run = RunFolder(folder.root)
    options = [f"--steps={steps}", *(f"--set={name}={value}" for name, value in settings.items())]
    command = ["prepare", *options, "--", str(photographs), str(folder.root)]
    step = Step("prepare", _TEXT, 60.0, command=command)
    refuse_foreign(folder, photographs)
    return open_job(run, [step])
