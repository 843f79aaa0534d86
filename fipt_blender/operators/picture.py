# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Insert that make pictures: what is behind what was inserted, and the render."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.job.runfolder import RunFolder
from ..properties.insert import BACKDROPS
from .check import RenderJob, current_view

if TYPE_CHECKING:
    from ..bridge.sequence import Job


class FIPT_OT_set_backdrop(bpy.types.Operator):
    """Choose what is seen behind inserted objects: the room rendered anew, or the original photograph"""

    bl_idname = "fipt.set_backdrop"
    bl_label = "Set Backdrop"
    bl_options = {"REGISTER", "UNDO"}

    mode: bpy.props.EnumProperty(name="Backdrop", description="What is seen behind", items=BACKDROPS)

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return next(text for name, _, text, *_ in BACKDROPS if name == properties.mode)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        from ..blend.outliner import ROOM, find_collection

        scene = context.scene
        if scene.fipt.capture.room is None and find_collection(scene, ROOM) is None:
            cls.poll_message_set("Import the room first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.backdrop import set_backdrop

        scene = context.scene
        set_backdrop(scene, self.mode, scene.fipt.capture.room_objects(scene))
        return {"FINISHED"}


class FIPT_OT_render_composite(RenderJob, bpy.types.Operator):
    """Render the current view with what was inserted in Cycles: in the room, or put into the original
    photograph with its shadows and reflections"""

    bl_idname = "fipt.render_composite"
    bl_label = "Render View"
    title = "Insert"
    kind = "insert"

    backdrop: bpy.props.EnumProperty(
        name="Backdrop",
        description="What is behind what was inserted; the panel's choice if not given",
        items=BACKDROPS,
        options={"SKIP_SAVE"},
    )
    view: bpy.props.StringProperty(
        name="View", description="Name of the view; empty for the scene's camera", options={"SKIP_SAVE"}
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend import render_job

        scene, settings = context.scene, context.scene.fipt.insert
        backdrop = self.backdrop if self.properties.is_property_set("backdrop") else settings.backdrop
        kind = render_job.COMPOSITE if backdrop == "PHOTOGRAPH" else render_job.INSERT
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        views = [self.view or current_view(scene)]
        samples = self.samples or settings.samples
        return render_job.make_job(render_job.make_order(scene, run, kind, views, samples))

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.check_pictures import load_picture, show_in_editors
        from ..blend.render_job import last_picture

        picture = last_picture(run)
        scene.fipt.insert.picture = str(picture)
        image = load_picture(picture)
        if image is not None:
            show_in_editors(bpy.context, image)


class FIPT_OT_open_picture(bpy.types.Operator):
    """Show the picture that was rendered last in an Image Editor"""

    bl_idname = "fipt.open_picture"
    bl_label = "Show Picture"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.fipt.insert.picture:
            cls.poll_message_set("Render the view first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.check_pictures import load_picture, open_editor

        path = Path(context.scene.fipt.insert.picture)
        image = load_picture(path)
        if image is None:
            self.report({"ERROR"}, f"{path} does not exist any more. Render the view again.")
            return {"CANCELLED"}
        open_editor(context, image)
        return {"FINISHED"}


CLASSES = (FIPT_OT_set_backdrop, FIPT_OT_render_composite, FIPT_OT_open_picture)
