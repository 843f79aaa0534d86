"""Imports a capture that `ingest` has read into the artist's scene: cameras, the mesh, the list of views.

Cameras and the imported mesh are children of the empty "FIPT Alignment", in the coordinates of ingest.json.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...bridge.process import Message
from ...bridge.step import Slices
from ...core import conventions
from ...core.run.contents import CapturedViews, UpAxis
from ...core.run.errors import FiptError, warning
from ...core.run.run_files import read_capture
from ...core.run.runfolder import RunFolder
from ..image_datablocks import remove_unused_images
from ..marks import IMPORTED, MADE, VIEW, has_results, is_imported, is_view, view_cameras, was_found
from ..outliner import CAMERAS, EARLIER_ROOMS, ROOM, TREE, collection, move_to, remove_object
from ..room.mesh_digest import is_edited, sign
from ..room.result_meshes import list_names
from . import cameras, mesh_import
from .cameras import world_matrix
from .facing import face_cameras
from .look import stand_in_photograph
from .startup import hide_startup_objects

ALIGNMENT = "FIPT Alignment"
# Types of objects with surfaces besides meshes.
_SHAPES = ("CURVE", "SURFACE", "META", "FONT", "CURVES")


def import_capture(run: RunFolder, path: str) -> Slices[list[Message]]:
    """Cameras, mesh and list of views of the capture in ingest.json, into the context's scene.

    Cameras of the same views are updated. Meshes that the artist chose as the room stay the room.

    Args:
        run: with ingest.json.
        path: where the capture was imported from; the same path again keeps ticks and splits.

    Returns:
        Warnings.
    """
    capture = read_capture(run.ingest_json)
    is_reimport = bpy.context.scene.fipt.capture.imported_path == path
    others: list[Message] = []
    if not is_reimport:
        hide_startup_objects(bpy.context.scene)
        others = _objects_beside(bpy.context.scene)
        _remove_cameras(bpy.context.scene, {view.name for view in capture.views})
    size = cameras.display_size(capture)
    for index, view in enumerate(capture.views):
        scene = bpy.context.scene
        item = cameras.add_camera(scene, run, view, parent=find_alignment(scene))
        item.data.display_size = size
        yield 0.5 * index / len(capture.views)
    warnings = _import_room(bpy.context.scene, run, capture)
    _note_up(bpy.context.scene.fipt.capture, capture.up, is_reimport)
    yield 0.9
    fill_views(bpy.context.scene, run, keep=is_reimport)
    bpy.context.scene.fipt.capture.imported_path = path
    if not is_reimport and not bpy.app.background:
        stand_in_photograph(bpy.context.scene, bpy.context)
    return warnings + others


def fill_views(scene: bpy.types.Scene, run: RunFolder, keep: bool = False) -> None:
    """Fill the list of views from the run's capture and the scene's cameras.

    Args:
        scene: with a camera for each view.
        run: with ingest.json.
        keep: keep ticks and splits of views that the list has already.
    """
    settings = scene.fipt.capture
    kept = {view.name: (view.enabled, view.split) for view in settings.views} if keep else {}
    settings.views.clear()
    present = view_cameras(scene)
    with settings.counting_later():
        for entry in read_capture(run.ingest_json).views:
            view = settings.views.add()
            view.name = entry.name
            view.camera = present[view.name].name
            view.image = str(run.resolve(entry.image))
            view.enabled, view.split = kept.get(view.name, (True, entry.split))
    settings.unseen_share = -1.0
    settings.count_views()


def find_alignment(scene: bpy.types.Scene) -> bpy.types.Object:
    """The empty that is the parent of the capture; made if it is missing."""
    settings = scene.fipt.capture
    item = settings.alignment
    if item is None or item.name not in scene.objects:
        item = bpy.data.objects.new(ALIGNMENT, None)
        item.empty_display_type = "ARROWS"
        collection(scene, TREE).objects.link(item)
        settings.alignment = item
    return item


def _note_up(settings: bpy.types.PropertyGroup, up: UpAxis | None, is_reimport: bool) -> None:
    """Remember what ingest.json says of the up axis, and turn it up unless the alignment knows it already."""
    before, settings.imported_up = settings.imported_up, ""
    if up is None:
        return
    settings.imported_up, settings.up_source, settings.up_angle = up.axis, up.source, up.angle
    if not is_reimport or before not in ("", up.axis):
        settings.up = up.axis


def up_axis(settings: bpy.types.PropertyGroup) -> str:
    """The capture's axis that is nearest to up in the scene, with the present rotation of the alignment."""
    imported = conventions.world_from_source(settings.imported_up or "z")[:3, :3]
    up = imported[2] if settings.alignment is None else world_matrix(settings.alignment)[2, :3] @ imported
    return max(conventions.UP_AXES, key=lambda axis: float(up @ conventions.world_from_source(axis)[2, :3]))


