# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the panel Versions: use, compare, rename and delete earlier estimates of the run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying
from ..core.run.errors import FiptError
from ..jobs import running, runstate
from .job_operator import JobOperator
from .polls import all_of, has_run, in_object_mode, needs, no_job
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..core.run.versions import Version
    from ..jobs.tasks import Task

_MOST_PARTS = 8  # of a comparison


def _version_property() -> object:
    return bpy.props.StringProperty(
        name="Version", description="Id of the version", options={"SKIP_SAVE", "HIDDEN"}
    )


def _known(context: bpy.types.Context, version: str) -> Version | None:
    """A version as the panel knows it."""
    listed = runstate.known(context.scene.fipt.run_folder).versions
    return next((each for each in listed if each.id == version), None)


class _NoJob:
    """Mix-in of operators that change the versions at once."""

    poll = all_of(
        needs(lambda context: running.current() is None, "Wait for the end of the running job"), has_run
    )


class FIPT_OT_use_version(JobOperator, bpy.types.Operator):
    bl_idname = "fipt.use_version"
    bl_label = "Use Version"
    bl_description = (
        "Use this estimate: it becomes the run's results and is applied to the room. The results before stay"
        " in the list"
    )
    bl_options = {"REGISTER", "UNDO"}

    version: _version_property()

    poll = all_of(no_job, has_run, in_object_mode)

    def task(self, context: bpy.types.Context) -> Task:
        return applying.version_change(self.version)


class FIPT_OT_rename_version(_NoJob, bpy.types.Operator):
    """Give this estimate a name. One with a name is never deleted by itself"""

    bl_idname = "fipt.rename_version"
    bl_label = "Name Version"
    bl_options = {"REGISTER"}
    bl_property = "name"

    version: _version_property()
    name: bpy.props.StringProperty(
        name="Name", description="If empty, it is called by preset and date", options={"SKIP_SAVE"}
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        version = _known(context, self.version)
        self.name = "" if version is None else version.name
        return context.window_manager.invoke_props_dialog(self)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from .. import api

        api.rename_version(self.version, self.name, context.scene)
        return {"FINISHED"}


class FIPT_OT_delete_version(_NoJob, bpy.types.Operator):
    """Delete this estimate from the disk. This can't be undone"""

    bl_idname = "fipt.delete_version"
    bl_label = "Delete Version"
    bl_options = {"REGISTER"}

    version: _version_property()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        version = _known(context, self.version)
        return context.window_manager.invoke_confirm(
            self,
            event,
            title=iface_("Delete '{}'?").format(version.title if version else self.version),
            message=iface_("This can't be undone."),
            confirm_text=iface_("Delete"),
        )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from .. import api

        api.delete_version(self.version, context.scene)
        return {"FINISHED"}


class FIPT_OT_compare_versions(bpy.types.Operator):
    bl_idname = "fipt.compare_versions"
    bl_label = "Compare Versions"
    bl_description = (
        "Compare this estimate with the one in use: figures, and the parts whose material differs most"
    )
    bl_options = {"REGISTER"}

    version: _version_property()

    poll = all_of(has_run)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        for name, *values in self._compare(context):
            self.report({"INFO"}, f"{iface_(name)}: {', '.join(values)}")
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            self._rows = self._compare(context)
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return context.window_manager.invoke_popup(self, width=560)

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.label(text="Compare Versions")
        for name, *values in self._rows:
            split = column.split(factor=0.25)
            split.label(text=name, translate=not name.startswith("'"))
            row = split.row()
            for value in values:
                row.label(text=value, translate=False)

    def _compare(self, context: bpy.types.Context) -> list[tuple[str, str, str]]:
        """What differs: a name, and the values of this version and of the present one."""
        from ..core.run.version_figures import comparison
        from ..core.run.versions import list_versions

        run = applying.run_of(context.scene)
        present = next(iter(list_versions(run)), None)
        return [] if present is None else comparison(run, self.version, present.id, _MOST_PARTS)
