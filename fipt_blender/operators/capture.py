# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture: import cameras, photographs and the room's mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs import running
from .job_operator import JobOperator
from .polls import in_object_mode
from .reporting import report_warnings, reports_errors

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, StepFunction
    from ..jobs.options import CaptureOptions
    from ..properties.capture import FIPT_CaptureSettings

_MESH_FILES = "*.obj;*.ply;*.stl;*.gltf;*.glb;*.fbx;*.usd;*.usdc;*.usda;*.usdz"


class _ImportJob(JobOperator):
    """Base of both imports: a run folder for the capture, given back if the import fails."""

    kind = "capture"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return in_object_mode(cls, context) and super().poll(context)

    @staticmethod
    def failed(scene: bpy.types.Scene, run: RunFolder) -> None:
        """Give the scene its previous run folder back and delete the new one."""
        import shutil

        previous = scene.fipt.capture.previous_run
        if previous and previous != scene.fipt.run_folder:
            scene.fipt.run_folder = previous
            shutil.rmtree(run.root, ignore_errors=True)

    @staticmethod
    def _open_run(scene: bpy.types.Scene, source: str, name: str) -> RunFolder:
        """The scene's run folder, or a new one if it has none or that holds another capture or none."""
        import shutil

        from ..core.run.settings import make_settings

        settings, previous = scene.fipt.capture, scene.fipt.run_folder
        settings.previous_run = previous
        run = RunFolder(bpy.path.abspath(previous)) if previous else None
        if run is not None and machine.is_unused_run(run.root):
            # Of a first import that failed, with the name of what it tried to import.
            shutil.rmtree(run.root, ignore_errors=True)
            settings.previous_run, run = "", None
        if run is None or (run.capture_json.exists() and settings.imported_path != source):
            run = RunFolder(machine.new_run_folder(name))
        if not run.run_json.exists():
            run.create(make_settings())
        scene.fipt.run_folder = str(run.root)
        return run

    @staticmethod
    def _import_job(
        run: RunFolder, path: Path, arguments: list[str], text: str, add_to_scene: StepFunction
    ) -> Job:
        """The engine reads and checks a capture; then it is added to the scene."""
        from ..bridge.step import Step
        from ..jobs.run_job import ingest_step, open_job

        steps = [
            ingest_step(run, path, arguments, "Reading and checking the photographs", 20.0),
            Step("import", text, 5.0, function=add_to_scene, repeat=True),
        ]
        return open_job(run, steps, record="import.json")


class FIPT_OT_import_capture(_ImportJob, bpy.types.Operator):
    """Read and check the photographs and cameras, and add the cameras and the room's mesh to the scene"""

    bl_idname = "fipt.import_capture"
    bl_label = "Import Capture"
    title = "Import Capture"

    filepath: bpy.props.StringProperty(
        name="Capture",
        description="Folder or camera file of the capture. If empty, the path in the panel is used",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..jobs.options import capture_source, ingest_arguments

        scene = context.scene
        if self.filepath:
            scene.fipt.capture.path = self.filepath
        settings = scene.fipt.capture
        if not settings.path:
            raise FiptError(
                "capture-missing",
                "No capture is selected.",
                "Select its folder or camera file in the section Capture.",
            )
        path = Path(bpy.path.abspath(settings.path)).absolute()
        if not path.exists():
            raise FiptError(
                "capture-missing",
                f"The capture {path} does not exist.",
                "Select the folder that contains the cameras, or the camera file itself, as Capture.",
            )
        path = capture_source(path)
        arguments = ingest_arguments(_capture_options(settings))
        machine.engine_python()  # raises before anything is created
        run = self._open_run(scene, str(path), path.stem if path.is_file() else path.name)

        def add_to_scene() -> Slices[list[Message]]:
            from ..blend.capture.importing import import_capture

            return import_capture(run, str(path))

        return self._import_job(run, path, arguments, "Adding cameras and mesh", add_to_scene)


class FIPT_OT_use_scene_cameras(_ImportJob, bpy.types.Operator):
    """Use the scene's own cameras as the capture. Each camera needs its photograph as background image"""

    bl_idname = "fipt.use_scene_cameras"
    bl_label = "Use Scene Cameras"
    title = "Use Scene Cameras"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not any(scene_object.type == "CAMERA" for scene_object in context.scene.objects):
            cls.poll_message_set("The scene has no cameras")
            return False
        return super().poll(context)

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend.capture.scene_cameras import SCENE_SOURCE, adopt_cameras, write_scene_cameras
        from ..jobs.options import CaptureOptions, ingest_arguments

        scene = context.scene
        settings = scene.fipt.capture
        machine.engine_python()
        name = bpy.path.display_name_from_filepath(bpy.data.filepath) or scene.name
        run = self._open_run(scene, SCENE_SOURCE, name)
        try:
            path, skipped = write_scene_cameras(scene, run)
        except FiptError:
            self.failed(scene, run)
            raise
        options = CaptureOptions(
            format="transforms",
            up_axis="z",
            hold_back=settings.hold_back,
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

        return self._import_job(run, path, ingest_arguments(options), "Listing the cameras", adopt)


class FIPT_OT_import_mesh(bpy.types.Operator):
    """Import a mesh file as the room, in the coordinates of the capture. The previous room is set aside"""

    bl_idname = "fipt.import_mesh"
    bl_label = "Import Mesh"
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(
        name="Mesh", description="OBJ, PLY, STL, glTF, FBX or USD", subtype="FILE_PATH", options={"SKIP_SAVE"}
    )
    filter_glob: bpy.props.StringProperty(default=_MESH_FILES, options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return in_object_mode(cls, context)

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

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.fipt.capture.room_objects(context.scene):
            cls.poll_message_set("The room has no meshes")
            return False
        return in_object_mode(cls, context)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.room.simplifying import simplify_room

        settings = context.scene.fipt.capture
        before, after = simplify_room(settings.room_objects(context.scene), settings.triangles)
        text = iface_("The room has {:,} triangles, {:,} without simplification")
        self.report({"INFO"}, text.format(after, before))
        return {"FINISHED"}


def _capture_options(settings: FIPT_CaptureSettings) -> CaptureOptions:
    """The import settings of the panel.

    Raises:
        FiptError: ``mesh-missing`` or ``images-missing``.
    """
    from ..jobs.options import CaptureOptions

    mesh = Path(bpy.path.abspath(settings.mesh)).absolute() if settings.mesh else None
    if mesh is not None and not mesh.is_file():
        raise FiptError(
            "mesh-missing",
            f"The mesh {mesh} does not exist.",
            "Select another file as Mesh in Import Settings, or clear the field.",
        )
    images = Path(bpy.path.abspath(settings.images)).absolute() if settings.images else None
    if images is not None and not images.is_dir():
        raise FiptError(
            "images-missing",
            f"The folder {images} does not exist.",
            "Select another folder as Photographs in Import Settings, or clear the field.",
        )
    return CaptureOptions(
        mesh=mesh,
        format=settings.format,
        up_axis=settings.up_axis,
        scale=float(settings.scale),
        hold_back=0 if settings.hold_back < 2 else settings.hold_back,
        images=images,
        clamp_negative=settings.clamp_negative,
        align_mesh=settings.align_mesh,
        plane_room=settings.plane_room,
        dense_stereo=settings.dense_stereo,
        triangles=settings.triangles,
        undo_applied_transform=settings.undo_applied_transform,
    )


CLASSES = (
    FIPT_OT_import_capture,
    FIPT_OT_use_scene_cameras,
    FIPT_OT_import_mesh,
    FIPT_OT_set_room,
    FIPT_OT_simplify_room,
)
