# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Removes furniture from the room: hides it, and completes the planes and materials that it has hidden.

The hidden objects stay in the file, faces of a larger mesh as an object of their own. What is completed
consists of new objects with materials of the parts beside it, whose adjustments and replacements they share.
Light needs nothing: shadows, reflections and the light of removed lamps are rendered.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Matrix

from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder, atomic_path
from ..color_spaces import from_scene_linear
from ..marks import (
    FILLED,
    MATERIAL,
    PART,
    PART_NAME,
    REMOVED,
    REPLACEMENT,
    filled_surfaces,
    fixtures_of,
    has_results,
    is_fixture,
    room_with_results,
)
from ..node_trees import node_tree
from ..outliner import EMPTIED, collection, remove_if_empty, remove_object
from ..own_materials import own_materials
from ..room.mesh_arrays import corner_vertices, polygon_starts, transform_points, vertex_positions
from ..room.originals import shows_original
from ..room.uv_layer import write_layer
from ..texture_files import TextureFiles, texture_files
from . import adjust
from .completion import complete
from .hidden_surfaces import Room, Window, planes_beside, window_of
from .maps import show
from .materials import MAPS, Surface, part_material, remove_unused, result_materials
from .replacing import fill_slots
from .write_back_nodes import GROUP, agree_with_model

# What is completed lies so far in front of surfaces that no photograph saw, metres: less than is seen, more
# than the rays of a render confuse.
LIFT = 0.002
_NEAR_LAMP = 0.03  # metres around what is removed within which a lamp belongs to it
_LEAST_KNOWN = 50  # cells of a part from which it is completed: about those of a patch
_CHOICE = "Select objects of the room or their faces, or an empty that encloses them."


@dataclass(frozen=True)
class Emptied:
    """What a removal did.

    Attributes:
        hidden: names of the objects that are hidden.
        surfaces: names of the objects that complete what was behind them.
    """

    hidden: list[str] = field(default_factory=list)
    surfaces: list[str] = field(default_factory=list)


def selected_faces(item: bpy.types.Object) -> np.ndarray:
    """(P,) bool, the selected faces of an object in Object Mode."""
    selected = np.zeros(len(item.data.polygons), bool)
    item.data.polygons.foreach_get("select", selected)
    return selected


def faces_in_box(scene: bpy.types.Scene, box: bpy.types.Object) -> dict[bpy.types.Object, np.ndarray]:
    """The faces of the room that lie in the cube of an empty, by their objects: (P,) bool."""
    inverse = np.linalg.inv(np.array(box.matrix_world, np.float64))
    size = box.empty_display_size
    found = {}
    for item in _shown_room(scene):
        mesh = item.data
        points = transform_points(vertex_positions(mesh), inverse @ np.array(item.matrix_world, np.float64))
        inside = (np.abs(points) <= size).all(axis=1)
        if len(mesh.polygons):
            faces = np.logical_and.reduceat(inside[corner_vertices(mesh)], polygon_starts(mesh))
            if faces.any():
                found[item] = faces
    return found


def remove(
    scene: bpy.types.Scene, run: RunFolder, chosen: Mapping[bpy.types.Object, np.ndarray | None]
) -> Emptied:
    """Hide objects of the room, or some of their faces, and complete what they have hidden.

    Args:
        scene: its results are shown, in Object Mode.
        run: whose results they are.
        chosen: (P,) bool faces of result meshes, None for all; fixtures are objects, too.

    Raises:
        FiptError: ``removal-empty`` where nothing of the room is chosen; ``textures-unwritable``.
    """
    chosen = {item: faces for item, faces in chosen.items() if _can_be_removed(item, faces)}
    if not chosen:
        raise FiptError("removal-empty", "Nothing of the room's results is selected.", _CHOICE)
    own_materials(scene)
    points = np.concatenate([_points(item, faces) for item, faces in chosen.items()])
    removed = [item if faces is None else _separated(item, faces) for item, faces in chosen.items()]
    removed += _lamps_within(scene, points, removed)
    number = 1 + max((int(item.get(REMOVED, 0)) for item in scene.objects), default=0)
    for item in removed:
        for each in (item, *(child for child in item.children if is_fixture(item))):
            each[REMOVED] = number
            each.hide_viewport = each.hide_render = True
    staying = [*_shown_room(scene), *filled_surfaces(scene)]
    emptied = Emptied([item.name for item in removed])
    if not staying:
        return emptied
    room = Room(staying)
    planes = planes_beside(room, points)
    for plane in planes:
        window = window_of(room, plane, planes, points)
        if window is not None:
            item = _surface(scene, run, room, window, number)
            if item is not None:
                emptied.surfaces.append(item.name)
    if scene.fipt.materials.shown != "ESTIMATED":
        show(scene, scene.fipt.materials.shown)
    return emptied


