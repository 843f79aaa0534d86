# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Furniture that is removed from a room: planes, patterns and materials go on behind it, and it comes back."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from fipt_blender import api
from fipt_blender.blend import outliner
from fipt_blender.blend.marks import FILLED, PART, REMOVED, filled_surfaces
from fipt_blender.blend.results.completion import complete
from fipt_blender.blend.room import exporting
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from samples.applied_rooms import use_fake_engine
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


def make_room(folder, monkeypatch, with_holes=False):
    """Floor and wall of 3 m with a chest in front, and applied results; the mesh may lack what is hidden."""
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
    exporting.export_room(items, run)
    write_json(run.emitters_json, {"fixtures": [], "environment": None})
    write_json(run.statistics_json, {"radiance_scale": 0.36})
    run.fields_npz.write_bytes(b"estimated")
    scene.fipt.run_folder = str(folder)
    scene.fipt.materials.texel_density = 50.0
    scene.fipt.materials.texture_size = "1024"
    use_fake_engine(monkeypatch, Photographed())
    assert ops.apply_results() == {"FINISHED"}
    return scene


def colors_on(item):
    """World positions (N, 3) and base colour (N, 3) of the faces' centres of a completed surface."""
    from fipt_blender.blend.results.hidden_surfaces import Room

    room = Room([item])
    centers = room.corners.mean(axis=1)
    return centers, room.maps(np.arange(len(centers)), centers)


def errors(scene):
    """Root of the mean squared error of the completed colours, and the area that was completed, m²."""
    squared, area = [], 0.0
    for item in filled_surfaces(scene):
        cells = np.array([polygon.area for polygon in item.data.polygons]).sum()
        image = item.data.materials[0].node_tree.nodes["FIPT Base Color"].image
        width, height = image.size
        size = np.ptp([item.matrix_world @ vertex.co for vertex in item.data.vertices], axis=0)
        assert size.max() > 0.5 and width > 50 and height > 50
        area += cells
        tree = np.random.default_rng(1).uniform(size=(4000, 2))
        for polygon in item.data.polygons:
            corners = np.array([item.matrix_world @ item.data.vertices[k].co for k in polygon.vertices])
            centre = corners.mean(axis=0)
            uv = np.mean([item.data.uv_layers["FIPT"].uv[k].vector for k in polygon.loop_indices], axis=0)
            pixels = np.array(image.pixels[:]).reshape(height, width, -1)
            value = pixels[int(uv[1] * height), int(uv[0] * width), :3]
            squared.append(((value - pattern(centre[None])[0]) ** 2).mean())
        del tree
    return float(np.sqrt(np.mean(squared))), area
