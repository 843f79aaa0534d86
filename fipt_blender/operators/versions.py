# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the panel Versions: apply and delete other estimates of the capture."""

from __future__ import annotations

from typing import Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying
from ..core.run.declared import Option
from ..jobs import running
from ..jobs.tasks import Task
from .action import REGISTER, action
from .polls import has_run, in_object_mode, needs, no_job

Version = Annotated[str, Option("Name of its run folder", shown={"options": {"SKIP_SAVE", "HIDDEN"}})]


@action("Apply Version", needs=(no_job, has_run, in_object_mode))
def use_version(scene: bpy.types.Scene, version: Version = "") -> Task:
    """Apply this estimate to the room; the scene goes on with its run folder."""
    return applying.version_change(version)


def _confirm(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    return context.window_manager.invoke_confirm(
        self,
        event,
        title=iface_("Delete '{}'?").format(self.version),
        message=iface_("This can't be undone."),
        confirm_text=iface_("Delete"),
    )


@action(
    "Delete Version",
    needs=(needs(lambda context: running.current() is None, "Wait for the end of the running job"), has_run),
    options=REGISTER,
    invoke=_confirm,
)
def delete_version(scene: bpy.types.Scene, version: Version = "") -> None:
    """Delete the run folder of this estimate from the disk. This can't be undone."""
    applying.delete_version(scene, version)
