"""Applies results to the room: result meshes and fixtures are prepared in slices, then swapped in.

Until the last slice nothing visible has changed, so that a failure leaves the room as it was.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import bpy
import numpy as np

from ...bridge.process import Message
from ...bridge.step import Slices
from ...core.run.errors import FiptError, warning
from ...core.run.run_files import RoomMesh
from ...core.run.runfolder import RunFolder
from ...core.run.versions import results_id
from ..lights import fixtures
from ..lights.kept_states import keep_states, states_of
from ..marks import (
    FIXTURE,
    LAID_OUT,
    OBJECT_ID,
    SPLIT_OFF,
    fixtures_of,
    is_linked,
    object_id,
    remove_marks,
)
from ..outliner import remove_object
from ..room.mesh_arrays import polygon_slots
from ..room.mesh_digest import sign
from ..room.originals import remove_fixtures, result_mesh, set_result_mesh
from ..room.panes import add_surfaces
from ..room.result_meshes import copied_objects, list_names, match_objects
from ..room.uv_layer import UV_LAYER, layer_values, write_layer
from ..slices import find_object
from ..texture_files import TextureFiles, in_run_folder
from .materials import (
    MAPS,
    load_maps,
    remove_unused,
    result_materials,
    slot_estimates,
    used_alone,
)
from .part_list import select_polygons
from .part_materials import PartMaterials
from .reading import Results, read_results
from .targets import Target, TargetBuilder, find_mesh
from .write_back_nodes import agree_with_model

ATTRIBUTES = "Room"  # in place of an image's name


def apply_results(
    run: RunFolder,
    objects: Iterable[bpy.types.Object],
    scene: bpy.types.Scene,
    files: TextureFiles | None = None,
) -> Slices[list[Message]]:
    """Put textures and emitters of a finished run onto the room, which changes in the last slice.

    Objects of the run that are missing are left out with a warning. Faces that the artist has modelled since
    get the results of the nearest surface (`room.transfer`), or keep what they have, with a warning.

    Args:
        run: the run folder with atlas, textures and results/emitters.json.
        objects: the room's objects; earlier results on them are replaced.
        scene: for the fixtures.
        files: where the textures are kept; in the run folder by default.

    Returns:
        Warnings: objects of the room that got no results, faces that keep what they had, and lost lamps.
    """
    scene_name = scene.name
    results = read_results(run)
    geometry = results.room.scan if run.read_estimated().clean_mesh else None
    objects = list(objects)
    linked = [item.name for item in objects if is_linked(item)]
    if linked:
        raise FiptError("room-linked", linked=list_names(linked))
    matches = match_objects(results.room, objects)
    surfaces = add_surfaces(results.room, objects)
    added = [item.name for item in surfaces]
    if surfaces:
        objects += surfaces
        matches = match_objects(results.room, objects)
    present = [(index, name) for index, name in enumerate(matches) if name is not None]
    builder = TargetBuilder(results.room, geometry, results.fixture, results.charts)
    targets: list[Target] = []
    try:
        shared = {mesh for name in matches if name and (mesh := result_mesh(find_object(name))) is not None}
        copies = [
            (index, name)
            for index, name in copied_objects(results.room, matches, objects)
            if result_mesh(find_object(name)) not in shared
        ]
        for index, name in [*present, *copies]:
            target = yield from builder.build(index, name, is_copy=name not in matches)
            targets.append(target)
            _write_layers(target, results)
            yield None
        _check_counterparts(targets)
        files = files or in_run_folder(run)
        for entry in results.entries:
            for key, (_, is_data) in MAPS.items():
                files.copy(run.resolve(getattr(entry, key)), is_data)
                yield None
        warnings = _left_out(results.room, matches)
        return _swap_in(run, results, targets, bpy.data.scenes[scene_name], warnings, files)
    except BaseException:  # including GeneratorExit: the job was cancelled
        prepared = [bpy.data.meshes.get(name) for name in builder.made]
        bpy.data.batch_remove([mesh for mesh in prepared if mesh is not None and mesh.users == 0])
        for name in added:
            if name in bpy.data.objects:
                remove_object(bpy.data.objects[name])
        raise


def _check_counterparts(targets: Sequence[Target]) -> None:
    """Refuse a room of which nothing is as it was estimated."""
    if not any((target.found.triangle >= 0).any() for target in targets):
        names = list_names([target.name for target in targets])
        raise FiptError("room-changed.check-counterparts", names=names)


def _left_out(room: RoomMesh, matches: Sequence[str | None]) -> list[Message]:
    """A warning that names the objects of the room that get no results."""
    missing = [name for name, match in zip(room.objects, matches, strict=True) if match is None]
    if not missing:
        return []
    return [warning("objects-missing", objects=list_names(missing))]


def _write_layers(target: Target, results: Results) -> None:
    """Write the UV layer or the colour attributes of a result mesh; faces without counterpart keep theirs."""
    mesh = find_mesh(target.mesh_name)
    for name, of_triangles in results.layers.items():
        if name == UV_LAYER:
            write_layer(mesh, target.found.values(of_triangles, layer_values(mesh)))
            continue
        if name not in mesh.attributes:
            mesh.attributes.new(name, "FLOAT_COLOR", "CORNER")
        values = np.ones((len(mesh.loops), 4), np.float32)
        mesh.attributes[name].data.foreach_get("color", values.ravel())
        values = target.found.values(of_triangles, values)
        mesh.attributes[name].data.foreach_set("color", values.ravel())


def _swap_in(
    run: RunFolder,
    results: Results,
    targets: Sequence[Target],
    scene: bpy.types.Scene,
    warnings: list[Message],
    files: TextureFiles,
) -> list[Message]:
    """Give the objects of the targets their result meshes, and the scene the fixtures."""
    room = results.room
    pairs = [(target, find_object(target.name), find_mesh(target.mesh_name)) for target in targets]
    for target, item, _ in pairs:
        if OBJECT_ID not in item:  # undone since
            item[OBJECT_ID] = room.object_ids[target.index]
    before = [mesh for _, item, _ in pairs if (mesh := result_mesh(item)) is not None]
    sharing = {item.name: _sharing(scene, item) for _, item, _ in pairs}
    earlier = result_materials(before)
    replaced = {*before, *(mesh for _, _, mesh in pairs)}
    stale = {material for target, _, mesh in pairs for material in _kept_materials(target, mesh, results)}
    entries = results.entries
    materials = PartMaterials(
        results,
        [load_maps(run, entry, files) for entry in entries] or [None],
        [entry.name for entry in entries] or [ATTRIBUTES],
        earlier,
        [material for material in used_alone(earlier, replaced) if material not in stale],
    )
    for target, _, mesh in pairs:
        estimates = slot_estimates(mesh) if target.modifiers is None else None
        alike = mesh.get(LAID_OUT) == results.laid_out
        materials.assign(mesh, target.found.triangle, estimates, alike)
    warnings = [*warnings, *materials.finish()]
    settings = run.read_estimated()
    if settings.write_back == "cycles":
        for material in materials.made.values():
            agree_with_model(material, settings.masking)
    sources = [fixtures.Source(item, mesh, target.found.triangle) for target, item, mesh in pairs]
    kept_faces = {item.name: _kept_faces(target, results) for target, item, _ in pairs}
    new_fixtures = fixtures.split_off(room, results.emitters, sources, results.parts)
    deleted = _deleted_lamps(run, results, targets, scene)
    kept = states_of(scene)
    remove_fixtures(scene, {object_id(item) for _, item, _ in pairs})
    for target, item, mesh in pairs:
        for each in (item, *sharing[item.name]):
            set_result_mesh(each, mesh, target.modifiers)
        mesh[LAID_OUT] = results.laid_out
        lit = np.flatnonzero(results.fixture[room.triangle_object == target.index] >= 0)
        remove_marks(mesh, SPLIT_OFF)
        if len(lit) and not target.is_copy:
            mesh[SPLIT_OFF] = lit.tolist()
        if target.modifiers is not None:  # a modelled mesh stays one
            sign(mesh)
    remove_unused(earlier)
    warnings += _select_kept(scene, kept_faces) + _lost_lamps(results, targets, new_fixtures)
    absent = [fixture for fixture in new_fixtures if fixture.entry.name in deleted]
    warnings += _still_deleted(absent)
    bpy.data.batch_remove([fixture.mesh for fixture in absent])
    wanted = [fixture for fixture in new_fixtures if fixture not in absent]
    return warnings + keep_states(scene, fixtures.place(scene, wanted), kept)


def _sharing(scene: bpy.types.Scene, item: bpy.types.Object) -> list[bpy.types.Object]:
    """The other objects of a scene that share the result mesh of an object: linked duplicates."""
    mesh = result_mesh(item)
    return [each for each in scene.objects if mesh is not None and each != item and result_mesh(each) == mesh]


def _kept_materials(target: Target, mesh: bpy.types.Mesh, results: Results) -> set[bpy.types.Material | None]:
    """Earlier estimated materials that stay on faces, since the atlas has other UVs now."""
    if target.modifiers is not None or mesh.get(LAID_OUT) == results.laid_out or not len(mesh.materials):
        return set()
    slots = np.unique(polygon_slots(mesh)[target.found.triangle < 0])
    estimates = slot_estimates(mesh)
    return {estimates[min(index, len(estimates) - 1)] for index in slots.tolist()}


def _kept_faces(target: Target, results: Results) -> np.ndarray:
    """(P,) bool of the faces that stay after the fixtures are gone: those without a counterpart."""
    triangle = target.found.triangle
    lit = (triangle >= 0) & (results.fixture[triangle] >= 0)
    kept: np.ndarray = (triangle < 0)[~lit]
    return kept


def _select_kept(scene: bpy.types.Scene, kept_faces: Mapping[str, np.ndarray]) -> list[Message]:
    """Select the faces that keep what they had, given by object, and warn of them."""
    names = [name for name, kept in kept_faces.items() if kept.any()]
    if not names:
        return []
    for name in names:
        item = find_object(name)
        select_polygons(item.data, kept_faces[name])
        for layer in scene.view_layers:
            if name in layer.objects:
                item.select_set(True, view_layer=layer)
    count = sum(int(kept_faces[name].sum()) for name in names)
    return [warning("surfaces-kept", count=count, objects=list_names(names))]


def _deleted_lamps(
    run: RunFolder, results: Results, targets: Sequence[Target], scene: bpy.types.Scene
) -> set[str]:
    """Names in emitters.json of lamps of these same results that the artist has deleted."""
    if not hasattr(scene, "fipt") or scene.fipt.materials.applied_version != results_id(run):
        return set()
    placed = set[int]()
    for target in targets:
        mesh = result_mesh(find_object(target.name))
        if mesh is not None and not target.is_copy:
            of_object = results.fixture[results.room.triangle_object == target.index]
            placed |= set(of_object[list(mesh.get(SPLIT_OFF, ()))].tolist())
    present = {item[FIXTURE] for item in fixtures_of(scene)}
    return {results.emitters[index].name for index in placed} - present


def _still_deleted(absent: Sequence[fixtures.NewFixture]) -> list[Message]:
    """A note on lamps that stay deleted."""
    if not absent:
        return []
    return [warning("lamps-deleted", lamps=list_names([each.name for each in absent]))]


def _lost_lamps(
    results: Results, targets: Sequence[Target], placed: Sequence[fixtures.NewFixture]
) -> list[Message]:
    """A warning of lamps on these objects that have no face any more."""
    found = {fixture.entry.name for fixture in placed}
    present = np.isin(results.room.triangle_object, [target.index for target in targets])
    lost = [
        entry.name
        for entry in results.emitters
        if entry.name not in found and present[np.array(entry.triangles, np.int64)].any()
    ]
    if not lost:
        return []
    return [warning("lamps-missing", lamps=list_names(lost))]
