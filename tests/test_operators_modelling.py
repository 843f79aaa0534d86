"""Apply Results on a room that the artist has modelled: geometry stays, surfaces get what was estimated."""

from __future__ import annotations

import itertools
import os

import bpy
import numpy as np
import pytest

from fipt_blender.blend import marks
from fipt_blender.blend.image_datablocks import image_values
from fipt_blender.blend.lights.fixture_nodes import side_radiance
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs import running
from samples import artist, artist_sequences
from samples.applied_rooms import ConstantFields

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")

MODELLING = {
    "delete": lambda: artist.delete_faces("cube"),
    "separate": lambda: artist.separate("cube"),
    "extrude": lambda: artist.extrude("cube"),
    "subdivide": lambda: artist.subdivide("panel"),
    "join": lambda: artist.join("panel", "cube"),
    "join the other": lambda: artist.join("cube", "panel"),
    "applied subdivision": lambda: artist.apply_modifier("cube", "SUBSURF"),
    "applied solidify": lambda: artist.apply_modifier("panel", "SOLIDIFY"),
    "live bevel": lambda: artist.add_modifier("cube", "BEVEL"),
    "live bevel without effect": lambda: artist.add_modifier("panel", "BEVEL"),
    "live solidify": lambda: artist.add_modifier("panel", "SOLIDIFY"),
    "live subdivision": lambda: artist.add_modifier("panel", "SUBSURF"),
    "vertex group": lambda: bpy.data.objects["cube"].vertex_groups.new().add([0, 1], 0.5, "ADD"),
    "shape key": lambda: bpy.data.objects["cube"].shape_key_add(),
    "uv layer": lambda: bpy.data.objects["panel"].data.uv_layers.new(name="mine"),
}
# Of the cube and of the panel, which do not depend on one another; and of both.
TOGETHER = [
    ("delete", "subdivide"),
    ("separate", "live bevel without effect"),
    ("extrude", "live solidify"),
    ("applied subdivision", "applied solidify"),
    ("live bevel", "live subdivision"),
    ("vertex group", "uv layer"),
    ("shape key",),
    ("join",),
    ("join the other",),
]


def meshes(scene) -> list[bpy.types.Object]:
    return [item for item in scene.objects if item.type == "MESH" and not marks.is_fixture(item)]


def state(scene) -> dict[str, tuple]:
    """What the artist has made of the room's objects."""
    bpy.context.view_layer.update()
    return {
        item.name: (
            artist.faces(item),
            [(each.name, each.show_viewport, each.show_render) for each in item.modifiers],
            [group.name for group in item.vertex_groups],
            item.data.shape_keys and len(item.data.shape_keys.key_blocks),
            [layer.name for layer in item.data.uv_layers],
            [sorted((each.group, each.weight) for each in vertex.groups) for vertex in item.data.vertices],
            [tuple(row) for row in item.matrix_world],
        )
        for item in meshes(scene)
    }


@pytest.mark.parametrize(("modelling", "mode"), list(zip(TOGETHER, itertools.cycle(["uv", "color_attribute"]))))
def test_applying_again_keeps_what_the_artist_has_modelled(scene, modelling, mode):
    """With the same textures, and with others after the room was moved, too."""
    scene.fipt.materials.atlas_mode = mode
    ops.apply_results()
    assert all("" not in artist.shown(item) for item in meshes(scene))
    for each in modelling:
        MODELLING[each]()
    for density in (16.0, 32.0):
        if density == 32.0:
            for item in meshes(scene):
                item.location.x += 3.0
                item.scale.y *= 2.0
        before = state(scene)
        rendered = {item.name: artist.shown(item) for item in meshes(scene)}
        scene.fipt.materials.texel_density = density
        assert ops.apply_results() == {"FINISHED"}
        assert state(scene) == before and all(rendered.values())
        assert {item.name: artist.shown(item) for item in meshes(scene)} == rendered
    assert [item.name for item in scene.objects if marks.is_fixture(item)] == ["Panel"]
    assert len(bpy.data.objects["Panel"].data.polygons) == 1


def query_places(fields, positions, triangles):
    """Instead of `ConstantFields.query`: the base colour depends on the place."""
    count = len(positions)
    return place_color(positions), np.full(count, fields.roughness), np.full(count, fields.metallic)


def place_color(positions: np.ndarray) -> np.ndarray:
    """Each coordinate between -2 and 8 as a value of 0 to 1."""
    return np.clip((np.asarray(positions) + 2.0) / 10.0, 0.0, 1.0)


