# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Results onto the room: meshes with the atlas and the fixtures are prepared in slices, then swapped in.

Until the last slice nothing that the artist sees has changed, so that a failure leaves the room alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from . import fixtures, light_state
from .materials import (
    COLOR_ATTRIBUTE,
    MAPS,
    attribute_material,
    image_material,
    own_materials,
    read_textures,
    remove_unused,
)
from .originals import original_polygons, own_mesh, remove_fixtures, set_own_mesh
from .own_meshes import make_mesh, room_names
from .room_export import Room, is_mirrored, read_room, triangle_loops
from .slices import Slices, find_object, run_through
from .uvs import write_layer
from .write_back_nodes import agree_with_model


@dataclass
class Applied:
    """What `apply_results` put into the file."""

    materials: list[str] = field(default_factory=list)
    fixtures: list[str] = field(default_factory=list)


@dataclass
class _Results:
    """What the run folder says."""

    room: Room
    triangle_image: np.ndarray  # (T,) atlas image, -1 for none
    corner_uv: np.ndarray  # (T,3,2)
    entries: list[dict[str, str]]  # of textures.json; empty for colour attributes
    corner_fields: dict[str, np.ndarray]  # colour attributes by map; empty for UVs
    emitters: list[dict[str, Any]]


def apply_results(
    run: RunFolder, objects: Iterable[bpy.types.Object], scene: bpy.types.Scene | None = None
) -> Applied:
    """Put textures and emitters of a finished run onto the room.

    Args:
        run: with atlas, textures and results/emitters.json.
        objects: the room's objects; those that carry results already get them anew.
        scene: where the fixtures go; the context's by default.

    Raises:
        FiptError: ``room-changed``, ``room-edited``, ``uv-layers-full``, ``file-missing``, ``file-damaged``.
    """
    return run_through(apply_slices(run, objects, scene or bpy.context.scene))


def apply_slices(
    run: RunFolder, objects: Iterable[bpy.types.Object], scene: bpy.types.Scene
) -> Slices[Applied]:
    """`apply_results`, an object at a time; the scene changes in the last slice."""
    scene_name = scene.name
    results = _read(run)
    names = room_names(results.room, objects)
    meshes: list[str] = []
    try:
        for index, name in enumerate(names):
            item = find_object(name)
            mesh = make_mesh(results.room, index, item)
            meshes.append(mesh.name)
            _write_maps(mesh, is_mirrored(item), results, results.room.triangle_object == index)
            yield
        items = [find_object(name) for name in names]
        prepared = [_prepared(name) for name in meshes]
        return _swap_in(run, results, items, prepared, bpy.data.scenes[scene_name])
    except BaseException:  # GeneratorExit among them: the job was cancelled
        left = [bpy.data.meshes.get(name) for name in meshes]
        bpy.data.batch_remove([mesh for mesh in left if mesh is not None and mesh.users == 0])
        raise


def _prepared(name: str) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.get(name)
    if mesh is None:
        raise FiptError(
            "apply-interrupted",
            "The file was undone or loaded while results were being applied.",
            "Apply them again; the textures are kept.",
        )
    return mesh


def _read(run: RunFolder) -> _Results:
    atlas = read_json(run.atlas_json)
    arrays = _load(run.atlas_npz, ("triangle_image", "corner_uv"))
    by_attribute = atlas["mode"] == "color_attribute"
    image = arrays["triangle_image"]
    return _Results(
        room=read_room(run),
        triangle_image=np.zeros_like(image) if by_attribute else image,
        corner_uv=arrays["corner_uv"],
        entries=[] if by_attribute else read_textures(run),
        corner_fields=_load(run.textures / "corner_fields.npz", tuple(MAPS)) if by_attribute else {},
        emitters=read_json(run.emitters_json)["fixtures"],
    )


def _load(path: Any, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in names}
    except FileNotFoundError:
        raise FiptError("file-missing", f"{path} does not exist.", "Apply the results again.") from None
    except (OSError, KeyError, ValueError) as error:
        raise FiptError(
            "file-damaged", f"{path} can't be read ({error}).", "Apply the results again."
        ) from None


def _write_maps(mesh: bpy.types.Mesh, mirrored: bool, results: _Results, mine: np.ndarray) -> None:
    if not results.corner_fields:
        write_layer(mesh, mirrored, results.corner_uv[mine])
        return
    loops, _ = triangle_loops(mesh, mirrored)
    for key, (label, _) in MAPS.items():
        name = COLOR_ATTRIBUTE.format(label)
        old = mesh.attributes.get(name)
        if old is not None:
            mesh.attributes.remove(old)
        mesh.attributes.new(name, "FLOAT_COLOR", "CORNER")
        values = np.ones((len(mesh.loops), 4), np.float32)
        # Data are grey colours, so that solid shading can draw them too.
        values[loops.ravel(), :3] = results.corner_fields[key][mine].reshape(loops.size, -1)
        mesh.attributes[name].data.foreach_set("color", values.ravel())


def _swap_in(
    run: RunFolder,
    results: _Results,
    items: list[bpy.types.Object],
    meshes: list[bpy.types.Mesh],
    scene: bpy.types.Scene,
) -> Applied:
    old_meshes = [mesh for mesh in map(own_mesh, items) if mesh is not None]
    old = own_materials(old_meshes)
    if results.entries:
        materials = [image_material(run, entry, old.get(entry["name"])) for entry in results.entries]
    else:
        materials = [attribute_material(old.get("Room"))]
    settings = run.read()
    if settings.write_back == "cycles":
        for material in materials:
            agree_with_model(material, settings.masking)
    for index, mesh in enumerate(meshes):
        _assign(mesh, results.room, index, results.triangle_image, materials)
    new_fixtures = fixtures.split_off(results.room, results.emitters, list(zip(items, meshes, strict=True)))
    kept = light_state.states_of(scene)
    remove_fixtures({item.name for item in items})
    for item, mesh in zip(items, meshes, strict=True):
        set_own_mesh(item, mesh)
    remove_unused(old.values())
    placed = fixtures.place(scene, new_fixtures)
    light_state.keep_states(scene, placed, kept)
    return Applied([material.name for material in materials], [item.name for item in placed])


def _assign(
    mesh: bpy.types.Mesh,
    room: Room,
    index: int,
    triangle_image: np.ndarray,
    materials: list[bpy.types.Material],
) -> None:
    """One slot for each atlas image that the object uses."""
    mine = room.triangle_object == index
    polygon, image = room.triangle_polygon[mine], triangle_image[mine]
    original = original_polygons(mesh)
    polygon_image = np.full(max(int(polygon.max(initial=-1)), int(original.max(initial=-1))) + 1, -1)
    # Triangles without area have no image (-1); the polygon takes that of the others.
    order = np.argsort(image, kind="stable")
    polygon_image[polygon[order]] = image[order]
    used = [int(each) for each in np.unique(polygon_image[original]) if each >= 0] or [0]
    slot = np.zeros(len(materials) + 1, np.int32)
    slot[used] = np.arange(len(used))
    mesh.materials.clear()
    for each in used:
        mesh.materials.append(materials[each])
    mesh.polygons.foreach_set("material_index", slot[polygon_image[original]])
    mesh.update()
