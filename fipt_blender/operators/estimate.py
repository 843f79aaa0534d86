# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Estimate: start, resume and cancel the engine on the scene as it is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import preferences, running, runstate
from ..core.job.runfolder import RunFolder
from ..properties.estimate import PRESETS
from .job_operator import JobOperator

if TYPE_CHECKING:
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, Step
    from ..core.job.settings import Settings

# Seconds on a small capture; they only shape the progress bar.
_CAMERAS_SECONDS, _ROOM_SECONDS = 1.0, 2.0


class _Estimation(JobOperator):
    """What Estimate and Resume share: the steps from the scene to the results."""

    title = "Estimate"
    kind = "estimate"

    def keeps_stages(self) -> bool:
        """Whether finished stages are kept that room, views and settings leave as they are."""
        raise NotImplementedError

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        if context.mode.startswith("EDIT"):
            cls.poll_message_set("Leave edit mode first")  # type: ignore[attr-defined]
            return False
        state = context.scene.fipt
        if not len(state.capture.views) and not state.run_folder:
            cls.poll_message_set("Import cameras with photographs first, in the section Capture")  # type: ignore[attr-defined]
            return False
        return True

    def make_job(self, context: bpy.types.Context) -> Job:
        from .. import runjob

        scene = context.scene
        launch = runjob.find_launch()
        settings = scene_settings(scene)
        if not scene.fipt.run_folder:
            name = Path(bpy.data.filepath).stem or scene.name
            scene.fipt.run_folder = str(preferences.new_run_folder(name))
            running.push_undo(self.title)
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        runjob.refuse_busy(run)
        run.create(settings)
        return runjob.open_job(
            run,
            make_steps(run, settings, self.keeps_stages()),
            resume=self.keeps_stages(),
            result=lambda: result_files(run),
            launch=launch,
        )


class FIPT_OT_estimate(_Estimation, bpy.types.Operator):
    """Estimate the materials and lights of the room from its photographs"""

    bl_idname = "fipt.estimate"
    bl_label = "Estimate"
    bl_description = (
        "Estimate the materials and lights of the room from its photographs. You can go on with your work"
        " meanwhile; Escape stops it. Results of an earlier estimate are replaced"
    )

    keep: bpy.props.BoolProperty(
        name="Keep Stages",
        description="Keep finished stages of the last run that room, views and settings leave as they are",
        options={"SKIP_SAVE"},
    )

    def keeps_stages(self) -> bool:
        return self.keep


class FIPT_OT_resume(_Estimation, bpy.types.Operator):
    """Go on where the last run was stopped"""

    bl_idname = "fipt.resume"
    bl_label = "Resume"
    bl_description = (
        "Go on where the last run was stopped. Finished stages are kept up to the first one that a change of"
        " the room, the views or the settings concerns"
    )

    def keeps_stages(self) -> bool:
        return True

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        state = runstate.known(context.scene.fipt.run_folder)
        if not state.stages and not state.engine:
            cls.poll_message_set("There is no stopped run to resume")
            return False
        if state.finished and not state.engine:
            cls.poll_message_set("The last run is finished; Estimate starts a new one")
            return False
        return True

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..mainjob import estimate_step
        from ..runjob import attach_job

        run = RunFolder(bpy.path.abspath(context.scene.fipt.run_folder))
        # An engine that still works, without a Blender or with another one, is watched to its end.
        attached = attach_job(run, [estimate_step(run, run.read())])
        return attached or super().make_job(context)


class FIPT_OT_cancel(bpy.types.Operator):
    """Stop the running job within two seconds. What it has finished is kept, and Resume goes on from there"""

    bl_idname = "fipt.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        job = running.current()
        if job is None or job.stopping:
            cls.poll_message_set("Nothing runs" if job is None else "It is stopping")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        running.cancel()
        return {"FINISHED"}


class FIPT_OT_smaller_preset(bpy.types.Operator):
    """Choose the next smaller preset, drop what was changed of it, and estimate again. Stages that both share
    are kept"""

    bl_idname = "fipt.smaller_preset"
    bl_label = "Use a Smaller Preset"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if smaller_preset(context.scene.fipt.estimate.preset) is None:
            cls.poll_message_set("Draft is the smallest: use fewer or smaller photographs")
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
    """Let this setting follow the preset again"""

    bl_idname = "fipt.reset_setting"
    bl_label = "Reset to Preset"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    setting: bpy.props.StringProperty(name="Setting", description="Name of the setting; empty for all")

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.fipt.estimate.reset(*([self.setting] if self.setting else []))
        return {"FINISHED"}


def smaller_preset(preset: str) -> str | None:
    """The preset below one, or None."""
    names = [name for name, _, _ in PRESETS]
    index = names.index(preset)
    return names[index - 1] if index else None


def scene_settings(scene: bpy.types.Scene) -> Settings:
    """The settings that the section Estimate shows; those of textures stay as the run folder has them.

    Raises:
        FiptError: ``setting-invalid``; those of `RunFolder.read`.
    """
    from ..core.job.settings import make_settings
    from ..mainjob import TEXTURE_SETTINGS

    state = scene.fipt.estimate
    device = preferences.device_setting() if state.device == "preferences" else state.device
    changes = {**state.values(), "device": device}
    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
    if scene.fipt.run_folder and run.run_json.exists():
        before = run.read()
        changes |= {name: getattr(before, name) for name in TEXTURE_SETTINGS}
    return make_settings(state.preset, changes)


def make_steps(run: RunFolder, settings: Settings, resume: bool) -> list[Step]:
    """From the scene as it is to the results; see `estimate_step`."""
    from ..bridge.step import Step
    from ..mainjob import EXPORT_TEXT, estimate_step

    def cameras() -> None:
        from ..blend.steps import export_scene_cameras

        export_scene_cameras(run)

    def room() -> Slices:
        from ..blend.steps import export_scene_room

        yield from export_scene_room(run)
        return None

    return [
        Step("cameras", "Reading the cameras", _CAMERAS_SECONDS, function=cameras, repeat=True),
        Step("room", EXPORT_TEXT, _ROOM_SECONDS, function=room, repeat=True),
        estimate_step(run, settings, resume),
    ]


def result_files(run: RunFolder) -> list[str]:
    """Paths of what an estimation leaves for the other sections."""
    wanted = [run.fields_npz, run.emitters_json, run.environment_exr, run.statistics_json]
    return [str(path) for path in wanted if path.exists()]


CLASSES = (
    FIPT_OT_estimate,
    FIPT_OT_resume,
    FIPT_OT_cancel,
    FIPT_OT_smaller_preset,
    FIPT_OT_reset_setting,
)
