# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Changing a run's versions while no engine is at work in it. Imports no bpy."""

from __future__ import annotations

from ..bridge.step import StepRecord
from ..core.run.runfolder import RunFolder
from ..core.run.versions import delete_version, use_version
from .run_job import STEPS_NAME, refuse_busy


def switch_version(run: RunFolder, version: str) -> None:
    """Make a version the run's results; the main job, when it is resumed, estimates what it is told.

    Raises:
        FiptError: ``version-missing``, ``run-busy``, ``run-linked``, ``disk-full`` or ``run-unwritable``.
    """
    refuse_busy(run)
    use_version(run, version)
    StepRecord(run.root / STEPS_NAME).store("estimate", f"version {version}", finished=False)


def remove_version(run: RunFolder, version: str) -> None:
    """Delete an earlier version.

    Raises:
        FiptError: as `switch_version`; ``version-current`` for the present results.
    """
    refuse_busy(run)
    delete_version(run, version)
