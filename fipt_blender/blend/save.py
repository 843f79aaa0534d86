# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Saving the result's .blend so that it and its textures can be moved together."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.job.errors import FiptError
from ..core.job.runfolder import explained_write_errors


def save_blend(path: Path) -> None:
    """Save the open file under a path, whole or not at all (Blender renames a finished file).

    Paths of images become relative to it where that is possible.

    Raises:
        FiptError: ``disk-full``, ``run-unwritable`` or ``blend-unwritable``.
    """
    path = Path(path).absolute()
    with explained_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        # The first save gives the file the name to which the paths then become relative.
        bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
        bpy.ops.file.make_paths_relative()
        bpy.ops.wm.save_mainfile()
    except RuntimeError as error:
        raise FiptError(
            "blend-unwritable",
            f"{path} could not be saved ({str(error).strip()}).",
            "Free some space, or choose a folder that you may write to.",
        ) from None
