# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture: cameras, photographs and the room's mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import preferences
from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder
from .job_operator import JobOperator
from .polls import in_object_mode

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, StepFunction

_MESH_FILES = "*.obj;*.ply;*.stl;*.gltf;*.glb;*.fbx;*.usd;*.usdc;*.usda;*.usdz"


class _ImportJob(JobOperator):
    """What both ways to a capture share: a run folder for it, given back where the import fails."""

    kind = "capture"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return in_object_mode(cls, context) and super().poll(context)

    @staticmethod
    def failed(scene: bpy.types.Scene, run: RunFolder) -> None:
        """The run that the scene had before is its run again."""
        import shutil

        before = scene.fipt.capture.previous_run
        if before and before != scene.fipt.run_folder:
            scene.fipt.run_folder = before
            shutil.rmtree(run.root, ignore_errors=True)

    @staticmethod
    def _open_run(scene: bpy.types.Scene, source: str, name: str) -> RunFolder:
        """The scene's run folder, or a new one where that holds another capture."""
        from ..core.job.settings import make_settings

        settings, before = scene.fipt.capture, scene.fipt.run_folder
        settings.previous_run = before
        run = RunFolder(bpy.path.abspath(before)) if before else None
        if run is None or (run.capture_json.exists() and settings.imported_path != source):
            run = RunFolder(preferences.new_run_folder(name))
        if not run.run_json.exists():
            run.create(make_settings())
        scene.fipt.run_folder = str(run.root)
        return run

    @staticmethod
    def _import_job(
        run: RunFolder, path: Path, arguments: list[str], text: str, bring_in: StepFunction
    ) -> Job:
        """Let the engine read a capture, then bring it into the scene."""
        from ..bridge.step import Step
        from ..runjob import open_job

        steps = [
            Step(
                "ingest",
                "Reading and checking the photographs",
                20.0,
                command=["ingest", str(path), str(run.root), *arguments],
                outputs=[run.ingest_json],
            ),
            Step("import", text, 5.0, function=bring_in, repeat=True),
        ]
        return open_job(run, steps, record="import.json")


class FIPT_OT_import_capture(_ImportJob, bpy.types.Operator):
    """Read photographs and their cameras, check them, and add the cameras and the room's mesh to the scene"""

    bl_idname = "fipt.import_capture"
    bl_label = "Import Capture"
    title = "Importing the capture"

    filepath: bpy.props.StringProperty(
        name="Capture",
        description="The capture's folder or camera file; empty takes the one of the panel",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        scene = context.scene
        if self.filepath:
            scene.fipt.capture.path = self.filepath
        settings = scene.fipt.capture
        if not settings.path:
            raise FiptError(
                "capture-missing", "No capture is named.", "Choose its folder or camera file in the panel."
            )
        path = Path(bpy.path.abspath(settings.path)).absolute()
        if not path.exists():
            raise FiptError(
                "capture-missing",
                f"The capture {path} does not exist.",
                "Choose the folder that holds the cameras, or the camera file itself.",
            )
        # A model's own file stands for its folder; only transforms.json is a capture by itself.
        if path.is_file() and path.suffix.lower() != ".json":
            path = path.parent
        arguments = _ingest_arguments(settings)
        preferences.engine_python()  # before anything is made
        run = self._open_run(scene, str(path), path.stem if path.is_file() else path.name)

        def bring_in() -> Slices:
            from ..blend.capture_import import import_capture

            return import_capture(run, str(path))

        return self._import_job(run, path, arguments, "Adding cameras and mesh", bring_in)


class FIPT_OT_use_scene_cameras(_ImportJob, bpy.types.Operator):
    """Take the scene's own cameras, each with its HDR photograph as background image, as the capture"""

    bl_idname = "fipt.use_scene_cameras"
    bl_label = "Use Scene Cameras"
    title = "Reading the scene's cameras"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not any(item.type == "CAMERA" for item in context.scene.objects):
            cls.poll_message_set("The scene has no cameras")
            return False
        return super().poll(context)

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend.scene_cameras import SCENE_SOURCE, adopt_cameras, write_scene_cameras

        scene = context.scene
        settings = scene.fipt.capture
        preferences.engine_python()
        name = bpy.path.display_name_from_filepath(bpy.data.filepath) or scene.name
        run = self._open_run(scene, SCENE_SOURCE, name)
        try:
            path, left_out = write_scene_cameras(scene, run)
        except FiptError:
            self.failed(scene, run)
            raise
        arguments = ["--format=transforms", "--up-axis=z", f"--hold-back={settings.hold_back}"]
        if settings.clamp_negative:
            arguments.append("--clamp-negative")

        def adopt() -> list[Message]:
            adopt_cameras(run)
            if not left_out:
                return []
            text = f"{len(left_out)} cameras without a photograph were left out: {', '.join(left_out[:5])}."
            remedy = "Give them a background image to use them too."
            return [{"type": "warning", "code": "cameras-left-out", "text": text, "remedy": remedy}]

        return self._import_job(run, path, arguments, "Listing the cameras", adopt)


class FIPT_OT_import_mesh(bpy.types.Operator):
    """Import a mesh file as the room, in the coordinates of the capture; an earlier one is set aside"""

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

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend import capture_import

        scene = context.scene
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder)) if scene.fipt.run_folder else None
        path = self.filepath or scene.fipt.capture.mesh
        try:
            matrix = capture_import.source_matrix(scene, run)
            names = capture_import.import_mesh(scene, Path(bpy.path.abspath(path)), matrix)
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, iface_("{} meshes form the room").format(len(names)))
        return {"FINISHED"}


