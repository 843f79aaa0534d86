# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run shows: results/parts.json of a small room, and the pictures while it works."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.estimate.part_list import write_part_list
from fipt_blender.core.estimate.previews import Preview
from fipt_blender.core.material.groups import Units
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.parts.labels import Parts, label_parts
from fipt_blender.core.pixels.store import fill_pixels, open_pixels
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.parts import read_parts
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.small_rooms import BOX, make_room, table

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


def listed(tmp_path, room, parts, views=(), units=None, fields=None):
    run = RunFolder(tmp_path)
    run.results.mkdir(exist_ok=True)
    units = units or Units(parts.triangle_part, np.ones(int(parts.triangle_part.max()) + 1, bool))
    pixels = SimpleNamespace(ranges=[0, len(SEEN)], triangle=SEEN)
    write_part_list(run, room, parts, views, pixels, fields or Fields(units))
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
    units = Units(np.full(12, -1, np.int32), np.zeros(0, bool))
    fields = SimpleNamespace(units=units, cells=SimpleNamespace(part=np.full(3, -1), points=None))
    room = named(tuple("abcdef"), parts="none")
    _, found = listed(tmp_path, room, Parts(units.triangle, "none"), units=units, fields=fields)
    assert [part.name for part in found] == list("ABCDEF")


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


WIDTH, HEIGHT = 24, 16


def downward_view(folder: Path, name: str, x: float, height: float) -> View:
    """A camera that looks straight down at (x, 0, 0)."""
    image = folder / f"{name}.exr"
    write_exr(image, np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [x, 0.0, height]
    return View(name, "train", image, WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


@pytest.fixture
def preview(tmp_path: Path) -> Preview:
    """Of a floor, mostly shown by the first view, and of a panel beside it, only shown by the second."""
    room = make_room(
        [[[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], [[9, -1, 0], [10, -1, 0], [10, 1, 0], [9, 1, 0]]]
    )
    views = [downward_view(tmp_path, "floor", 0.0, 4.0)]
    views.append(downward_view(tmp_path, "panel", 9.5, 2.0))
    pixels = open_pixels(tmp_path / "pixels", views, create=True)
    fill_pixels(pixels, room, lambda done: None)
    return Preview(tmp_path / "previews", pixels, np.array([0, 0, 1, 1]))


def pictures(preview: Preview, emitters: EmitterTable) -> list[np.ndarray]:
    """Base colour and emission."""

    def colors(rows: np.ndarray) -> np.ndarray:
        return np.full((len(rows), 3), 0.5, np.float32)

    return [np.asarray(Image.open(path)) for path in preview.estimate("training", colors, emitters)]


def test_emission_is_of_a_view_that_shows_a_lamp(preview: Preview) -> None:
    color, emission = pictures(preview, table([2, 3], [30.0, 30.0, 30.0]))
    assert emission.max() > 200 and color.min() > 0  # the whole picture of the base color shows the floor
    color, emission = pictures(preview, table([0], [30.0, 30.0, 30.0]))
    lit = emission.max(axis=2) > 200  # here it is the same view
    assert lit.any() and not lit.all() and (lit == (color.max(axis=2) == 0)).all()
    assert not pictures(preview, EmitterTable.empty())[1].any()
