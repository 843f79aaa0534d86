# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Estimate: start, resume and cancel the estimation of the current scene."""

from __future__ import annotations

from typing import Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import estimating
from ..core.run.declared import Option
from ..core.run.settings import PRESETS
from ..jobs import running, runstate
from ..jobs.tasks import Task
from .action import REGISTER, UNDO, action
from .polls import needs, no_job
from .reporting import reports_errors

_can_start = (
    no_job,
    needs(lambda context: not context.mode.startswith("EDIT"), "Leave Edit Mode first"),
    needs(
        lambda context: len(context.scene.fipt.capture.views) or context.scene.fipt.run_folder,
        "Import a capture first, in the section Capture",
    ),
)


@action("Estimate", needs=_can_start, options=REGISTER)
def estimate(
    scene: bpy.types.Scene,
    keep: Annotated[
        bool,
        Option(
            "Keep finished stages of the last run that no change of room, views or settings affects",
            "Keep Stages",
        ),
    ] = False,
) -> Task:
    """Estimate the materials and lights of the room from its photographs. You can continue to work meanwhile;
    Esc stops it. Earlier results stay, in a run folder of their own.
    """
    return estimating.estimation(keep_stages=keep)


def _state(context: bpy.types.Context) -> runstate.RunState:
    return runstate.known(context.scene.fipt.run_folder)


@action(
    "Resume",
    needs=(
        *_can_start,
        needs(
            lambda context: _state(context).stages or _state(context).engine,
            "There is no stopped run to resume",
        ),
        needs(
            lambda context: not _state(context).finished or _state(context).engine,
            "The last run is finished. Use Estimate to start a new one",
        ),
    ),
    options=REGISTER,
)
def resume(scene: bpy.types.Scene) -> Task:
    """Continue the last run where it was stopped. If room, views or settings have changed since, it starts
    again at the first stage that depends on the change.
    """
    return estimating.resumption()


class FIPT_OT_notice(bpy.types.Operator):
    """Show a text in the status bar and the Info editor"""

    bl_idname = "fipt.notice"
    bl_label = "Show Notice"
    bl_options = {"INTERNAL"}

    text: bpy.props.StringProperty(name="Text", options={"HIDDEN", "SKIP_SAVE"})
    level: bpy.props.EnumProperty(
        name="Level",
        items=(("INFO", "Info", ""), ("WARNING", "Warning", ""), ("ERROR", "Error", "")),
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        self.report({self.level}, self.text)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Report from a window's event: Blender only prints what an operator reports to a script."""
        self._timer = context.window_manager.event_timer_add(0.05, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return self.execute(context)


class FIPT_OT_cancel(bpy.types.Operator):
    """Stop the running job within two seconds. Finished stages are kept, and Resume continues from there"""

    bl_idname = "fipt.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    by_key: bpy.props.BoolProperty(
        name="By Key",
        description="Pressed as a shortcut, which may have been meant for something else",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        job = running.current()
        if job is None or job.stopping:
            cls.poll_message_set("No job is running" if job is None else "The job is stopping already")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Cancel at once, but ask first where the Esc key would end a long run."""
        from ..jobs import session
        from ..panels.progress import time_text

        job = running.current()
        if not self.by_key or job is None:
            return self.execute(context)
        if session.stops_playback(context.screen):
            return {"PASS_THROUGH"}
        if job.worked_seconds < 60.0:  # after so much work, Esc asks before it cancels
            return self.execute(context)
        message = iface_("It has been running for {}. Finished stages are kept for Resume.").format(
            time_text(job.worked_seconds)
        )
        return context.window_manager.invoke_confirm(
            self,
            event,
            title=iface_("Stop '{}'?").format(iface_(job.title)),
            message=message,
            confirm_text=iface_("Stop"),
        )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        running.cancel()
        return {"FINISHED"}


@action(
    "Use a Smaller Preset",
    needs=(
        needs(
            lambda context: smaller_preset_of(context.scene.fipt.estimate.preset) is not None,
            "Draft is the smallest preset. Use fewer or smaller photographs",
        ),
        *_can_start,
    ),
)
def smaller_preset(scene: bpy.types.Scene) -> Task:
    """Select the next smaller preset, reset changed settings, and estimate again. Stages that are the same in
    both presets are kept.
    """
    settings = scene.fipt.estimate
    settings.preset = smaller_preset_of(settings.preset) or settings.preset
    settings.reset()
    return estimating.estimation(keep_stages=True)


@action("Reset to Preset", options={*UNDO, "INTERNAL"})
def reset_setting(
    scene: bpy.types.Scene,
    setting: Annotated[str, "Name of the setting. If empty, all settings are reset"] = "",
) -> None:
    """Reset this setting to the value of the preset."""
    scene.fipt.estimate.reset(*([setting] if setting else []))


def smaller_preset_of(preset: str) -> str | None:
    """The preset below one, or None."""
    names = list(PRESETS)
    index = names.index(preset)
    return names[index - 1] if index else None
