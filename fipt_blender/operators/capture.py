# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture: import cameras, photographs and the room's mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..api import importing
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs import running
from .job_operator import JobOperator
from .polls import all_of, has_meshes, in_object_mode, needs, no_job
from .reporting import report_warnings, reports_errors

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..jobs.tasks import Task

_MESH_FILES = "*.obj;*.ply;*.stl;*.gltf;*.glb;*.fbx;*.usd;*.usdc;*.usda;*.usdz"


class _ImportJob(JobOperator):
    """Base of both imports."""

    kind = "capture"
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(in_object_mode, no_job)


class FIPT_OT_import_capture(_ImportJob, bpy.types.Operator):
    """Read and check the photographs and cameras, and add the cameras and the room's mesh to the scene"""

    bl_idname = "fipt.import_capture"
    bl_label = "Import Capture"

    filepath: bpy.props.StringProperty(
        name="Capture",
        description="Folder or camera file of the capture. If empty, the path in the panel is used",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )

    def task(self, context: bpy.types.Context) -> Task:
        if self.filepath:
            context.scene.fipt.capture.path = self.filepath
        return importing.capture_import()


class FIPT_OT_use_scene_cameras(_ImportJob, bpy.types.Operator):
    """Use the scene's own cameras as the capture. Each camera needs its photograph as background image"""

    bl_idname = "fipt.use_scene_cameras"
    bl_label = "Use Scene Cameras"
    title = "Use Scene Cameras"
    failed = staticmethod(importing.give_back)

    poll = all_of(
        needs(
            lambda context: any(item.type == "CAMERA" for item in context.scene.objects),
            "The scene has no cameras",
        ),
        in_object_mode,
        no_job,
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend.capture.scene_cameras import SCENE_SOURCE, adopt_cameras, write_scene_cameras
        from ..core.capture.options import CaptureOptions

        scene = context.scene
        settings = scene.fipt.capture
        machine.engine_python()
        name = bpy.path.display_name_from_filepath(bpy.data.filepath) or scene.name
        run = importing.open_run(scene, SCENE_SOURCE, name)
        try:
            path, skipped = write_scene_cameras(scene, run)
        except FiptError:
            importing.give_back(scene, run)
            raise
        options = CaptureOptions(
            format="transforms",
            up_axis="z",
            hold_back=settings.hold_back,
            layer=settings.layer,
            clamp_negative=settings.clamp_negative,
            own_paths=True,
        )

        def adopt() -> list[Message]:
            adopt_cameras(run)
            if not skipped:
                return []
            text = f"{len(skipped)} cameras without a photograph were skipped: {', '.join(skipped[:5])}."
            remedy = "To use them as well, give each its photograph as background image."
            return [{"type": "warning", "code": "cameras-left-out", "text": text, "remedy": remedy}]

        return importing.import_job(run, path, options, "Listing the cameras", adopt)


class FIPT_OT_place_panorama(bpy.types.Operator):
    """Take the 3D Cursor as the place of the panorama, for the next import"""

    bl_idname = "fipt.place_panorama"
    bl_label = "Place at 3D Cursor"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings, place = context.scene.fipt.capture, context.scene.cursor.location
        if settings.alignment is not None:
            place = settings.alignment.matrix_world.inverted_safe() @ place
        settings.panorama_place = place
        return {"FINISHED"}


class FIPT_OT_import_mesh(bpy.types.Operator):
    """Import a mesh file as the room, in the coordinates of the capture. The previous room is set aside"""

    bl_idname = "fipt.import_mesh"
    bl_label = "Import Mesh"
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(
        name="Mesh", description="OBJ, PLY, STL, glTF, FBX or USD", subtype="FILE_PATH", options={"SKIP_SAVE"}
    )
    filter_glob: bpy.props.StringProperty(default=_MESH_FILES, options={"HIDDEN"})

    poll = all_of(in_object_mode)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture import importing

        scene = context.scene
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder)) if scene.fipt.run_folder else None
        path = self.filepath or scene.fipt.capture.mesh
        matrix = importing.source_matrix(scene, run)
        names = importing.import_mesh(scene, Path(bpy.path.abspath(path)), matrix)
        running.settle("capture", "mesh-missing")
        self.report({"INFO"}, iface_("The room consists of {} meshes").format(len(names)))
        return {"FINISHED"}


class FIPT_OT_hide_startup_objects(bpy.types.Operator):
    bl_idname = "fipt.hide_startup_objects"
    bl_label = "Hide Start-up Objects"
    bl_description = (
        "Hide the cube, the light and the camera of Blender's start-up file, if they are as they were there,"
        " or show them again. Import Capture hides them"
    )
    bl_options = {"REGISTER", "UNDO"}

    hide: bpy.props.BoolProperty(name="Hide", description="Hide the objects or show them again", default=True)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture.startup import hide_startup_objects

        names = hide_startup_objects(context.scene, self.hide)
        self.report({"INFO"}, ", ".join(names) or iface_("There are none"))
        return {"FINISHED"}


class FIPT_OT_set_room(bpy.types.Operator):
    """Use the selected meshes as the room. They keep their places and their collections"""

    bl_idname = "fipt.set_room"
    bl_label = "Set Room from Selection"
    bl_options = {"REGISTER", "UNDO"}

    collection: bpy.props.StringProperty(
        name="Collection",
        description="Collection whose meshes are the room. If empty, the selected objects are used",
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture.importing import not_in_room, set_room

        scene = context.scene
        left_out = not_in_room(context.view_layer.objects.selected)
        if self.collection:
            room = bpy.data.collections.get(self.collection)
            if room is None or not any(member.type == "MESH" for member in room.all_objects):
                self.report({"ERROR"}, f"There is no collection '{self.collection}' with meshes.")
                return {"CANCELLED"}
            scene.fipt.capture.room = room
            left_out = not_in_room(room.all_objects)
        else:
            selected = context.view_layer.objects.selected
            meshes = [selected_object for selected_object in selected if selected_object.type == "MESH"]
            if not meshes:
                advice = [f"{warning['text']} {warning['remedy']}" for warning in left_out]
                advice = advice or ["Select the objects that form the room."]
                self.report({"ERROR"}, " ".join(["No mesh objects are selected.", *advice]))
                return {"CANCELLED"}
            set_room(scene, meshes)
        running.settle("capture", "mesh-missing")
        count = len(scene.fipt.capture.room_objects(scene))
        self.report({"INFO"}, iface_("The room consists of {} meshes").format(count))
        report_warnings(self, left_out)
        return {"FINISHED"}


class FIPT_OT_simplify_room(bpy.types.Operator):
    """Decimate the room's larger meshes to the number of triangles, by modifiers. 0 removes these"""

    bl_idname = "fipt.simplify_room"
    bl_label = "Simplify Room"
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(has_meshes, in_object_mode)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.room.simplifying import simplify_room

        settings = context.scene.fipt.capture
        before, after = simplify_room(settings.room_objects(context.scene), settings.triangles)
        text = iface_("The room has {:,} triangles, {:,} without simplification")
        self.report({"INFO"}, text.format(after, before))
        return {"FINISHED"}
