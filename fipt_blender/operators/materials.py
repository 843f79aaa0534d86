# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Materials: results onto the room, its maps, and all of it taken back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder
from ..properties.materials import SHOWN
from .job_operator import JobOperator
from .polls import has_results

if TYPE_CHECKING:
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, Step
    from ..core.job.settings import Settings

RECORD = "apply.json"
_OPTIONS = ("atlas_mode", "texture_size", "texel_density", "write_back")
# Seconds on a small capture; they only shape the progress bar.
_ATLAS_SECONDS, _BAKE_SECONDS, _BUILD_SECONDS = 2.0, 25.0, 1.0


class FIPT_OT_apply_results(JobOperator, bpy.types.Operator):
    """Put the estimated materials and lights onto the room. Your own meshes, materials and world are set
    aside; Revert brings them back"""

    bl_idname = "fipt.apply_results"
    bl_label = "Apply Results"
    bl_options = {"REGISTER", "UNDO"}
    title = "Apply Results"
    kind = "materials"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        if context.mode != "OBJECT":
            cls.poll_message_set("Switch to object mode first")
            return False
        if not context.scene.fipt.run_folder:
            cls.poll_message_set("Estimate first: there are no results yet")
            return False
        return True

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..runjob import open_job

        scene = context.scene
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        settings = chosen_settings(scene, run)
        run.create(settings)
        return open_job(
            run,
            make_steps(scene.name, run, settings),
            record=RECORD,
            resume=True,
            result=lambda: [str(path) for path in sorted(run.textures.glob("*.*"))],
        )

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.applied import finish

        finish(scene, run)


def chosen_settings(scene: bpy.types.Scene, run: RunFolder) -> Settings:
    """The run's settings with what the panel says of textures.

    Raises:
        FiptError: ``run-missing`` and others of `RunFolder.read`; ``results-missing``.
    """
    from dataclasses import replace

    settings = run.read()
    if not run.fields_npz.is_file() or not run.emitters_json.is_file():
        raise FiptError(
            "results-missing", f"The run {run.root} has no results yet.", "Estimate first, or resume the run."
        )
    chosen = scene.fipt.materials
    values: dict[str, Any] = {name: getattr(chosen, name) for name in _OPTIONS}
    return replace(settings, **{**values, "texture_size": int(chosen.texture_size)})


def make_steps(scene_name: str, run: RunFolder, settings: Settings) -> list[Step]:
    """Texture coordinates, baking, and the swap; the first two are kept where what they need is unchanged."""
    import uuid

    from ..bridge.step import Step

    texture_values = {name: getattr(settings, name) for name in _OPTIONS if name != "write_back"}

    def objects() -> list[bpy.types.Object]:
        scene = bpy.data.scenes[scene_name]
        return scene.fipt.capture.room_objects(scene)

    def lay_out() -> Slices:
        from ..blend.uvs import atlas_slices

        yield from atlas_slices(objects(), run, settings)
        return None

    def build() -> Slices:
        from ..blend.apply import apply_slices
        from ..blend.world import apply_environment

        yield from apply_slices(run, objects(), bpy.data.scenes[scene_name])
        apply_environment(run, bpy.data.scenes[scene_name])
        return None

    return [
        Step(
            "apply-atlas",
            "Laying out texture coordinates",
            _ATLAS_SECONDS,
            inputs={"room": _stamp(run.room_npz), **texture_values},
            function=lay_out,
            outputs=[run.atlas_npz, run.atlas_json],
        ),
        Step(
            "apply-textures",
            "Baking textures",
            _BAKE_SECONDS,
            inputs={"fields": _stamp(run.fields_npz)},
            command=["textures", str(run.root)],
            outputs=[run.textures],
        ),
        Step(
            "apply-build",
            "Building materials and lights",
            _BUILD_SECONDS,
            inputs={"time": uuid.uuid4().hex},  # never done already: its result lives in the file
            function=build,
        ),
    ]


def _stamp(path: Path) -> list[int]:
    try:
        status = path.stat()
    except OSError:
        return []
    return [status.st_size, status.st_mtime_ns]


class _NeedsResults:
    """Mix-in of operators on applied results."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not has_results(cls, context):
            return False
        if context.mode != "OBJECT":
            cls.poll_message_set("Switch to object mode first")  # type: ignore[attr-defined]
            return False
        return True


class FIPT_OT_show_map(_NeedsResults, bpy.types.Operator):
    """Let the whole room show one of its estimated maps, its materials, or its original state"""

    bl_idname = "fipt.show_map"
    bl_label = "Show Map"
    bl_options = {"REGISTER", "UNDO"}
    bl_property = "shown"

    shown: bpy.props.EnumProperty(name="Show", description="What the room shows", items=SHOWN)

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.fipt.materials.shown = self.shown
        return {"FINISHED"}


class FIPT_OT_revert(_NeedsResults, bpy.types.Operator):
    """Take all results off the room: meshes, materials and world are then your own again, as they were. The
    run keeps its results, so that they can be applied again"""

    bl_idname = "fipt.revert"
    bl_label = "Revert"
    bl_options = {"REGISTER", "UNDO"}

    new_lights: bpy.props.BoolProperty(
        name="Remove New Lights", description="Remove the lights as well that you added in the section Lights"
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.applied import revert

        restored = revert(context.scene, self.new_lights)
        self.report({"INFO"}, iface_("{} objects are as before").format(len(restored)))
        return {"FINISHED"}


CLASSES = (FIPT_OT_apply_results, FIPT_OT_show_map, FIPT_OT_revert)