def colors_of(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """World positions of the faces' centres and the base colours there, of faces with estimated materials."""
    mesh, layer = item.data, item.data.uv_layers["FIPT"]
    places, colors = [], []
    for polygon in mesh.polygons:
        material = mesh.materials[polygon.material_index]
        if material is None or marks.MATERIAL not in material:
            continue
        image = material.node_tree.nodes["FIPT Base Color"].image
        uv = np.mean([layer.uv[loop].vector for loop in polygon.loop_indices], axis=0)
        values = image_values(image)
        row, column = (int(share * size) for share, size in zip(uv[::-1], values.shape[:2], strict=True))
        places.append(item.matrix_world @ polygon.center)
        colors.append(values[row, column, :3])
    return np.array(places), np.array(colors)


PLACES = ("delete", "separate", "extrude", "subdivide", "join", "join the other", "applied solidify")
FIRST = ("separate", "subdivide", "join")


@pytest.mark.parametrize(
    ("modelling", "restart"), [*((name, False) for name in PLACES), *((name, True) for name in FIRST)]
)
def test_modelled_surfaces_show_what_was_estimated_at_their_place(scene, bakes, monkeypatch, modelling, restart):
    """Also where the atlas is laid out anew, and where the room was modelled before the first application."""
    if not restart:
        ops.apply_results()
    MODELLING[modelling]()
    monkeypatch.setattr(ConstantFields, "query", query_places)
    scene.fipt.materials.texel_density = 32.0
    run = RunFolder(scene.fipt.run_folder)
    run.fields_npz.write_bytes(b"estimated again")
    assert ops.apply_results() == {"FINISHED"}
    bpy.context.view_layer.update()
    found = 0
    for item in meshes(scene):
        places, colors = colors_of(item)
        near = np.abs(colors - place_color(places)).max(axis=1) < 0.03 if len(places) else np.zeros(0, bool)
        found += int(near.sum())
        # Faces that were extruded or thickened show another surface, or keep the earlier results.
        assert near.all() or modelling in ("extrude", "applied solidify")
    assert found >= 6


LAMPS = {
    "moved": lambda lamp: setattr(lamp, "location", (1.0, 2.0, 3.0)),
    "turned": lambda lamp: setattr(lamp, "rotation_euler", (0.1, 0.2, 0.3)),
    "scaled": lambda lamp: setattr(lamp, "scale", (2.0, 1.0, 1.0)),
    "hidden": lambda lamp: setattr(lamp, "hide_render", True),
    "modelled": lambda lamp: artist.extrude(lamp.name),
    "subdivided": lambda lamp: artist.apply_modifier(lamp.name, "SUBSURF"),
}


def lamp_state(item: bpy.types.Object) -> tuple:
    bpy.context.view_layer.update()
    matrix = np.array(item.matrix_world).round(5).tolist()
    return artist.faces(item), matrix, item.hide_render, side_radiance(item.data.materials[0])


@pytest.mark.parametrize(("change", "copied"), [*zip(LAMPS, itertools.cycle([False, True])), ("modelled", True)])
def test_applying_again_keeps_what_the_artist_has_made_of_lamps(applied, change, copied):
    lamp = bpy.data.objects["Panel"]
    if copied:  # by Shift D
        other = lamp.copy()
        other.data = lamp.data.copy()
        lamp.users_collection[0].objects.link(other)
        lamp = other
    name = lamp.name
    LAMPS[change](lamp)
    before = {name: lamp_state(bpy.data.objects[name]) for name in {"Panel", name}}
    for _ in range(2):
        assert ops.apply_results() == {"FINISHED"}
        assert {name: lamp_state(bpy.data.objects[name]) for name in before} == before
        assert sorted(row.name for row in applied.fipt.lights.lights) == sorted(before)


# FIPT_SEQUENCES=200 tries more of them.
@pytest.mark.parametrize("seed", range(int(os.environ.get("FIPT_SEQUENCES", "4"))))
def test_nothing_is_lost_in_random_sequences_of_actions(applied, tmp_path, seed):
    sequence = artist_sequences.Sequence(seed, tmp_path)
    try:
        sequence.run()
    except Exception as error:
        raise AssertionError(f"seed {seed}: {', '.join(sequence.done)}: {error!r}") from error


@pytest.mark.parametrize(
    ("how", "density", "modelled"),
    [("delete", 16.0, False), ("delete", 32.0, True), ("remove", 32.0, False), ("hide", 16.0, True)],
)
def test_a_deleted_lamp_stays_deleted_until_revert(applied, modelled, density, how):
    def lamps() -> list[str]:
        return [item.name for item in applied.objects if marks.is_fixture(item)]

    def warnings() -> list[str]:
        return [message["code"] for message in running.last("materials").warnings]

    (lamp,) = (bpy.data.objects[name] for name in lamps())
    faces = {name: len(bpy.data.objects[name].data.polygons) for name in ("panel", "cube")}
    lamp.name = "my lamp"
    if how == "hide":
        lamp.hide_viewport = lamp.hide_render = True
    elif how == "delete":
        artist.only(lamp)
        assert bpy.ops.object.delete() == {"FINISHED"}
    else:
        bpy.data.objects.remove(lamp)
    if modelled:
        artist.subdivide("panel")
    kept = ["my lamp"] if how == "hide" else []
    meshes = len(bpy.data.meshes)
    for _ in range(2):
        applied.fipt.materials.texel_density = density
        assert ops.apply_results() == {"FINISHED"}
        assert lamps() == kept and ("lamps-deleted" in warnings()) is (how != "hide")
        assert modelled or faces == {name: len(bpy.data.objects[name].data.polygons) for name in faces}
    assert len(bpy.data.meshes) <= meshes + 1
    assert ops.revert() == {"FINISHED"} and lamps() == []
    assert ops.apply_results() == {"FINISHED"}
    assert len(lamps()) == 1 and "lamps-deleted" not in warnings()


@pytest.mark.parametrize(
    ("separated", "again"), [((), True), (("panel",), False), (("cube",), True), (("panel", "cube"), False)]
)
def test_revert_names_the_separated_pieces_that_it_hides(applied, capfd, again, separated):
    before = {item.name for item in meshes(applied)}
    for name in separated:
        artist.separate(name)
    if again:
        assert ops.apply_results() == {"FINISHED"}
    pieces = {item.name for item in meshes(applied)} - before
    assert len(pieces) == len(separated)
    capfd.readouterr()
    assert ops.revert() == {"FINISHED"}
    said = [line for line in capfd.readouterr().out.splitlines() if "Hidden" in line]
    assert {name for name in pieces if bpy.data.objects[name].hide_render} == pieces
    assert len(said) == bool(pieces) and all(f"'{name}'" in said[0] for name in pieces)
