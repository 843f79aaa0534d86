# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Insert that make pictures: the backdrop of inserted objects, and the render."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.runfolder import RunFolder
from ..properties.insert import BACKDROPS
from .check import RenderJob, current_view
from .polls import all_of, needs

if TYPE_CHECKING:
    from ..bridge.sequence import Job


class FIPT_OT_set_backdrop(bpy.types.Operator):
    """Select the backdrop of inserted objects: the rendered room, or the original photograph"""

    bl_idname = "fipt.set_backdrop"
    bl_label = "Set Backdrop"
    bl_options = {"REGISTER", "UNDO"}

    mode: bpy.props.EnumProperty(
        name="Backdrop", description="What is behind the inserted objects", items=BACKDROPS
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return next(text for name, _, text, *_ in BACKDROPS if name == properties.mode)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        from ..blend.outliner import ROOM, find_collection

        scene = context.scene
        if scene.fipt.capture.room is None and find_collection(scene, ROOM) is None:
            cls.poll_message_set("Import a capture or set the room first, in the section Capture")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture.backdrop import set_backdrop

        scene = context.scene
        set_backdrop(scene, self.mode, scene.fipt.capture.room_objects(scene))
        return {"FINISHED"}


class FIPT_OT_render_composite(RenderJob, bpy.types.Operator):
    bl_idname = "fipt.render_composite"
    bl_label = "Render View"
    bl_description = (
        "Render the current view with the inserted objects in Cycles: with the rendered room, or over"
        " the original photograph with their shadows and reflections"
    )
    title = "Render View"
    kind = "insert"

    backdrop: bpy.props.EnumProperty(
        name="Backdrop",
        description="What is behind the inserted objects. If not set, the choice in the panel is used",
        items=BACKDROPS,
        options={"SKIP_SAVE"},
    )
    view: bpy.props.StringProperty(
        name="View",
        description="Name of the view. If empty, the scene's active camera is used",
        options={"SKIP_SAVE"},
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend.pictures.orders import COMPOSITE, INSERT, make_order
        from ..blend.pictures.render_job import make_job

        scene, settings = context.scene, context.scene.fipt.insert
        backdrop = self.backdrop if self.properties.is_property_set("backdrop") else settings.backdrop
        kind = COMPOSITE if backdrop == "PHOTOGRAPH" else INSERT
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        views = [self.view or current_view(scene)]
        samples = self.samples or scene.fipt.check.samples
        return make_job(make_order(scene, run, kind, views, samples))

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.pictures.check_pictures import load_picture, show_in_editors
        from ..blend.pictures.orders import last_picture

        picture = last_picture(run)
        scene.fipt.insert.picture = str(picture)
        image = load_picture(picture)
        if image is not None:
            show_in_editors(bpy.context, image)


class FIPT_OT_open_picture(bpy.types.Operator):
    """Show the last rendered picture in an Image Editor"""

    bl_idname = "fipt.open_picture"
    bl_label = "Show Picture"
    bl_options = {"REGISTER"}

    poll = all_of(needs(lambda context: context.scene.fipt.insert.picture, "Use Render View first"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.pictures.check_pictures import load_picture, open_editor

        path = Path(context.scene.fipt.insert.picture)
        image = load_picture(path)
        if image is None:
            self.report({"ERROR"}, f"{path} no longer exists. Render the view again.")
            return {"CANCELLED"}
        open_editor(context, image)
        return {"FINISHED"}