def turn_up(settings: bpy.types.PropertyGroup, axis: str) -> None:
    """Rotate the alignment, so that the scene becomes what importing with another up axis makes of it."""
    imported = conventions.world_from_source(settings.imported_up or "z")
    present, wanted = (conventions.world_from_source(each) for each in (up_axis(settings), axis))
    if settings.alignment is not None and not np.array_equal(present, wanted):
        settings.alignment.matrix_basis @= Matrix(imported @ present.T @ wanted @ imported.T)


def source_matrix(scene: bpy.types.Scene, run: RunFolder | None) -> np.ndarray:
    """4x4 from the coordinates of the capture's mesh to those of the alignment empty.

    Args:
        scene: whose import settings count where nothing was imported yet.
        run: with ingest.json after an import.
    """
    if run is not None and run.ingest_json.exists():
        return np.array(read_capture(run.ingest_json).world_from_source)
    settings = scene.fipt.capture
    up_axis = "z" if settings.up_axis == "auto" else settings.up_axis
    return conventions.world_from_source(up_axis, settings.scale)


def import_mesh(scene: bpy.types.Scene, path: Path, matrix: np.ndarray) -> list[str]:
    """Import a mesh file as the room, below the alignment.

    An earlier import of the same file that the artist has not changed is replaced; others go to a hidden
    collection.

    Args:
        scene: the scene to import into.
        path: see `mesh_import.import_room`.
        matrix: 4x4 from the file's coordinates to the alignment's.

    Returns:
        Names of the objects.
    """
    present = scene.fipt.capture.room_objects(scene)
    earlier = [item for item in present if is_imported(item) or was_found(item)]
    replaced = [item for item in earlier if _is_untouched(item, path)]
    earlier = [item for item in earlier if item not in replaced]
    before = _rename_aside(replaced)
    try:
        names = mesh_import.import_room(path, matrix, scene)
    except FiptError:
        for block, name in before.items():
            block.name = name
        raise
    _take_places(replaced, before, names)
    if earlier:
        hidden = collection(scene, EARLIER_ROOMS)
        hidden.hide_viewport = hidden.hide_render = True
        for item in earlier:
            move_to(item, hidden)
    parent = find_alignment(scene)
    for name in names:
        item = scene.objects[name]
        item.parent, item.matrix_parent_inverse = parent, Matrix.Identity(4)
        item.matrix_basis = Matrix.Identity(4)
        item[IMPORTED] = _origin(path, matrix)
    face_cameras(scene, [scene.objects[name] for name in names])
    for name in names:
        sign(scene.objects[name].data)
    scene.fipt.capture.room = None  # the default, where the import put it
    scene.fipt.capture.completed = False
    return names


def _is_untouched(item: bpy.types.Object, path: Path) -> bool:
    """Whether an object of the room is an import of this file as it was made."""
    if not is_imported(item) or json.loads(item[IMPORTED])[0] != str(path) or has_results(item):
        return False
    more = (item.modifiers, item.children, item.constraints, item.vertex_groups)
    if any(map(len, more)) or item.animation_data is not None or item.data.users > 1:
        return False
    if item.matrix_basis != Matrix.Identity(4):
        return False
    return MADE in item.data and not is_edited(item.data)


def _rename_aside(items: Sequence[bpy.types.Object]) -> dict[bpy.types.ID, str]:
    """Give objects with their meshes and materials other names, so that new ones get theirs; their names."""
    materials = (slot.material for item in items for slot in item.material_slots)
    blocks = [*items, *(item.data for item in items), *(each for each in materials if each is not None)]
    names = {block: block.name for block in blocks if block.library is None}
    for number, block in enumerate(names):
        block.name = f"~{number}"
    return names


