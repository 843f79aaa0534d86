# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Render that make pictures: their backdrop, their settings, the picture itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..properties.insert import BACKDROPS
from .check import NeedsEstimate
from .job_operator import JobOperator
from .polls import all_of, has_results, needs
from .reporting import reports_errors

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


class FIPT_OT_final_picture(NeedsEstimate, JobOperator, bpy.types.Operator):
    bl_idname = "fipt.final_picture"
    bl_label = "Final Picture"
    bl_description = (
        "Render what the scene's camera sees in Cycles, with the scene's render settings as F12 does, beside"
        " your work. Rendered Room: the whole room; Photograph: the inserted objects with their shadows and"
        " reflections over the photograph, whose lens's distortion is undone. It is saved beside the .blend"
        " file as EXR of all layers and passes and as PNG, and shown"
    )
    bl_options = {"REGISTER", "UNDO"}
    title = "Final Picture"
    kind = "insert"

    view: bpy.props.StringProperty(
        name="View",
        description="Name of a view to look through first. If empty, the scene's active camera is used",
        options={"SKIP_SAVE"},
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend.capture.cameras import find_camera, use_view
        from ..blend.pictures.orders import order_picture
        from ..blend.pictures.render_job import make_job

        scene = context.scene
        if self.view:
            use_view(scene, find_camera(self.view, scene))
        if scene.camera is None:
            raise FiptError(
                "view-missing",
                "The scene has no camera.",
                "Click a view in the section Capture, or add a camera.",
            )
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        return make_job(order_picture(scene, run, scene.camera, scene.fipt.insert.backdrop == "PHOTOGRAPH"))

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.pictures.editors import load_picture, open_editor
        from ..blend.pictures.orders import last_picture

        picture = last_picture(run)
        scene.fipt.insert.picture = str(picture)
        image = load_picture(picture)
        if image is not None and not bpy.app.background:
            open_editor(bpy.context, image)


class FIPT_OT_set_rendering(bpy.types.Operator):
    bl_idname = "fipt.set_rendering"
    bl_label = "Set Render Settings"
    bl_description = (
        "Set the scene's render settings again as Apply Results does once: Cycles, samples, denoiser, color"
        " management and exposure of the photographs"
    )
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(has_results)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.render_settings import set_up
        from ..blend.results.scene_state import photographs_exposure

        set_up(context.scene, photographs_exposure(context.scene), again=True)
        return {"FINISHED"}


class FIPT_OT_open_picture(bpy.types.Operator):
    """Show the last rendered picture in an Image Editor"""

    bl_idname = "fipt.open_picture"
    bl_label = "Show Picture"
    bl_options = {"REGISTER"}

    poll = all_of(needs(lambda context: context.scene.fipt.insert.picture, "Use Final Picture first"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.pictures.editors import load_picture, open_editor

        path = Path(context.scene.fipt.insert.picture)
        image = load_picture(path)
        if image is None:
            self.report({"ERROR"}, f"{path} no longer exists. Render the view again.")
            return {"CANCELLED"}
        open_editor(context, image)
        return {"FINISHED"}


class FIPT_OT_plate_nodes(bpy.types.Operator):
    bl_idname = "fipt.plate_nodes"
    bl_label = "Compositor Scene"
    bl_description = (
        "Make a scene with the same objects, whose compositor nodes put them over the photograph of the"
        " current view, as Final Picture does. The room's scene is not changed"
    )
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(
        needs(
            lambda context: context.scene.fipt.insert.backdrop == "PHOTOGRAPH",
            "Select Photograph first, in the section Render",
        )
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.pictures.orders import view_of
        from ..blend.pictures.plate import plate_scene
        from ..core.run.run_files import read_capture

        scene = context.scene
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        view = read_capture(run.capture_json).view(view_of(scene.camera))
        room = [item.name for item in scene.fipt.capture.room_objects(scene)]
        made = plate_scene(scene, run, view, scene.camera, room)
        self.report({"INFO"}, iface_("The scene '{}' has the nodes").format(made.name))
        return {"FINISHED"}
