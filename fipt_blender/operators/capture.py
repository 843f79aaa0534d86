# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture: import cameras, photographs and the room's mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import importing
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs import running
from ..jobs.tasks import Task
from .action import action, file_dialog, note
from .polls import has_meshes, in_object_mode, needs, no_job
from .reporting import Messages

_MESH_FILES = "*.obj;*.ply;*.stl;*.gltf;*.glb;*.fbx;*.usd;*.usdc;*.usda;*.usdz"


@action("Import Capture", needs=(in_object_mode, no_job))
def import_capture(
    scene: bpy.types.Scene,
    filepath: Annotated[
        str,
        Option(
            "Folder or camera file of the capture. If empty, the path in the panel is used",
            "Capture",
            shown={"subtype": "FILE_PATH"},
        ),
    ] = "",
) -> Task:
    """Read and check the photographs and cameras, and add the cameras and the room's mesh to the scene."""
    if filepath:
        scene.fipt.capture.path = filepath
    return importing.capture_import()


@action(
    "Use Scene Cameras",
    needs=(
        needs(
            lambda context: any(item.type == "CAMERA" for item in context.scene.objects),
            "The scene has no cameras",
        ),
        in_object_mode,
        no_job,
    ),
)
def use_scene_cameras(scene: bpy.types.Scene) -> Task:
    """Use the scene's own cameras as the capture. Each camera needs its photograph as background image."""
    return importing.scene_cameras_import()


@action("Place at 3D Cursor")
def place_panorama(scene: bpy.types.Scene) -> None:
    """Take the 3D Cursor as the place of the panorama, for the next import."""
    settings, place = scene.fipt.capture, scene.cursor.location
    if settings.alignment is not None:
        place = settings.alignment.matrix_world.inverted_safe() @ place
    settings.panorama_place = place


@action("Import Mesh", needs=(in_object_mode,), invoke=file_dialog)
def import_mesh(
    scene: bpy.types.Scene,
    filepath: Annotated[
        str, Option("OBJ, PLY, STL, glTF, FBX or USD", "Mesh", shown={"subtype": "FILE_PATH"})
    ] = "",
    filter_glob: Annotated[str, Option("Files to show", shown={"options": {"HIDDEN"}})] = _MESH_FILES,
) -> str:
    """Import a mesh file as the room, in the coordinates of the capture. The previous room is set aside."""
    from ..blend.capture import importing

    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder)) if scene.fipt.run_folder else None
    path = Path(bpy.path.abspath(filepath or scene.fipt.capture.mesh))
    names = importing.import_mesh(scene, path, importing.source_matrix(scene, run))
    running.settle("capture", "mesh-missing")
    return _meshes(len(names))


def _meshes(count: int) -> str:
    return iface_("The room consists of {} meshes").format(count)


@action("Hide Start-up Objects")
def hide_startup_objects(
    scene: bpy.types.Scene, hide: Annotated[bool, "Hide the objects or show them again"] = True
) -> str:
    """Hide the cube, the light and the camera of Blender's start-up file, if they are as they were there, or
    show them again. Import Capture hides them.
    """
    from ..blend.capture import startup

    return ", ".join(startup.hide_startup_objects(scene, hide)) or iface_("There are none")


@action("Set Room from Selection")
def set_room(
    context: bpy.types.Context,
    collection: Annotated[
        str, "Collection whose meshes are the room. If empty, the selected objects are used"
    ] = "",
) -> Messages:
    """Use the selected meshes as the room. They keep their places and their collections."""
    from ..blend.capture import importing

    settings = context.scene.fipt.capture
    if collection:
        room = bpy.data.collections.get(collection)
        if room is None or not any(member.type == "MESH" for member in room.all_objects):
            text = f"There is no collection '{collection}' with meshes."
            raise FiptError("room-missing", text, "Name another one.")
        settings.room = room
        left_out = importing.not_in_room(room.all_objects)
    else:
        selected = context.view_layer.objects.selected
        left_out = importing.not_in_room(selected)
        meshes = [item for item in selected if item.type == "MESH"]
        if not meshes:
            advice = [f"{each['text']} {each['remedy']}" for each in left_out]
            remedy = " ".join(advice) or "Select the objects that form the room."
            raise FiptError("room-missing", "No mesh objects are selected.", remedy)
        importing.set_room(context.scene, meshes)
    running.settle("capture", "mesh-missing")
    return [note(_meshes(len(settings.room_objects(context.scene)))), *left_out]


@action("Simplify Room", needs=(has_meshes, in_object_mode))
def simplify_room(scene: bpy.types.Scene) -> str:
    """Decimate the room's larger meshes to the number of triangles, by modifiers. 0 removes these."""
    from ..blend.room import simplifying

    settings = scene.fipt.capture
    before, after = simplifying.simplify_room(settings.room_objects(scene), settings.triangles)
    return iface_("The room has {:,} triangles, {:,} without simplification").format(after, before)