def _take_places(
    replaced: Sequence[bpy.types.Object], before: Mapping[bpy.types.ID, str], names: Sequence[str]
) -> None:
    """Put new objects in the place of those imported before, which are removed; their materials stay.

    Args:
        replaced: the objects.
        before: the names of these, their meshes and materials.
        names: of the new objects.
    """
    new = {name: bpy.data.objects[name] for name in names}
    for item in replaced:
        for each in item.users_collection:
            each.objects.unlink(item)
        if before[item] in new:
            item.user_remap(new[before[item]])  # hints, constraints and drivers that refer to it
    materials = {block: name for block, name in before.items() if isinstance(block, bpy.types.Material)}
    for item in replaced:
        remove_object(item)
    used = {slot.material for item in new.values() for slot in item.material_slots}
    duplicates = []
    for material, name in materials.items():
        duplicate = bpy.data.materials.get(name)
        if duplicate in used:
            duplicate.user_remap(material)
            duplicates.append(duplicate)
    trees = [each.node_tree for each in duplicates if each.node_tree is not None]
    nodes = [node for tree in trees for node in tree.nodes if node.bl_idname == "ShaderNodeTexImage"]
    images = {node.image for node in nodes if node.image is not None}
    bpy.data.batch_remove(duplicates)
    remove_unused_images(images)
    for material, name in materials.items():
        material.name = name


def set_room(scene: bpy.types.Scene, objects: list[bpy.types.Object]) -> None:
    """Make exactly these objects the room: they are also linked to its collection, else unchanged."""
    room = collection(scene, ROOM)
    for item in list(room.objects):
        if item not in objects:
            if len(item.users_collection) == 1:
                scene.collection.objects.link(item)
            room.objects.unlink(item)
    for item in objects:
        if item.name not in room.objects:
            room.objects.link(item)
    scene.fipt.capture.room = None


def _import_room(scene: bpy.types.Scene, run: RunFolder, capture: CapturedViews) -> list[Message]:
    """Import the capture's mesh, unless it is there already or the artist chose other objects."""
    present = scene.fipt.capture.room_objects(scene)
    if not capture.mesh:
        if present:
            return []
        text = "No mesh of the room was found beside the cameras."
        return [warning("mesh-missing.import-room", text=text)]
    path, matrix = run.resolve(capture.mesh), np.array(capture.world_from_source)
    imported = [item for item in present if is_imported(item)]
    if any(item[IMPORTED] == _origin(path, matrix) for item in imported):
        return []
    if len(imported) < len(present):
        text = f"The room is still the {len(present)} meshes chosen before; {path.name} was not imported."
        return [warning("mesh-kept", text=text)]
    import_mesh(scene, path, matrix)
    return []


def _objects_beside(scene: bpy.types.Scene) -> list[Message]:
    """A warning about what is rendered and is not the room, such as the cube of a new file."""
    room = scene.fipt.capture.room_objects(scene)
    names = [
        item.name
        for item in scene.objects
        if item.type in (*_SHAPES, "MESH") and not item.hide_render and item not in room
    ]
    if not names:
        return []
    return [warning("objects-beside", names=list_names(names))]


def _origin(path: Path, matrix: np.ndarray) -> str:
    """Value of the mark `IMPORTED`."""
    return json.dumps([str(path), np.asarray(matrix).round(9).tolist()])


def _remove_cameras(scene: bpy.types.Scene, keep: set[str]) -> None:
    """Remove the cameras that an earlier import made, except those of some views."""
    for item in list(collection(scene, CAMERAS).objects):
        if is_view(item) and item[VIEW] not in keep:
            remove_object(item)


def not_in_room(objects: Iterable[bpy.types.Object]) -> list[Message]:
    """Warnings about objects that render surfaces, but are no part of a room that consists of meshes."""
    instances, shapes = [], []
    for item in objects:
        if item.instance_type == "COLLECTION" and item.instance_collection is not None:
            instances.append(item.name)
        elif item.type in _SHAPES:
            shapes.append(item.name)
    warnings = []
    if instances:
        kinds = _plural(instances, "collection instance")
        warnings.append(warning("instances-left-out", kinds=kinds, names=list_names(instances)))
    if shapes:
        kinds = _plural(shapes, "curve, text or metaball object")
        warnings.append(warning("shapes-left-out", kinds=kinds, names=list_names(shapes)))
    return warnings


def _plural(names: Sequence[str], noun: str) -> str:
    return f"{len(names)} {noun}{'s' if len(names) > 1 else ''}"


def room_missing() -> FiptError:
    """The error for a scene without a room."""
    return FiptError("room-missing.room-missing")
