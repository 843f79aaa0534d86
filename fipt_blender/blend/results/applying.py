# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Applies results to the room: result meshes and fixtures are prepared in slices, then swapped in.

Until the last slice nothing visible has changed, so that a failure leaves the room as it was.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...bridge.process import Message
from ...core.run.arrays import read_arrays
from ...core.run.errors import FiptError
from ...core.run.parts import read_parts
from ...core.run.run_files import read_atlas, read_emitters, read_left_alone, read_outlined
from ...core.run.runfolder import RunFolder
from ...core.run.shapes import CORNER_FIELDS_ARRAYS
from ..lights import fixtures
from ..lights.kept_states import keep_states, states_of
from ..marks import MAP, OBJECT_ID, has_results, object_id
from ..outliner import remove_object
from ..room.arrays import Room, read_room
from ..room.mesh_arrays import is_mirrored, triangle_loops
from ..room.originals import remove_fixtures, restore_original, result_meshes, set_result_mesh
from ..room.panes import add_surfaces
from ..room.result_meshes import clean_result_mesh, list_names, make_mesh, match_objects
from ..room.tiles import tiled_uvs
from ..room.uv_layer import write_layer
from ..slices import Slices, find_object, run_through
from ..texture_files import TextureFiles, in_run_folder
from .materials import MAPS, load_maps, read_textures, remove_unused, result_materials
from .part_materials import PartFaces, PartMaterials
from .write_back_nodes import agree_with_model

_AGAIN = "Apply the results again."
SEVERAL = "Room"  # in place of an atlas image's name, for several or for colour attributes


@dataclass(frozen=True)
class Applied:
    """What `apply_results` did.

    Attributes:
        materials, fixtures: names of those that it put into the file.
        warnings: objects of the room that got no results.
    """

    materials: list[str] = field(default_factory=list)
    fixtures: list[str] = field(default_factory=list)
    warnings: list[Message] = field(default_factory=list)


@dataclass(frozen=True)
class _Target:
    """An object of the room, by name, with the name of its new result mesh and its index in the room."""

    index: int
    name: str
    mesh_name: str


@dataclass(frozen=True)
class _Results:
    """The results of a run.

    Attributes:
        room: the exported room.
        faces: part of each triangle.
        corner_uv: (T,3,2) of the atlas, in its tiles.
        triangle_atlas: (T,) int, which of several atlases a triangle lies on; 0 where parts share one.
        entries: the images of textures.json; empty for colour attributes.
        apart: whether each image is an atlas of its own.
        uniform: base colour, roughness and metallic of parts of one value, by their keys.
        corner_fields: values of colour attributes by map; empty for UVs.
        emitters: the fixtures of emitters.json.
    """

    room: Room
    faces: PartFaces
    corner_uv: np.ndarray
    triangle_atlas: np.ndarray
    entries: list[dict[str, str]]
    apart: bool
    uniform: dict[str, tuple[float, ...]]
    corner_fields: dict[str, np.ndarray]
    emitters: list[dict[str, Any]]


def apply_results(run: RunFolder, objects: Iterable[bpy.types.Object]) -> Applied:
    """Put textures and emitters of a finished run onto the room, in the context's scene.

    Objects of the run that are missing, or whose faces have changed, are left out with a warning.

    Args:
        run: the run folder with atlas, textures and results/emitters.json.
        objects: the room's objects; earlier results on them are replaced.

    Raises:
        FiptError: ``room-changed`` where all are left out, ``room-edited``, ``uv-layers-full``,
            ``file-missing``, ``file-damaged``.
    """
    return run_through(apply_slices(run, objects, bpy.context.scene))


