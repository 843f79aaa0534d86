# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Parts: which surfaces share a material."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from .job_operator import JobOperator
from .overlay import ShowsColors
from .polls import all_of, has_views, needs, no_job

if TYPE_CHECKING:
    from ..bridge.sequence import Job


class FIPT_OT_find_masks(JobOperator, bpy.types.Operator):
    """Let the model find masks of the ticked views that have none"""

    bl_idname = "fipt.find_masks"
    bl_label = "Find Masks"
    bl_options = {"REGISTER"}
    title = "Find Masks"
    kind = "masks"

    poll = all_of(
        has_views,
        needs(
            lambda context: context.scene.fipt.parts.masks_model or machine.mask_model(),
            "Use Set Up Mask Model first, or choose a masks model",
        ),
        no_job,
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..bridge.step import Step
        from ..jobs.run_job import masks_step, open_job

        run = RunFolder(bpy.path.abspath(context.scene.fipt.run_folder))
        chosen = context.scene.fipt.parts.masks_model
        model = Path(bpy.path.abspath(chosen)) if chosen else machine.mask_model()
        if model is None:
            raise FiptError("model-unusable", "There is no mask model.", "Use Set Up Mask Model.")

        def ticked_views() -> None:
            from ..jobs.room_steps import export_scene_cameras

            export_scene_cameras(run)

        steps = [
            Step("masks-input", "Reading the cameras", 1.0, function=ticked_views, repeat=True),
            masks_step(run, model),
        ]
        return open_job(run, steps, record="masks/steps.json")

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.survey import forget_parts

        forget_parts(scene)


class FIPT_OT_show_parts(ShowsColors, bpy.types.Operator):
    """Display the parts of the room, each in its own color"""

    bl_idname = "fipt.show_parts"
    bl_label = "Show Parts"

    poll = all_of(
        needs(
            lambda context: context.scene.fipt.parts.counts,
            "Use Check Views first, in the section Capture; it finds the parts as well",
        )
    )

    @staticmethod
    def color(scene: bpy.types.Scene) -> None:
        from ..blend.capture.survey import show_parts

        show_parts(scene)
