# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Estimate: start, resume and cancel the estimation of the current scene."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import estimating
from ..core.run.runfolder import RunFolder
from ..core.run.settings import PRESETS
from ..jobs import running, runstate
from .job_operator import JobOperator
from .polls import all_of, needs, no_job
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..bridge.sequence import Job
    from ..jobs.tasks import Task


class _Estimation(JobOperator):
    """Base of Estimate and Resume."""

    poll = all_of(
        no_job,
        needs(lambda context: not context.mode.startswith("EDIT"), "Leave Edit Mode first"),
        needs(
            lambda context: len(context.scene.fipt.capture.views) or context.scene.fipt.run_folder,
            "Import a capture first, in the section Capture",
        ),
    )


class FIPT_OT_estimate(_Estimation, bpy.types.Operator):
    bl_idname = "fipt.estimate"
    bl_label = "Estimate"
    bl_description = (
        "Estimate the materials and lights of the room from its photographs. You can continue to work"
        " meanwhile; Esc stops it. Earlier results stay, in a run folder of their own"
    )

    keep: bpy.props.BoolProperty(
        name="Keep Stages",
        description="Keep finished stages of the last run that no change of room, views or settings affects",
        options={"SKIP_SAVE"},
    )

    def task(self, context: bpy.types.Context) -> Task:
        return estimating.estimation(keep_stages=self.keep)


class FIPT_OT_resume(_Estimation, bpy.types.Operator):
    bl_idname = "fipt.resume"
    bl_label = "Resume"
    bl_description = (
        "Continue the last run where it was stopped. If room, views or settings have changed since, it starts"
        " again at the first stage that depends on the change"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        state = runstate.known(context.scene.fipt.run_folder)
        if not state.stages and not state.engine:
            cls.poll_message_set("There is no stopped run to resume")
            return False
        if state.finished and not state.engine:
            cls.poll_message_set("The last run is finished. Use Estimate to start a new one")
            return False
        return True

    def task(self, context: bpy.types.Context) -> Task:
        again = estimating.estimation(keep_stages=True, keep_hints=True)

        def make(scene: bpy.types.Scene) -> Job:
            from ..jobs.main_job import estimate_step
            from ..jobs.run_job import attach_job

            run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
            # An engine that is still at work, started from here or elsewhere, is watched to its end.
            return attach_job(run, [estimate_step(run, run.read())]) or again.make(scene)

        return replace(again, make=make)


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


class FIPT_OT_smaller_preset(bpy.types.Operator):
    bl_idname = "fipt.smaller_preset"
    bl_label = "Use a Smaller Preset"
    bl_description = (
        "Select the next smaller preset, reset changed settings, and estimate again. Stages that are"
        " the same in both presets are kept"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if smaller_preset(context.scene.fipt.estimate.preset) is None:
            cls.poll_message_set("Draft is the smallest preset. Use fewer or smaller photographs")
            return False
        return bpy.ops.fipt.estimate.poll()

    def execute(self, context: bpy.types.Context) -> set[str]:
        self._change(context)
        return bpy.ops.fipt.estimate("EXEC_DEFAULT", keep=True)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self._change(context)
        bpy.ops.fipt.estimate("INVOKE_DEFAULT", keep=True)
        return {"FINISHED"}

    def _change(self, context: bpy.types.Context) -> None:
        settings = context.scene.fipt.estimate
        settings.preset = smaller_preset(settings.preset) or settings.preset
        settings.reset()


class FIPT_OT_reset_setting(bpy.types.Operator):
    """Reset this setting to the value of the preset"""

    bl_idname = "fipt.reset_setting"
    bl_label = "Reset to Preset"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    setting: bpy.props.StringProperty(
        name="Setting", description="Name of the setting. If empty, all settings are reset"
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.fipt.estimate.reset(*([self.setting] if self.setting else []))
        return {"FINISHED"}


def smaller_preset(preset: str) -> str | None:
    """The preset below one, or None."""
    names = list(PRESETS)
    index = names.index(preset)
    return names[index - 1] if index else None