def apply_slices(
    run: RunFolder,
    objects: Iterable[bpy.types.Object],
    scene: bpy.types.Scene,
    files: TextureFiles | None = None,
) -> Slices[Applied]:
    """`apply_results`, one object per slice; the scene changes in the last slice.

    Args:
        run, objects: see `apply_results`.
        scene: for the fixtures.
        files: where the textures are kept; in the run folder by default.

    Raises:
        FiptError: also ``textures-unwritable``.
    """
    scene_name = scene.name
    results = _read(run)
    geometry = _cleaned_scan(run, results.room)
    objects = list(objects)
    matches = match_objects(results.room, objects)
    surfaces = add_surfaces(results.room, objects)
    added = [item.name for item in surfaces]
    if surfaces:
        objects += surfaces
        matches = match_objects(results.room, objects)
    names = [item.name for item in objects]
    targets: list[_Target] = []
    changed: dict[str, FiptError] = {}
    try:
        for index, name in enumerate(matches):
            if name is None:
                continue
            item = find_object(name)
            try:
                mesh = make_mesh(results.room, index, item)
            except FiptError as error:
                if error.code != "room-changed":
                    raise
                changed[name] = error
                continue
            targets.append(_Target(index, name, mesh.name))
            if geometry is not None:
                clean_result_mesh(mesh, item, results.room, index, geometry)
            _write_maps(mesh, is_mirrored(item), results, results.room.triangle_object == index)
            yield None
        if changed and not targets:
            raise next(iter(changed.values()))
        warnings = _left_out(results.room, matches, list(changed))
        with_results = {target.name for target in targets}
        others = [bpy.data.objects.get(name) for name in names if name not in with_results]
        pairs = {
            target.index: (find_object(target.name), _prepared_mesh(target.mesh_name)) for target in targets
        }
        files = files or in_run_folder(run)
        for entry in results.entries:
            for key, (_, is_data) in MAPS.items():
                files.copy(run.resolve(entry[key]), is_data)
                yield None
        return _swap_in(run, results, pairs, others, bpy.data.scenes[scene_name], warnings, files)
    except BaseException:  # including GeneratorExit: the job was cancelled
        prepared = [bpy.data.meshes.get(target.mesh_name) for target in targets]
        bpy.data.batch_remove([mesh for mesh in prepared if mesh is not None and mesh.users == 0])
        for name in added:
            if name in bpy.data.objects:
                remove_object(bpy.data.objects[name])
        raise


def _left_out(room: Room, matches: Sequence[str | None], changed: Sequence[str]) -> list[Message]:
    """Warnings that name the objects of the room that get no results."""
    missing = [name for name, match in zip(room.objects, matches, strict=True) if match is None]
    warnings: list[Message] = []
    if missing:
        text = f"These objects were estimated, but are not in the room any more: {list_names(missing)}."
        remedy = "The others got their results. Undo the removal and apply again to give them theirs."
        warnings.append({"type": "warning", "code": "objects-missing", "text": text, "remedy": remedy})
    if changed:
        text = f"The faces of these objects are not those that were estimated: {list_names(changed)}."
        remedy = (
            "They show their own materials. Undo the change to their meshes or modifiers and apply again, or"
            " estimate again."
        )
        warnings.append({"type": "warning", "code": "objects-changed", "text": text, "remedy": remedy})
    return warnings


def _prepared_mesh(name: str) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.get(name)
    if mesh is None:
        raise FiptError(
            "apply-interrupted",
            "An undo or the loading of a file interrupted applying the results.",
            "Apply them again; the textures are kept.",
        )
    return mesh


def _read(run: RunFolder) -> _Results:
    room = read_room(run.estimated())
    count = len(room.triangles)
    atlas, arrays = read_atlas(run, count)
    corner_fields: dict[str, np.ndarray] = {}
    entries: list[dict[str, str]] = []
    uniform: dict[str, tuple[float, ...]] = {}
    if atlas["mode"] == "color_attribute":
        corner_fields = _read_corner_fields(run.textures / "corner_fields.npz", count)
    else:
        entries, uniform = read_textures(run)
        if len(entries) != len(atlas["images"]):
            raise FiptError("file-damaged", f"{run.textures_json} does not fit {run.atlas_json}.", _AGAIN)
    parts = read_parts(run, room.triangle_object, room.objects)
    image, apart = arrays["triangle_image"], bool(atlas.get("apart", False)) and bool(entries)
    shared = np.zeros_like(image)
    return _Results(
        room=room,
        faces=PartFaces(parts, read_left_alone(run, count)),
        corner_uv=tiled_uvs(arrays["corner_uv"], shared if apart else image),
        triangle_atlas=own_images(image, parts.triangle, room.triangle_object) if apart else shared,
        entries=entries,
        apart=apart,
        uniform=uniform,
        corner_fields=corner_fields,
        emitters=read_emitters(run, count)["fixtures"],
    )


