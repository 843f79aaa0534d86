"""Removes furniture from the room: hides it, and completes the planes and materials that it has hidden.

The hidden objects stay in the file, faces of a larger mesh as an object of their own. What is completed
consists of new objects with materials of the parts beside it, whose adjustments and replacements they share.
Light needs nothing: shadows, reflections and the light of removed lamps are rendered.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..collecting import check_pictures
from ..color_spaces import from_scene_linear
from ..image_datablocks import save_values
from ..marks import (
    FILLED,
    MAP,
    PART_NAME,
    REMOVED,
    filled_surfaces,
    fixtures_of,
    has_results,
    is_fixture,
    room_with_results,
)
from ..node_trees import node_tree
from ..outliner import EMPTIED, collection, remove_if_empty, remove_object
from ..own_materials import own_materials
from ..room.mesh_arrays import (
    corner_vertices,
    polygon_sizes,
    polygon_starts,
    remove_polygons,
    transform_points,
    world_positions,
)
from ..room.originals import shows_original
from ..room.uv_layer import write_layer
from ..texture_files import TextureFiles, texture_files, written_picture
from .completion import complete
from .hidden_surfaces import Room, Window, planes_beside, window_of
from .maps import show
from .materials import MAPS, remove_unused, result_materials
from .replacing import fill_slots

# What is completed lies so far in front of surfaces that no photograph saw, metres: less than is seen, more
# than the rays of a render confuse.
LIFT = 0.002
_NEAR_LAMP = 0.03  # metres around what is removed within which a lamp belongs to it
_LEAST_KNOWN = 50  # cells of a part from which it is completed: about those of a patch

Chosen = dict[bpy.types.Object, np.ndarray | None]  # objects with (P,) bool of their faces, None for all


def selected_faces(item: bpy.types.Object) -> np.ndarray:
    """(P,) bool, the selected faces of an object in Object Mode."""
    selected = np.zeros(len(item.data.polygons), bool)
    item.data.polygons.foreach_get("select", selected)
    return selected


def faces_in_box(scene: bpy.types.Scene, box: bpy.types.Object) -> Chosen:
    """The faces of the room that lie in the cube of an empty."""
    inverse = np.linalg.inv(np.array(box.matrix_world, np.float64))
    found = Chosen()
    for item in _shown_room(scene):
        points = transform_points(world_positions(item), inverse)
        inside = (np.abs(points) <= box.empty_display_size).all(axis=1)[corner_vertices(item.data)]
        faces = np.logical_and.reduceat(inside, polygon_starts(item.data))
        if faces.any():
            found[item] = faces
    return found


def remove(scene: bpy.types.Scene, run: RunFolder, chosen: Chosen) -> tuple[list[str], list[str]]:
    """Hide objects of the room, or some of their faces, and complete what they have hidden.

    Args:
        scene: its results are shown, in Object Mode.
        run: whose results they are.
        chosen: objects with result meshes, and fixtures; others are skipped.

    Returns:
        Names of the objects that are hidden, and of those that complete what was behind them.
    """
    chosen = {item: faces for item, faces in chosen.items() if _can_be_removed(item, faces)}
    if not chosen:
        text = "Nothing of the room's results is selected."
        raise FiptError("removal-empty", text=text)
    if scene.fipt.materials.applied_mode != "uv":
        text = "The results are color attributes, which can't be completed."
        raise FiptError("removal-attributes", text=text)
    check_pictures()
    own_materials(scene)
    points = np.concatenate([_points(item, faces) for item, faces in chosen.items()])
    removed = [item if faces is None else _separated(item, faces) for item, faces in chosen.items()]
    low, high = points.min(axis=0) - _NEAR_LAMP, points.max(axis=0) + _NEAR_LAMP
    lamps = [(item, _points(item, None)) for item in fixtures_of(scene) if item not in removed]
    removed += [item for item, place in lamps if ((place >= low) & (place <= high)).all()]
    number = 1 + max(int(item.get(REMOVED, 0)) for item in scene.objects)
    for item in removed:
        for each in (item, *(item.children if is_fixture(item) else ())):
            each[REMOVED] = number
            each.hide_viewport = each.hide_render = True
    hidden, staying = [item.name for item in removed], [*_shown_room(scene), *filled_surfaces(scene)]
    if not staying:
        return hidden, []
    try:
        room = Room(staying)
        planes = planes_beside(room, points)
        windows = [window_of(room, plane, planes, points) for plane in planes]
        made = [_surface(scene, run, room, window, number) for window in windows if window is not None]
    except BaseException:
        bring_back(scene, removed)
        raise
    if scene.fipt.materials.shown != "ESTIMATED":
        show(scene, scene.fipt.materials.shown)
    return hidden, [item.name for item in made if item is not None]


def bring_back(scene: bpy.types.Scene, chosen: Collection[bpy.types.Object] = ()) -> int:
    """Show removed objects again, and remove what stands for what they hide; returns how many are back.

    Args:
        scene: of the removals.
        chosen: objects of the removals to take back; all removals where none of them is one's.
    """
    numbers = {int(item.get(REMOVED, item.get(FILLED, 0))) for item in chosen} - {0}
    surfaces = [item for item in filled_surfaces(scene) if not numbers or item[FILLED] in numbers]
    hidden = [item for item in scene.objects if REMOVED in item]
    hidden = [item for item in hidden if not numbers or item[REMOVED] in numbers]
    materials = result_materials([item.data for item in surfaces])
    for item in surfaces:
        remove_object(item)
    remove_unused(materials)
    for item in hidden:
        del item[REMOVED]
        item.hide_viewport = item.hide_render = False
    remove_if_empty(scene, EMPTIED)
    return len(hidden)


def _shown_room(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects that show results and are rendered."""
    room = [item for item in room_with_results(scene) if not shows_original(item) and not item.hide_render]
    return [item for item in room if len(item.data.polygons)]


