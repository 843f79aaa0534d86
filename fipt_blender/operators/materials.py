# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Materials: apply the results to the room, show their maps, revert."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..properties.materials import SHOWN
from .job_operator import JobOperator
from .polls import has_results, in_object_mode

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, Step
    from ..core.run.settings import Settings

RECORD = "apply.json"
_ATLAS_SETTINGS = ("atlas_mode", "atlas_images", "texture_size", "texel_density")
# Seconds on a small capture, for the progress bar only.
_ATLAS_SECONDS, _BAKE_SECONDS, _BUILD_SECONDS = 2.0, 25.0, 1.0


class FIPT_OT_apply_results(JobOperator, bpy.types.Operator):
    """Apply the estimated materials and lights to the room"""

    bl_idname = "fipt.apply_results"
    bl_label = "Apply Results"
    bl_description = (
        "Apply the estimated materials and lights to the room. Your own meshes, materials and world are"
        " set aside; Revert restores them"
    )
    bl_options = {"REGISTER", "UNDO"}
    title = "Apply Results"
    kind = "materials"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        if not context.scene.fipt.run_folder:
            cls.poll_message_set("Run Estimate first")
            return False
        return in_object_mode(cls, context)

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..jobs.run_job import open_job

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
        from ..blend.results.scene_state import finish

        finish(scene, run)


def chosen_settings(scene: bpy.types.Scene, run: RunFolder) -> Settings:
    """The run's settings, with the texture settings of the panel.

    Raises:
        FiptError: ``run-missing`` and others of `RunFolder.read`; ``results-missing``.
    """
    from dataclasses import replace

    settings = run.read()
    run.recover()
    if not run.fields_npz.is_file() or not run.emitters_json.is_file():
        raise FiptError(
            "results-missing",
            f"The run {run.root} has no results yet.",
            "Use Estimate, or Resume if the run was stopped.",
        )
    panel = scene.fipt.materials
    return replace(
        settings,
        atlas_mode=panel.atlas_mode,
        atlas_images=panel.atlas_images,
        texture_size=int(panel.texture_size),
        texel_density=panel.texel_density,
        write_back=panel.write_back,
        clean_mesh=panel.clean_mesh,
    )


def make_steps(scene_name: str, run: RunFolder, settings: Settings) -> list[Step]:
    """Texture coordinates, baking, assignment; the first two are skipped while their inputs are the same."""
    import uuid

    from ..bridge.step import Step

    atlas_values = {name: getattr(settings, name) for name in _ATLAS_SETTINGS}

    def objects() -> list[bpy.types.Object]:
        scene = bpy.data.scenes[scene_name]
        return scene.fipt.capture.room_objects(scene)

    def lay_out() -> Slices[None]:
        from ..blend.room.atlas import atlas_slices

        yield from atlas_slices(objects(), run, settings)
        return None

    def build() -> Slices[list[Message]]:
        from ..blend.lights.world import apply_environment
        from ..blend.results.applying import apply_slices
        from ..blend.texture_files import texture_files

        files = texture_files(bpy.data.scenes[scene_name])
        applied = yield from apply_slices(run, objects(), bpy.data.scenes[scene_name], files)
        apply_environment(run, bpy.data.scenes[scene_name], files)
        return applied.warnings

    return [
        Step(
            "apply-atlas",
            "Creating texture coordinates",
            _ATLAS_SECONDS,
            inputs={
                "room": _stamp(run.estimated().room_npz),
                "parts": _stamp(run.parts_npz) if settings.atlas_images == "part" else [],
                **atlas_values,
            },
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
            inputs={"time": uuid.uuid4().hex},  # never skipped: its result is in the .blend file
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
        return has_results(cls, context) and in_object_mode(cls, context)


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
    """Remove the results from the room and restore your own meshes, materials and world"""

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

        restored = revert(context.scene, self.new_lights)
        self.report({"INFO"}, iface_("{} objects restored").format(len(restored)))
        return {"FINISHED"}


class FIPT_OT_use_cycles(bpy.types.Operator):
    """Make Cycles the scene's render engine"""

    bl_idname = "fipt.use_cycles"
    bl_label = "Switch to Cycles"
    bl_description = (
        "Make Cycles the scene's render engine. It renders the light of lamps' surfaces, and light groups"
    )
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.scene_state import use_cycles

        if not use_cycles(context.scene):
            self.report({"ERROR"}, "Cycles is disabled. Enable its add-on in the preferences.")
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (FIPT_OT_apply_results, FIPT_OT_show_map, FIPT_OT_revert, FIPT_OT_use_cycles)