def own_images(image: np.ndarray, part: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """(T,) image of each triangle; those without area, which have none (-1), take that of others beside them.

    Args:
        image: (T,) int. part, owner: (T,) int, of each triangle; those of one part and object have one image.
    """
    both = part.astype(np.int64) * (int(owner.max(initial=0)) + 1) + owner
    found = image.astype(np.int64)
    for group in (both, part.astype(np.int64), owner.astype(np.int64)):
        largest = np.full(int(group.max(initial=0)) + 1, -1, np.int64)
        np.maximum.at(largest, group, found)
        found = np.where(found < 0, largest[group], found)
    return np.maximum(found, 0)


def _cleaned_scan(run: RunFolder, room: Room) -> dict[str, np.ndarray] | None:
    """The cleaned copy of the run's scan, None where the mesh is no scan or the scan is to be kept."""
    if not run.read_estimated().clean_mesh:
        return None
    return read_outlined(run.estimated(), room.mesh)


def _read_corner_fields(path: Path, count: int) -> dict[str, np.ndarray]:
    """Values (T,3,...) of colour attributes by map; `count` is the room's number of triangles."""
    arrays = read_arrays(path, CORNER_FIELDS_ARRAYS, remedy=_AGAIN)
    if len(arrays["roughness"]) != count:
        raise FiptError("file-damaged", f"{path} does not fit the room.", _AGAIN)
    return arrays


def _write_maps(mesh: bpy.types.Mesh, mirrored: bool, results: _Results, triangles: np.ndarray) -> None:
    """Write the UV layer or the colour attributes of a result mesh; `triangles` (T,) marks its triangles."""
    if not results.corner_fields:
        write_layer(mesh, mirrored, results.corner_uv[triangles])
        return
    loops, _ = triangle_loops(mesh, mirrored)
    for key, (label, _) in MAPS.items():
        name = MAP.format(label)
        old = mesh.attributes.get(name)
        if old is not None:
            mesh.attributes.remove(old)
        mesh.attributes.new(name, "FLOAT_COLOR", "CORNER")
        values = np.ones((len(mesh.loops), 4), np.float32)
        # Data maps are grey colours, so that solid shading can draw them too.
        values[loops.ravel(), :3] = results.corner_fields[key][triangles].reshape(loops.size, -1)
        mesh.attributes[name].data.foreach_set("color", values.ravel())


def _swap_in(
    run: RunFolder,
    results: _Results,
    targets: Mapping[int, tuple[bpy.types.Object, bpy.types.Mesh]],
    others: Sequence[bpy.types.Object | None],
    scene: bpy.types.Scene,
    warnings: list[Message],
    files: TextureFiles,
) -> Applied:
    """Give the objects in `targets` their result meshes, and the `others` of the room their original ones."""
    room = results.room
    for index, (item, _) in targets.items():
        if OBJECT_ID not in item and item.library is None:  # undone since, or a run of an earlier version
            item[OBJECT_ID] = (room.object_ids or room.objects)[index]
    earlier = result_materials(result_meshes(item for item, _ in targets.values()))
    entries = results.entries
    atlases = [[entry] for entry in entries] if results.apart else [entries]
    materials = PartMaterials(
        results.faces,
        [load_maps(run, images, files) if images else None for images in atlases],
        [images[0]["name"] if len(images) == 1 else SEVERAL for images in atlases],
        results.triangle_atlas,
        results.uniform,
        earlier,
    )
    for index, (_, mesh) in targets.items():
        materials.assign(mesh, room, index)
    warnings = [*warnings, *materials.finish()]
    settings = run.read_estimated()
    if settings.write_back == "cycles":
        for material in materials.made.values():
            agree_with_model(material, settings.masking)
    new_fixtures = fixtures.split_off(room, results.emitters, targets, results.faces.parts)
    kept = states_of(scene)
    remove_fixtures({object_id(item) for item, _ in targets.values()})
    # Earlier results of theirs would show the new textures at the UVs of the old ones.
    restore_original(item for item in others if item is not None and has_results(item))
    for item, mesh in targets.values():
        set_result_mesh(item, mesh)
    remove_unused(earlier)
    placed = keep_states(scene, fixtures.place(scene, new_fixtures), kept)
    placed_names = [item.name for item in placed]
    return Applied([material.name for material in materials.made.values()], placed_names, warnings)