def bring_back(scene: bpy.types.Scene, chosen: Collection[bpy.types.Object] = ()) -> int:
    """Show removed objects again, and remove what stands for what they hide.

    Args:
        scene: of the removals.
        chosen: objects of the removals to take back; all removals where none of them is one's.

    Returns:
        How many objects are back.
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
    room = (item for item in room_with_results(scene) if not shows_original(item))
    return [item for item in room if REMOVED not in item and not item.hide_render]


def _can_be_removed(item: bpy.types.Object, faces: np.ndarray | None) -> bool:
    if REMOVED in item or not (is_fixture(item) or (has_results(item) and not shows_original(item))):
        return False
    return bool(len(item.data.polygons) if faces is None else faces.any())


def _points(item: bpy.types.Object, faces: np.ndarray | None) -> np.ndarray:
    """(N, 3) corners of an object's faces in the world."""
    mesh = item.data
    if item.type != "MESH":
        return np.array([item.matrix_world.translation])
    corners = corner_vertices(mesh)
    if faces is not None:
        corners = corners[np.repeat(faces, np.diff(polygon_starts(mesh), append=len(mesh.loops)))]
    points = vertex_positions(mesh)[np.unique(corners)]
    return transform_points(points, np.array(item.matrix_world, np.float64))


def _separated(item: bpy.types.Object, faces: np.ndarray) -> bpy.types.Object:
    """The object with the chosen faces (P,) bool alone: a new one, unless all of its faces are chosen."""
    if faces.all():
        return item
    if item.data.users > 1:  # a linked duplicate keeps its faces
        item.data = item.data.copy()
    part = item.copy()
    part.data = item.data.copy()
    for each, unwanted in ((part, ~faces), (item, faces)):
        bm = bmesh.new()
        bm.from_mesh(each.data)
        geometry = [face for face, out in zip(bm.faces, unwanted.tolist(), strict=True) if out]
        bmesh.ops.delete(bm, geom=geometry, context="FACES")
        bm.to_mesh(each.data)
        bm.free()
    for target in item.users_collection:
        target.objects.link(part)
    return part


def _lamps_within(
    scene: bpy.types.Scene, points: np.ndarray, removed: Sequence[bpy.types.Object]
) -> list[bpy.types.Object]:
    """The lamps that lie within removed points (N, 3), and are not removed yet."""
    low, high = points.min(axis=0) - _NEAR_LAMP, points.max(axis=0) + _NEAR_LAMP
    lamps = [item for item in fixtures_of(scene) if item not in removed and REMOVED not in item]
    around = ((item, _points(item, None)) for item in lamps)
    return [item for item, place in around if ((place >= low) & (place <= high)).all()]


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
    materials = [_material(room.materials[index], images, run) for index in used]
    mesh = bpy.data.meshes.new("Emptied")
    rectangles = _rectangles(slot)
    left, bottom, right, top = rectangles[:, :4].T
    corners = np.stack([left, bottom, right, bottom, right, top, left, top], axis=1).reshape(-1, 2)
    places = np.searchsorted(used, rectangles[:, 4]).astype(np.int32)
    heights = [np.median(window.height[window.slot == index]) for index in used]
    flat = np.column_stack([corners * window.size, np.repeat(np.array(heights)[places], 4)])
    mesh.from_pydata(flat.tolist(), [], np.arange(len(corners)).reshape(-1, 4).tolist())
    write_layer(mesh, corners / np.array(slot.shape[::-1]))
    fill_slots(mesh, materials)
    mesh.polygons.foreach_set("material_index", places)
    first, second = window.plane.axes()
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([first, second, window.plane.normal], axis=1)
    matrix[:3, 3] = window.origin + LIFT * window.plane.normal
    item = bpy.data.objects.new(f"Emptied {materials[0][PART_NAME]}", mesh)
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
    for index in [*np.unique(window.slot[window.hidden & (window.slot >= 0)]).tolist(), -1]:
        cells = window.hidden & (window.slot == index)
        known = window.known & ((window.slot == index) | (index < 0)) & (window.slot >= 0)
        if known.sum() < _LEAST_KNOWN or not cells.any() or (index >= 0 and room.materials[index] is None):
            continue
        values, source = complete(values, known, cells)
        slot[cells] = window.slot.ravel()[source][cells]
    return values, slot


