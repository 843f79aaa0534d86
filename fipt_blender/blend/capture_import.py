# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture that `ingest` has read, into the artist's scene: cameras, the mesh, and the list of views.

Cameras and imported mesh hang on the empty "FIPT Alignment", in the coordinates of ingest.json.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ..bridge.process import Message
from ..bridge.step import Slices
from ..core import conventions
from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from ..properties.capture import view_cameras
from . import cameras, mesh_import
from .outliner import CAMERAS, collection, move_to

ALIGNMENT = "FIPT Alignment"
EARLIER_ROOMS = "FIPT Earlier Rooms"
IMPORTED = "fipt_imported"  # of a mesh that we imported: its file and the way to the alignment's space
_CAMERA_SIZE = 0.03  # drawn size of cameras, as a share of the room that they span


def import_capture(run: RunFolder, path: str) -> Slices:
    """Cameras, mesh and list of views of the capture in ingest.json, into the context's scene.

    Cameras of the same names are set anew. Meshes that the artist chose as the room stay the room.

    Args:
        run: with ingest.json.
        path: what the capture was imported from, to tell a new one from the same again.

    Returns:
        Warnings.
    """
    capture = read_json(run.ingest_json)
    same = bpy.context.scene.fipt.capture.imported_path == path
    if not same:
        _remove_cameras(bpy.context.scene, {view["name"] for view in capture["views"]})
    size = _camera_size(capture)
    for index, view in enumerate(capture["views"]):
        scene = bpy.context.scene
        item = cameras.add_camera(scene, run, view, parent=find_alignment(scene))
        item.data.display_size = size
        yield 0.5 * index / len(capture["views"])
    warnings = _import_room(bpy.context.scene, run, capture)
    yield 0.9
    fill_views(bpy.context.scene, run, keep=same)
    bpy.context.scene.fipt.capture.imported_path = path
    return warnings


def fill_views(scene: bpy.types.Scene, run: RunFolder, keep: bool = False) -> None:
    """Fill the list of views from the run's capture and the scene's cameras.

    Args:
        scene: with a camera for each view.
        run: with ingest.json, or with capture.json alone.
        keep: keep ticks and splits of views that are in the list already.
    """
    settings = scene.fipt.capture
    kept = {view.name: (view.enabled, view.split) for view in settings.views} if keep else {}
    path = run.ingest_json if run.ingest_json.exists() else run.capture_json
    settings.views.clear()
    present = view_cameras(scene)
    with settings.counting_later():
        for entry in read_json(path)["views"]:
            view = settings.views.add()
            view.name = entry["name"]
            view.camera = present[view.name].name
            view.image = str(run.resolve(entry["image"]))
            view.enabled, view.split = kept.get(view.name, (True, entry["split"]))
    settings.unseen_share = -1.0
    settings.count_views()


def find_alignment(scene: bpy.types.Scene) -> bpy.types.Object:
    """The empty that carries the capture; made where it is missing."""
    settings = scene.fipt.capture
    item = settings.alignment
    if item is None or item.name not in scene.objects:
        item = bpy.data.objects.new(ALIGNMENT, None)
        item.empty_display_type = "ARROWS"
        scene.collection.objects.link(item)
        settings.alignment = item
    return item


def source_matrix(scene: bpy.types.Scene, run: RunFolder | None) -> np.ndarray:
    """4x4 from the coordinates of the capture's mesh to those of the alignment empty."""
    if run is not None and run.ingest_json.exists():
        return np.array(read_json(run.ingest_json)["world_from_source"], np.float64)
    settings = scene.fipt.capture
    up_axis = "z" if settings.up_axis == "auto" else settings.up_axis
    return conventions.world_from_source(up_axis, settings.scale)


def import_mesh(scene: bpy.types.Scene, path: Path, matrix: np.ndarray) -> list[str]:
    """Import a mesh file as the room, under the alignment; meshes imported before are set aside, hidden.

    Args:
        scene: where it goes.
        path: see `mesh_import.import_room`.
        matrix: 4x4 from the file's coordinates to the alignment's.

    Returns:
        Names of the objects.

    Raises:
        FiptError: those of `mesh_import.import_room`; nothing has changed then.
    """
    before = [item for item in scene.fipt.capture.room_objects(scene) if IMPORTED in item]
    names = mesh_import.import_room(path, matrix, scene)
    if before:
        aside = collection(scene, EARLIER_ROOMS)
        aside.hide_viewport = aside.hide_render = True
        for item in before:
            move_to(item, aside)
    parent = find_alignment(scene)
    for name in names:
        item = scene.objects[name]
        item.parent, item.matrix_parent_inverse = parent, Matrix.Identity(4)
        item.matrix_basis = Matrix.Identity(4)
        item[IMPORTED] = _origin(path, matrix)
    scene.fipt.capture.room = None  # FIPT Room, where the import put it
    return names


def set_room(scene: bpy.types.Scene, objects: list[bpy.types.Object]) -> None:
    """Make exactly these objects the room: they are linked to "FIPT Room" too, and otherwise left alone."""
    room = collection(scene, mesh_import.ROOM)
    for item in list(room.objects):
        if item not in objects:
            if len(item.users_collection) == 1:
                scene.collection.objects.link(item)
            room.objects.unlink(item)
    for item in objects:
        if item.name not in room.objects:
            room.objects.link(item)
    scene.fipt.capture.room = None


def _import_room(scene: bpy.types.Scene, run: RunFolder, capture: dict[str, Any]) -> list[Message]:
    """The capture's mesh, unless it is there already or the artist chose other objects."""
    present = scene.fipt.capture.room_objects(scene)
    if not capture["mesh"]:
        if present:
            return []
        text = "No mesh of the room lies beside the cameras."
        return [_warning("mesh-missing", text, "Import one, or select the room's meshes and choose them.")]
    path, matrix = run.resolve(capture["mesh"]), np.array(capture["world_from_source"], np.float64)
    imported = [item for item in present if IMPORTED in item]
    if any(item[IMPORTED] == _origin(path, matrix) for item in imported):
        return []
    if len(imported) < len(present):
        text = f"The room stays the {len(present)} meshes chosen before; {path.name} was not imported."
        return [_warning("mesh-kept", text, "Use Import Mesh to take that one instead.")]
    import_mesh(scene, path, matrix)
    return []


def _origin(path: Path, matrix: np.ndarray) -> str:
    return json.dumps([str(path), np.asarray(matrix).round(9).tolist()])


def _remove_cameras(scene: bpy.types.Scene, keep: set[str]) -> None:
    """Remove the cameras of an earlier capture that we made."""
    for item in list(collection(scene, CAMERAS).objects):
        if item.type == "CAMERA" and cameras.VIEW in item and item[cameras.VIEW] not in keep:
            data = item.data
            bpy.data.objects.remove(item)
            if not data.users:
                bpy.data.cameras.remove(data)


def _camera_size(capture: dict[str, Any]) -> float:
    """Metres, so that the cameras of a small room do not fill it."""
    places = np.array([np.array(view["camera_to_world"])[:3, 3] for view in capture["views"]])
    return float(np.clip(_CAMERA_SIZE * np.linalg.norm(np.ptp(places, axis=0)), 1e-3, 1.0)) or 0.1


def _warning(code: str, text: str, remedy: str) -> Message:
    return {"type": "warning", "code": code, "text": text, "remedy": remedy}


def room_missing() -> FiptError:
    """The error where nothing is chosen as the room."""
    return FiptError(
        "room-missing",
        "No meshes are chosen as the room.",
        "Import the room's mesh, or select its objects and press Set from Selection.",
    )
