# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""results/parts.json of a small room: names, counts, classes and mean values of its parts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.estimate.part_list import write_part_list
from fipt_blender.core.material.groups import Units
from fipt_blender.core.parts.labels import Parts, label_parts
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.parts import read_parts
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.small_rooms import BOX, make_room

# Floor, ceiling and four walls of a box; a row of pixels sees all but the last wall.
SEEN = np.repeat(np.arange(10), 3)


class Fields:
    """Base colour x, roughness 0.5, metallic 1; cells at x = 0.1 and 0.3 in unit 0, one in unit 1."""

    def __init__(self, units):
        self.units = units
        points = np.array([[0.1, 0, 0], [0.3, 0, 0], [0.5, 0, 0]], np.float32)
        self.cells = SimpleNamespace(part=np.array([0, 0, 1], np.int32), points=points)

    def query(self, positions, triangles):
        count = len(positions)
        assert (self.units.triangle[triangles] == self.cells.part).all()
        return np.repeat(positions[:, :1], 3, axis=1), np.full(count, 0.5), np.ones(count)

    def confidence(self, positions, triangles):
        return np.tile([1.0, 0.5, 0.0], (len(positions), 1))


def named(objects, **names):
    """The box with named objects: one for each side, or one for all."""
    room = make_room(BOX, np.arange(6) if len(objects) > 1 else np.zeros(6, int))
    return replace(room, objects=objects, **names)


def listed(tmp_path, room, parts, views=(), units=None):
    run = RunFolder(tmp_path)
    run.results.mkdir(exist_ok=True)
    units = units or Units(parts.triangle_part, np.ones(int(parts.triangle_part.max()) + 1, bool))
    pixels = SimpleNamespace(ranges=[0, len(SEEN)], triangle=SEEN)
    write_part_list(run, room, parts, views, pixels, Fields(units))
    np.savez(run.parts_npz, triangle_part=units.triangle, single=units.single)
    return run, read_parts(run, room.triangle_object, room.objects).parts


def test_objects_give_names_counts_and_values(tmp_path):
    names = ("floor_boards", "Ceiling", "Wall", "Wall.001", "Wall.002", "Wall.003")
    room = named(names, parts="objects", materials=names)
    run, parts = listed(tmp_path, room, label_parts(room, "objects", [], []))
    assert [part.name for part in parts] == ["Floor boards", *names[1:]]
    assert [part.pixels for part in parts] == [6, 6, 6, 6, 6, 0]
    assert parts[0].key == "object:floor_boards"
    assert parts[0].base_color == pytest.approx((0.2, 0.2, 0.2))
    assert (parts[1].roughness, parts[1].metallic, parts[1].confidence) == (0.5, 1.0, (1.0, 0.5, 0.0))
    assert parts[2].base_color is None and parts[2].confidence is None  # it has no cell
    assert read_document(run.parts_json, dict)["parts"][0]["area"] == pytest.approx(16.0)


def test_places_name_the_parts_of_one_mesh(tmp_path):
    room = named(("scan",), parts="masks")
    part = np.repeat(np.arange(6, dtype=np.int32), 2)
    part[-1] = 6  # half of the last wall is above a floor's area, but its part is not large
    _, parts = listed(tmp_path, room, Parts(part, "part", np.arange(7) + 40))
    names = [each.name for each in parts]
    assert names[:4] == ["Floor", "Ceiling", "Wall", "Wall 2"]
    assert [each.key for each in parts] == [f"mask:{index + 40}" for index in range(7)]


def test_semantic_masks_give_classes(tmp_path):
    room = named(("scan",), parts="semantics")
    folder = tmp_path / "semantics"
    folder.mkdir()
    write_json(folder / "classes.json", {"7": "painted wall"})
    ids = np.full((1, len(SEEN)), 9)
    ids[0, SEEN >= 4] = 7
    view = SimpleNamespace(parts=None, semantics=folder / "a.png", semantic_ids=lambda: ids)
    parts = label_parts(room, "semantics", [ids], [SEEN])
    _, found = listed(tmp_path, room, parts, [view], Units(parts.triangle_part, np.zeros(2, bool)))
    assert [(each.name, each.class_name, each.single) for each in found] == [
        ("Painted wall", "painted wall", False),
        ("Class 9", None, False),
    ]


def test_no_parts_leave_the_objects(tmp_path):
    room = named(tuple("abcdef"), parts="none")
    nothing = np.full(12, -1, np.int32)
    run = RunFolder(tmp_path)
    run.results.mkdir()
    fields = SimpleNamespace(
        units=Units(nothing, np.zeros(0, bool)), cells=SimpleNamespace(part=np.full(3, -1), points=None)
    )
    pixels = SimpleNamespace(ranges=[0, len(SEEN)], triangle=SEEN)
    write_part_list(run, room, Parts(nothing, "none"), [], pixels, fields)
    np.savez(run.parts_npz, triangle_part=nothing, single=np.zeros(0, bool))
    assert [part.name for part in read_parts(run, room.triangle_object, room.objects).parts] == list("ABCDEF")


def test_slots_name_the_parts_of_a_modelled_mesh(tmp_path):
    """Brass is not called after the rod that is made of it; a material that nobody named has no name."""
    material = np.repeat([0, 1, 0, 2, 3, -1], 2).astype(np.int32)
    names = ("Curtain_rod", "Table", "Knob", "Shelf", "Door", "Rug")
    materials = ("Brass", "Brushed_steel", "Material.001", "Gloss")
    room = replace(named(names, parts="auto", materials=materials), triangle_material=material)
    ids = np.repeat([5, 6, 5, 7, 8, 9], 2)
    view = SimpleNamespace(parts="a.png", semantics=None)
    parts = label_parts(room, "masks", [ids[None]], [np.arange(12)])
    _, found = listed(tmp_path, room, parts, [view])
    assert [each.name for each in found] == ["Rug", "Brass", "Brushed steel", "Shelf", "Gloss"]
    assert [each.key for each in found][:3] == ["object:Rug", "material:Brass", "material:Brushed_steel"]