class FIPT_OT_set_room(bpy.types.Operator):
    """Make the selected meshes the room; they stay where they are, also in their collections"""

    bl_idname = "fipt.set_room"
    bl_label = "Set Room from Selection"
    bl_options = {"REGISTER", "UNDO"}

    collection: bpy.props.StringProperty(
        name="Collection",
        description="A collection whose meshes are the room; empty takes the selected objects",
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture_import import set_room

        scene = context.scene
        if self.collection:
            room = bpy.data.collections.get(self.collection)
            if room is None or not any(item.type == "MESH" for item in room.all_objects):
                self.report({"ERROR"}, f"'{self.collection}' is no collection with meshes. Choose another.")
                return {"CANCELLED"}
            scene.fipt.capture.room = room
        else:
            meshes = [item for item in context.view_layer.objects.selected if item.type == "MESH"]
            if not meshes:
                self.report({"ERROR"}, "No meshes are selected. Select the objects that form the room.")
                return {"CANCELLED"}
            set_room(scene, meshes)
        count = len(scene.fipt.capture.room_objects(scene))
        self.report({"INFO"}, iface_("{} meshes form the room").format(count))
        return {"FINISHED"}


def _ingest_arguments(settings: bpy.types.PropertyGroup) -> list[str]:
    """The panel's choices as arguments, one word each: "-y" alone would be taken for an option.

    Raises:
        FiptError: ``mesh-missing`` or ``images-missing``.
    """
    arguments = [
        f"--format={settings.format}",
        f"--up-axis={settings.up_axis}",
        f"--scale={float(settings.scale)!r}",
        f"--hold-back={0 if settings.hold_back < 2 else settings.hold_back}",
    ]
    if settings.mesh:
        mesh = Path(bpy.path.abspath(settings.mesh)).absolute()
        if not mesh.is_file():
            raise FiptError("mesh-missing", f"The mesh {mesh} does not exist.", "Choose another, or none.")
        arguments.append(f"--mesh={mesh}")
    if settings.images:
        images = Path(bpy.path.abspath(settings.images)).absolute()
        if not images.is_dir():
            raise FiptError(
                "images-missing", f"The folder {images} does not exist.", "Choose another, or leave it empty."
            )
        arguments.append(f"--images={images}")
    if settings.clamp_negative:
        arguments.append("--clamp-negative")
    if settings.undo_applied_transform:
        arguments.append("--undo-applied-transform")
    return arguments


CLASSES = (FIPT_OT_import_capture, FIPT_OT_use_scene_cameras, FIPT_OT_import_mesh, FIPT_OT_set_room)
