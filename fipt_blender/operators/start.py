"""Operators of the section Start: choose what to work on, of whatever kind it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import bpy

from ..api import importing
from ..core.run.declared import Option
from ..jobs.tasks import Task
from ..panels import manual
from .action import HIDDEN, REGISTER, ChoosesFiles, action
from .capture import import_capture
from .polls import has_no_capture, in_object_mode, needs, no_job, over_sidebar

CAMERA_FILES = (".json", ".xml", ".sfm", ".out", ".nvm", ".csv", ".bin")


@action(
    "Choose Folder",
    needs=(in_object_mode, no_job),
    options=REGISTER,
    bases=(ChoosesFiles,),
)
def choose_capture(scene: bpy.types.Scene, folder: str, names: Sequence[str]) -> Task:
    """Choose a folder: photographs, a capture with cameras, or the data of a scan. It is read at once."""
    cameras = [name for name in names if name.lower().endswith(CAMERA_FILES)]
    # Of a photograph, or of any other file in it, the folder is meant.
    path = Path(bpy.path.abspath(folder)) / (cameras[0] if len(cameras) == 1 else "")
    return import_capture(scene, filepath=str(path))


@action("Open Run", needs=(in_object_mode, no_job, has_no_capture), options=REGISTER, listed=False)
def open_run(
    scene: bpy.types.Scene, folder: Annotated[str, Option("The run's folder", shown=HIDDEN)] = ""
) -> Task:
    """Go on with a run that no saved file knows, as after a crash. Resume or Apply Results does the rest."""
    return importing.run_opening(Path(folder))


class FIPT_FH_capture(bpy.types.FileHandler):
    """A camera file dropped on the sidebar"""

    bl_idname = "FIPT_FH_capture"
    bl_label = "Cameras of a Room"
    bl_import_operator = "fipt.choose_capture"
    bl_file_extensions = ";".join(CAMERA_FILES)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return over_sidebar(context)


@action(
    "Open Guide",
    needs=(
        needs(
            lambda context: manual.address(),
            "The guide is part of the extension's zip. Install it, or read docs/guide",
        ),
    ),
    options=REGISTER,
    listed=False,
)
def help(scene: bpy.types.Scene) -> None:
    """Open the guide in the web browser."""
    bpy.ops.wm.url_open(url=manual.address() + manual.chapter_page(""))