def _path(key: str) -> Path:
    return Path(f"emptied_{key}.exr")


def _material(
    estimate: bpy.types.Material, images: Mapping[str, bpy.types.Image], run: RunFolder
) -> bpy.types.Material:
    """The material of a part with other images; it follows the part's adjustment and replacement."""
    surface = Surface(str(estimate[MATERIAL]), str(estimate[PART]), str(estimate[PART_NAME]))
    material = part_material(surface, images, adjust.read(estimate))
    if GROUP in node_tree(estimate).nodes:
        agree_with_model(material, run.read_estimated().masking)
    if REPLACEMENT in estimate:
        material[REPLACEMENT] = estimate[REPLACEMENT]
    return material


def _written(scene: bpy.types.Scene, run: RunFolder, values: np.ndarray) -> TextureFiles:
    """Write the maps of a window, values (H, W, 5) and no confidence, into a folder of their own.

    Raises:
        FiptError: ``textures-unwritable``.
    """
    values = np.concatenate([from_scene_linear(values[..., :3]), values[..., 3:]], axis=2)
    digest = hashlib.blake2b(np.ascontiguousarray(values).tobytes(), digest_size=6).hexdigest()
    files = texture_files(scene, run, digest)
    maps = {
        "base_color": values[..., :3],
        "roughness": values[..., [3] * 3],
        "metallic": values[..., [4] * 3],
    }
    for key, rgb in {**maps, "confidence": np.zeros((4, 4, 3), np.float32)}.items():
        target = files.folder / _path(key)
        image = bpy.data.images.new(
            "FIPT Emptied", rgb.shape[1], rgb.shape[0], float_buffer=True, is_data=True
        )
        try:
            rgba = np.concatenate([rgb, np.ones((*rgb.shape[:2], 1))], axis=2).astype(np.float32)
            image.pixels.foreach_set(rgba.ravel())
            with atomic_path(target) as temporary:
                image.filepath_raw, image.file_format = str(temporary), "OPEN_EXR"
                image.save()
        except (RuntimeError, FiptError) as error:
            raise FiptError(
                "textures-unwritable",
                f"The pictures of what was hidden could not be written to {files.folder}.",
                "Free some space, or save the file in a folder in which you may write.",
            ) from error
        finally:
            bpy.data.images.remove(image)
    return files


def _rectangles(slot: np.ndarray) -> np.ndarray:
    """(N, 5) rectangles of cells with one number: lowest column and row, those behind the last, the number.

    Args:
        slot: (H, W) int64, negative for cells of none.
    """
    open_runs: dict[tuple[int, int, int], int] = {}
    found: list[tuple[int, int, int, int, int]] = []
    for row in range(slot.shape[0] + 1):
        runs = _runs(slot[row]) if row < slot.shape[0] else set()
        for start, end, value in [run for run in open_runs if run not in runs]:
            found.append((start, open_runs.pop((start, end, value)), end, row, value))
        for run in runs:
            open_runs.setdefault(run, row)
    return np.array(sorted(found)).reshape(-1, 5)


def _runs(row: np.ndarray) -> set[tuple[int, int, int]]:
    """Start, end and number of the runs of equal numbers of a row (W,), without negative ones."""
    edges = np.flatnonzero(np.diff(row, prepend=-2, append=-2))
    return {(int(start), int(end), int(row[start])) for start, end in pairwise(edges) if row[start] >= 0}