def _can_be_removed(item: bpy.types.Object, faces: np.ndarray | None) -> bool:
    ours = is_fixture(item) or (has_results(item) and not shows_original(item) and len(item.data.polygons))
    return bool(ours) and REMOVED not in item and (faces is None or bool(faces.any()))


def _points(item: bpy.types.Object, faces: np.ndarray | None) -> np.ndarray:
    """(N, 3) corners of an object's faces in the world."""
    corners = corner_vertices(item.data)
    if faces is not None:
        corners = corners[np.repeat(faces, polygon_sizes(item.data))]
    return world_positions(item)[np.unique(corners)]


def _separated(item: bpy.types.Object, faces: np.ndarray) -> bpy.types.Object:
    """The object with the chosen faces (P,) bool alone: a new one, unless all of its faces are chosen."""
    if faces.all():
        return item
    if item.data.users > 1:  # a linked duplicate keeps its faces
        item.data = item.data.copy()
    part = item.copy()
    part.data = item.data.copy()
    for each, unwanted in ((part, ~faces), (item, faces)):
        remove_polygons(each.data, unwanted)
    for target in item.users_collection:
        target.objects.link(part)
    return part


def _surface(
    scene: bpy.types.Scene, run: RunFolder, room: Room, window: Window, number: int
) -> bpy.types.Object | None:
    """A new object that completes a window's plane; None where nothing beside it is known."""
    values, slot = _completed(room, window)
    used = np.unique(slot[slot >= 0]).tolist()
    if not used:
        return None
    files = _written(scene, run, values)
    images = {label: files.load(_path(key), is_data) for key, (label, is_data) in MAPS.items()}
    for label, image in images.items():
        image.name = f"FIPT Emptied {number} {label}"
    # A face for each run of cells of one part in a row.
    padded = np.pad(slot, ((0, 0), (1, 1)), constant_values=-1)
    changed = padded[:, 1:] != padded[:, :-1]
    row, left = np.nonzero(changed & (padded[:, 1:] >= 0))
    _, right = np.nonzero(changed & (padded[:, :-1] >= 0))
    corners = np.stack([left, row, right, row, right, row + 1, left, row + 1], axis=1).reshape(-1, 2)
    material = np.searchsorted(used, slot[row, left]).astype(np.int32)
    heights = np.array([np.median(window.height[window.slot == index]) for index in used])
    flat = np.column_stack([corners * window.size, np.repeat(heights[material], 4)])
    mesh = bpy.data.meshes.new("Emptied")
    mesh.from_pydata(flat.tolist(), [], np.arange(len(corners)).reshape(-1, 4).tolist())
    write_layer(mesh, corners / np.array(slot.shape[::-1]))
    fill_slots(mesh, [_material(room.materials[index], images) for index in used])
    mesh.polygons.foreach_set("material_index", material)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([*window.plane.axes(), window.plane.normal], axis=1)
    matrix[:3, 3] = window.origin + LIFT * window.plane.normal
    item = bpy.data.objects.new(f"Emptied {room.materials[used[0]][PART_NAME]}", mesh)
    item[FILLED] = number
    collection(scene, EMPTIED).objects.link(item)
    item.parent = room_with_results(scene)[0].parent
    item.matrix_world = Matrix(matrix.tolist())
    return item


def _completed(room: Room, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """A window's values (H, W, 5), and the place in `Room.materials` (H, W) of the cells that are completed.

    Each part goes on with its own cells; holes of the mesh with all parts. Other cells have -1, and so have
    parts of which nothing beside is known: they keep what the estimate has filled in.
    """
    values, slot = window.values, np.full(window.slot.shape, -1)
    for index in np.unique(window.slot[window.hidden])[::-1].tolist():
        cells = window.hidden & (window.slot == index)
        known = window.known & ((window.slot == index) | (index < 0))
        if known.sum() >= _LEAST_KNOWN and (index < 0 or room.materials[index] is not None):
            values, source = complete(values, known, cells)
            slot[cells] = window.slot.ravel()[source][cells]
    return values, slot


def _path(key: str) -> Path:
    return Path(f"emptied_{key}.exr")


def _material(estimate: bpy.types.Material, images: Mapping[str, bpy.types.Image]) -> bpy.types.Material:
    """The material of a part, with its adjustment and replacement, with other images; constants stay."""
    material = estimate.copy()
    for label, image in images.items():
        node = node_tree(material).nodes[MAP.format(label)]
        if node.bl_idname == "ShaderNodeTexImage":
            node.image = image
    return material


def _written(scene: bpy.types.Scene, run: RunFolder, values: np.ndarray) -> TextureFiles:
    """Write the maps of a window, values (H, W, 5) and no confidence, into a folder of their own."""
    rgb = from_scene_linear(values[..., :3])
    maps = {"base_color": rgb, "roughness": values[..., [3] * 3], "metallic": values[..., [4] * 3]}
    maps["confidence"] = np.zeros((1, 1, 3))
    files = texture_files(scene, run, hashlib.blake2b(values.tobytes(), digest_size=6).hexdigest())
    for key, pixels in maps.items():
        with written_picture(files.folder / _path(key)) as temporary:
            save_values(pixels, temporary)
    return files
