# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the panel Versions: apply and delete other estimates of the capture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying
from ..jobs import running
from .job_operator import JobOperator
from .polls import all_of, has_run, in_object_mode, needs, no_job
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..jobs.tasks import Task


def _version_property() -> object:
    return bpy.props.StringProperty(
        name="Version", description="Name of its run folder", options={"SKIP_SAVE", "HIDDEN"}
    )


class FIPT_OT_use_version(JobOperator, bpy.types.Operator):
    bl_idname = "fipt.use_version"
    bl_label = "Apply Version"
    bl_description = "Apply this estimate to the room; the scene goes on with its run folder"
    bl_options = {"REGISTER", "UNDO"}

    version: _version_property()

    poll = all_of(no_job, has_run, in_object_mode)

    def task(self, context: bpy.types.Context) -> Task:
        return applying.version_change(self.version)


class FIPT_OT_delete_version(bpy.types.Operator):
    """Delete the run folder of this estimate from the disk. This can't be undone"""

    bl_idname = "fipt.delete_version"
    bl_label = "Delete Version"
    bl_options = {"REGISTER"}

    version: _version_property()

    poll = all_of(
        needs(lambda context: running.current() is None, "Wait for the end of the running job"), has_run
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(
            self,
            event,
            title=iface_("Delete '{}'?").format(self.version),
            message=iface_("This can't be undone."),
            confirm_text=iface_("Delete"),
        )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        applying.delete_version(context.scene, self.version)
        return {"FINISHED"}
