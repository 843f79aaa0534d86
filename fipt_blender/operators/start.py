# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Start: choose what to work on, of whatever kind it is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import bpy

from ..panels import manual
from .action import REGISTER, action
from .polls import needs, over_sidebar

CAMERA_FILES = (".json", ".xml", ".sfm", ".out", ".nvm", ".csv", ".bin")


class FIPT_OT_choose_capture(bpy.types.Operator):
    """Choose a folder: photographs, a capture with cameras, or the data of a scan. It is read at once"""

    bl_idname = "fipt.choose_capture"
    bl_label = "Choose Folder"
    bl_options = {"REGISTER", "INTERNAL"}

    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    files: bpy.props.CollectionProperty(
        type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(bpy.ops.fipt.import_capture.poll())

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.directory:  # dropped files
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = Path(bpy.path.abspath(self.directory))
        cameras = [file.name for file in self.files if file.name.lower().endswith(CAMERA_FILES)]
        # Of a photograph, or of any other file in it, the folder is meant.
        path = folder / cameras[0] if len(cameras) == 1 else folder
        return set(bpy.ops.fipt.import_capture("INVOKE_DEFAULT", filepath=str(path)))


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
)
def help(
    scene: bpy.types.Scene, chapter: Annotated[str, "The chapter; the guide's first page if empty"] = ""
) -> None:
    """Open the guide's chapter on this section in the web browser."""
    bpy.ops.wm.url_open(url=manual.address() + manual.chapter_page(chapter))
