# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Materials: apply the results to the room, show their maps, revert."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying
from ..core.run.errors import FiptError
from ..properties.materials import SHOWN
from .job_operator import JobOperator
from .polls import all_of, has_results, in_object_mode, is_own_room, needs, no_job
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..jobs.tasks import Task


class FIPT_OT_apply_results(JobOperator, bpy.types.Operator):
    bl_idname = "fipt.apply_results"
    bl_label = "Apply Results"
    bl_description = (
        "Apply the estimated materials and lights to the room. Your own meshes, materials and world are"
        " set aside; Revert restores them"
    )
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(
        no_job,
        needs(lambda context: context.scene.fipt.run_folder, "Run Estimate first"),
        is_own_room,
        in_object_mode,
    )

    def task(self, context: bpy.types.Context) -> Task:
        return applying.application()


class _NeedsResults:
    """Mix-in of operators on applied results."""

    poll = all_of(has_results, in_object_mode)


class FIPT_OT_show_map(_NeedsResults, bpy.types.Operator):
    """Show one of the estimated maps, the estimated materials or the original state on the whole room"""

    bl_idname = "fipt.show_map"
    bl_label = "Show Map"
    bl_options = {"REGISTER", "UNDO"}
    bl_property = "shown"

    shown: bpy.props.EnumProperty(name="Show", description="What the room shows", items=SHOWN)

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.fipt.materials.shown = self.shown
        return {"FINISHED"}


class FIPT_OT_revert(_NeedsResults, bpy.types.Operator):
    bl_idname = "fipt.revert"
    bl_label = "Revert"
    bl_description = (
        "Remove the results from the room and restore your own meshes, materials and world. The run"
        " keeps its results, so they can be applied again"
    )
    bl_options = {"REGISTER", "UNDO"}

    new_lights: bpy.props.BoolProperty(
        name="Remove New Lights", description="Also remove the lights that you added in the section Lights"
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.reverting import revert
        from ..blend.room.result_meshes import list_names

        restored, hidden = revert(context.scene, self.new_lights)
        if hidden:
            text = iface_("Hidden, since the restored meshes hold the faces that were separated: {}")
            self.report({"WARNING"}, text.format(list_names(hidden)))
        self.report({"INFO"}, iface_("{} objects restored").format(len(restored)))
        return {"FINISHED"}


class FIPT_OT_collect_room(bpy.types.Operator):
    bl_idname = "fipt.collect_room"
    bl_label = "Collect Room"
    bl_description = (
        "Save a copy of the file into a folder of its own, with all images that it uses and the exports"
        " beside it, or as one packed file. It opens on another machine without this add-on. In a folder"
        " that is not empty, the folder NAME_collected is made for it"
    )

    directory: bpy.props.StringProperty(
        name="Folder", description="Where the copy is saved", subtype="DIR_PATH"
    )
    pack: bpy.props.BoolProperty(name="One File", description="Pack the images into the copy")

    poll = all_of(has_results, no_job, in_object_mode)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.export.collecting import collect_room

        if not self.directory:
            raise FiptError("export-file", "No folder is chosen.", "Choose a folder.")
        folder = Path(bpy.path.abspath(self.directory))
        done = collect_room(folder, self.pack)
        if done.left:
            text = iface_("{} other files stay where they are, the first is {}")
            self.report({"WARNING"}, text.format(len(done.left), done.left[0]))
        text = iface_("{} written, with {} files of exports").format(done.path, len(done.exports))
        self.report({"INFO"}, text)
        return {"FINISHED"}


class FIPT_OT_use_cycles(bpy.types.Operator):
    bl_idname = "fipt.use_cycles"
    bl_label = "Switch to Cycles"
    bl_description = (
        "Make Cycles the scene's render engine. It renders the light of lamps' surfaces, and light groups"
    )
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.render_settings import set_once

        if not set_once(context.scene, {"render.engine": "CYCLES"}, again=True):
            self.report({"ERROR"}, "Cycles is disabled. Enable its add-on in the preferences.")
            return {"CANCELLED"}
        return {"FINISHED"}
