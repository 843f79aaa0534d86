"""Furniture that is removed from a room: planes, patterns and materials go on behind it, and it comes back."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest

from fipt_blender import api
from fipt_blender.blend import outliner
from fipt_blender.blend.marks import PART, REMOVED, filled_surfaces, is_fixture
from fipt_blender.blend.results import hidden_surfaces
from fipt_blender.blend.results.completion import complete
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from samples.applied_rooms import use_fake_engine
from samples.at_once import export_room
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")
CHEST = np.array([[-0.4, 0.9, 0.0], [0.4, 1.5, 0.5]])  # lowest and highest corner, metres; it stands at the wall


def pattern(positions):
    """Planks of 0.2 m along X on the floor, tiles of 0.3 m on the wall; linear base colour (N, 3)."""
    x, y, z = positions.T
    floor = np.where(np.floor(y / 0.2) % 2, 0.5, 0.25)
    wall = np.where((np.floor(x / 0.3) + np.floor(z / 0.3)) % 2, 0.7, 0.45)
    tone = np.where(z < 0.01, floor, wall)
    return tone[:, None] * [1.0, 0.8, 0.6]


class Photographed:
    """The estimate of a room of which no photograph shows what lies behind the chest."""

    def query(self, positions, triangles):
        hidden = self.is_hidden(positions)
        color = np.where(hidden[:, None], 0.05, pattern(positions))
        return color, np.where(positions[:, 2] < 0.01, 0.3, 0.8), np.zeros(len(positions))

    def confidence(self, positions, triangles):
        return np.repeat(~self.is_hidden(positions)[:, None], 3, axis=1).astype(float)

    @staticmethod
    def is_hidden(positions):
        return ((positions >= CHEST[0] - 0.01) & (positions <= CHEST[1] + 0.01)).all(axis=1)


def add(name, points, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    item = bpy.data.objects.new(name, mesh)
    outliner.collection(bpy.context.scene, outliner.ROOM).objects.link(item)
    return item


def make_room(folder, monkeypatch, cell=0.03, with_holes=False):
    """Floor and wall of 3 m with a chest in front, and applied results; the mesh may lack what is hidden.

    Args:
        cell: of what is completed, metres; the time grows by the square of their number.
    """
    scene = bpy.context.scene
    low, high = CHEST
    xs = (-1.5, low[0], high[0], 1.5)
    floor = [(x, y, 0.0) for y in (-1.5, low[1], 1.5) for x in xs]
    wall = [(x, 1.5, z) for z in (0.0, high[2], 2.0) for x in xs]
    quads = [(4 * row + k, 4 * row + k + 1, 4 * row + k + 5, 4 * row + k + 4) for row in (0, 1) for k in range(3)]
    holes = {4: floor, 1: wall} if with_holes else {}
    kept = {id(points): [q for k, q in enumerate(quads) if holes.get(k) is not points] for points in (floor, wall)}
    items = [add("floor", floor, kept[id(floor)]), add("wall", wall, kept[id(wall)])]
    box = [(x, y, z) for z in CHEST[:, 2] for y in CHEST[:, 1] for x in CHEST[:, 0]]
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    items.append(add("chest", box, sides))
    bpy.context.view_layer.update()
    run = RunFolder(folder)
    run.create(make_settings())
    export_room(items, run)
    write_json(run.emitters_json, {"fixtures": [], "environment": None})
    write_json(run.statistics_json, {"radiance_scale": 0.36})
    run.fields_npz.write_bytes(b"estimated")
    scene.fipt.run_folder = str(folder)
    scene.fipt.materials.texel_density = 50.0
    scene.fipt.materials.texture_size = "1024"
    use_fake_engine(monkeypatch, Photographed())
    monkeypatch.setattr(hidden_surfaces, "FINEST", cell)
    assert ops.apply_results() == {"FINISHED"}
    return scene


def completed(item):
    """World positions (N, 3) and base colours (N, 3) of the texels of a completed surface."""
    image = item.data.materials[0].node_tree.nodes["FIPT Base Color"].image
    width, height = image.size
    pixels = np.array(image.pixels[:]).reshape(height, width, -1)
    points, colors = [], []
    for polygon in item.data.polygons:
        corners = np.array([item.matrix_world @ item.data.vertices[k].co for k in polygon.vertices])
        uv = np.array([item.data.uv_layers["FIPT"].uv[k].vector for k in polygon.loop_indices])
        low, high = (np.round(uv[k] * (width, height)).astype(int) for k in (0, 2))
        rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]].reshape(2, -1)
        share = (np.stack([columns, rows], axis=1) + 0.5 - low) / (high - low)
        points.append(corners[0] + share[:, :1] * (corners[1] - corners[0]) + share[:, 1:] * (corners[3] - corners[0]))
        colors.append(pixels[rows, columns, :3])
    return np.concatenate(points), np.concatenate(colors)


def signal_to_noise(scene):
    """PSNR in dB of the completed base colours against the pattern, and the completed area, m²."""
    points, colors = (np.concatenate(each) for each in zip(*map(completed, filled_surfaces(scene)), strict=True))
    area = sum(polygon.area for item in filled_surfaces(scene) for polygon in item.data.polygons)
    return -10.0 * np.log10(((colors - pattern(points)) ** 2).mean()), area


def hidden_names(scene):
    return sorted(item.name for item in scene.objects if REMOVED in item and item.hide_render and item.hide_viewport)


@pytest.mark.parametrize("with_holes", [False, True])
def test_planes_and_patterns_go_on_behind_removed_furniture(tmp_path, monkeypatch, with_holes):
    scene = make_room(tmp_path / "run", monkeypatch, 0.01, with_holes)
    names = api.remove_from_room([bpy.data.objects["chest"]])
    assert hidden_names(scene) == ["chest"] and len(names) == 2
    quality, area = signal_to_noise(scene)
    assert quality > 24.0
    api.export(tmp_path / "empty.gltf")
    document = json.loads((tmp_path / "empty.gltf").read_text())
    exported = {node["name"] for node in document["nodes"]}
    assert {*names, "floor"} <= exported and "chest" not in exported
    assert len(document["images"]) >= 4  # each completed surface has textures of its own
    assert 0.88 <= area < 1.6  # floor and wall behind it, and the cells beside that
    for item in filled_surfaces(scene):
        points, _ = completed(item)
        on_floor, on_wall = points[:, 2] < 0.01, points[:, 1] > 1.49
        assert (on_floor | on_wall).all()
        (material,) = item.data.materials
        assert material[PART] == bpy.data.objects["wall" if on_wall.all() else "floor"].data.materials[0][PART]


def test_saving_applying_again_adjusting_and_bringing_back(tmp_path, monkeypatch):
    scene = make_room(tmp_path / "run", monkeypatch)
    assert not ops.bring_back.poll()
    bpy.ops.object.select_all(action="DESELECT")
    assert not ops.remove_from_room.poll()
    bpy.data.objects["chest"].select_set(True)
    assert ops.remove_from_room() == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    scene = bpy.context.scene
    images = [image for image in bpy.data.images if image.name.startswith("FIPT Emptied")]
    assert len(images) == 8 and all(image.filepath.startswith("//room_textures") for image in images)
    assert ops.apply_results() == {"FINISHED"}
    assert hidden_names(scene) == ["chest"] and len(filled_surfaces(scene)) == 2
    part = next(row for row in scene.fipt.materials.parts if "wall" in row.name.lower())
    part.value = 0.5  # what completes a part is adjusted with it
    assert len(api.blender_materials(part)) == 2
    ops.show_map(shown="ROUGHNESS")
    ops.show_map(shown="ORIGINAL")
    assert filled_surfaces(scene)[0].users_collection[0].hide_render
    ops.show_map(shown="ESTIMATED")
    assert ops.bring_back() == {"FINISHED"}
    assert hidden_names(scene) == [] and filled_surfaces(scene) == []
    assert not bpy.data.objects["chest"].hide_render
    assert not [image for image in bpy.data.images if image.name.startswith("FIPT Emptied")]


def test_faces_and_boxes_are_separated_and_revert_restores(tmp_path, monkeypatch):
    scene = make_room(tmp_path / "run", monkeypatch)
    chest = bpy.data.objects["chest"]
    box = bpy.data.objects.new("box", None)
    box.empty_display_type, box.location, box.scale = "CUBE", (0.0, 1.2, 0.5), (1.0, 1.0, 0.1)
    scene.collection.objects.link(box)
    bpy.context.view_layer.update()
    assert "Nothing of the room" in refused(ops.remove_from_room) if box.select_get() else True
    api.remove_from_room(box=box)  # the lid of the chest
    assert len(chest.data.polygons) == 5 and len(hidden_names(scene)) == 1
    ops.bring_back()
    assert len(scene.objects) == 5
    bpy.context.view_layer.objects.active = chest
    chest.select_set(True)
    chest.data.polygons.foreach_set("select", np.ones(5, bool))
    bpy.ops.object.mode_set(mode="EDIT")
    assert ops.remove_from_room() == {"FINISHED"}
    assert bpy.context.mode == "OBJECT" and "chest" in hidden_names(scene)
    assert filled_surfaces(scene)
    assert ops.revert() == {"FINISHED"}
    assert not filled_surfaces(scene) and not chest.hide_render and len(chest.data.polygons) == 6


def test_completion_of_what_is_hardly_known():
    values = np.full((9, 9, 5), 0.5, np.float32)
    known = np.zeros((9, 9), bool)
    known[:, :2] = True
    filled, source = complete(np.where(known[..., None], values, 0.0), known, ~known)
    assert np.allclose(filled, 0.5) and (source % 9 < 2).all()


def test_removed_objects_with_modifiers_and_lamps_stay_as_they_are_when_applied_again(applied):
    cube, lamp = bpy.data.objects["cube"], next(item for item in applied.objects if is_fixture(item))
    faces, materials = len(cube.data.polygons), [slot.material for slot in cube.material_slots]
    api.remove_from_room([cube, lamp])
    name = lamp.name
    for _ in range(2):
        assert ops.apply_results() == {"FINISHED"}
        assert hidden_names(applied) == sorted(["cube", name])
        assert len(cube.data.polygons) == faces
        assert [slot.material for slot in cube.material_slots] == materials
    export_room([cube], RunFolder(bpy.path.abspath(applied.fipt.run_folder)))
    assert ops.bring_back() == {"FINISHED"} and hidden_names(applied) == []
