# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
# mypy: disable-error-code="valid-type"
"""The main job as an operator: modal with ESC in a window, blocking when a script executes it."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..bridge.process import Message
from ..bridge.sequence import Job
from ..core.job.errors import FiptError
from ..core.job.settings import PRESETS, make_settings
from ..mainjob import PARTS, RENDER_KINDS, MainJobOptions, make_main_job

_TIMER_SECONDS = 0.1


class FIPT_OT_estimate(bpy.types.Operator):
    """Estimate the materials and lights of a room from its photographs and its mesh"""

    bl_idname = "fipt.estimate"
    bl_label = "Estimate Materials and Lights"
    bl_options = {"REGISTER"}

    capture: bpy.props.StringProperty(
        name="Capture",
        description="The capture's folder or its camera file",
        subtype="FILE_PATH",
    )
    mesh: bpy.props.StringProperty(
        name="Mesh",
        description="The room's mesh file; empty takes the one beside the cameras",
        subtype="FILE_PATH",
    )
    output: bpy.props.StringProperty(
        name="Output",
        description="Folder for the results; an earlier run in it can be resumed",
        subtype="DIR_PATH",
    )
    preset: bpy.props.EnumProperty(
        name="Preset",
        description="Quality against time",
        items=[(name, name.capitalize(), "") for name in PRESETS],
        default="medium",
    )
    device: bpy.props.EnumProperty(
        name="Device",
        description="Where the engine computes",
        items=[
            ("auto", "Automatic", "The GPU where there is a usable one, else the CPU"),
            ("cuda", "GPU (CUDA)", "An NVIDIA GPU"),
            ("llvm", "CPU (LLVM)", "The processor"),
        ],
        default="auto",
    )
    parts: bpy.props.EnumProperty(
        name="Parts",
        description="What tells which surfaces share a material",
        items=[(name, name.capitalize(), "") for name in PARTS],
        default="auto",
    )
    renders: bpy.props.BoolProperty(
        name="Renders",
        description="Render a view again, relit and with an inserted object",
        default=True,
    )
    resume: bpy.props.BoolProperty(
        name="Resume",
        description="Keep what an earlier run in the same folder finished",
        default=True,
    )

    _job: Job | None = None
    _timer: bpy.types.Timer | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self._start(context):
            return {"CANCELLED"}
        assert self._job is not None
        good = self._job.run(lambda message: self._show(context, message))
        return {"FINISHED"} if good else {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self._start(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(_TIMER_SECONDS, window=context.window)
        manager.progress_begin(0.0, 1.0)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        assert self._job is not None
        if event.type == "ESC":
            self.cancel(context)
            self.report({"WARNING"}, "Stopped; finished stages are kept")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        for message in self._job.advance():
            self._show(context, message)
        if not self._job.finished:
            return {"PASS_THROUGH"}
        self._end_modal(context)
        return {"FINISHED"} if self._job.error is None else {"CANCELLED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Called by Blender too, when the window closes."""
        if self._job is not None:
            self._job.cancel()
        self._end_modal(context)

    def _start(self, context: bpy.types.Context) -> bool:
        try:
            self._job = make_main_job(self._options())
        except FiptError as error:
            self.report({"ERROR"}, f"{error.text} {error.remedy}")
            return False
        return True

    def _options(self) -> MainJobOptions:
        if not self.capture or not self.output:
            raise FiptError(
                "option-missing", "No capture or no output folder is named.", "Choose both folders."
            )
        return MainJobOptions(
            capture=Path(bpy.path.abspath(self.capture)),
            output=Path(bpy.path.abspath(self.output)),
            mesh=Path(bpy.path.abspath(self.mesh)) if self.mesh else None,
            settings=make_settings(self.preset, {"device": self.device}),
            parts=self.parts,
            renders=RENDER_KINDS if self.renders else (),
            resume=self.resume,
            own_file=False,
        )

    def _show(self, context: bpy.types.Context, message: Message) -> None:
        kind = message["type"]
        if kind == "error":
            self.report({"ERROR"}, f"{message['text']} {message['remedy']}")
        elif kind == "warning":
            self.report({"WARNING"}, f"{message['text']} {message['remedy']}")
        elif kind == "done":
            self.report({"INFO"}, f"Finished: {message['data']['run']}")
        elif self._timer is not None and kind == "progress":
            context.window_manager.progress_update(message["fraction"])
        elif self._timer is not None and kind == "stage":
            context.workspace.status_text_set(f"{message['text']} (ESC stops)")

    def _end_modal(self, context: bpy.types.Context) -> None:
        if self._timer is None:
            return
        context.window_manager.event_timer_remove(self._timer)
        self._timer = None
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
