# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of fixtures from objects, materials, places and shapes, on rooms of boxes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.report.fixture_names import fixture_names, words
from fipt_blender.core.run.parts import RoomPart, RoomParts, free_name

SHELL = ((0.0, 0.0, 0.0), (6.0, 5.0, 3.0))
_FACES = [
    (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6),
    (0, 6, 2), (1, 3, 7), (1, 7, 5),
]  # fmt: skip


def room_of(*boxes: tuple[str, tuple, tuple], material: str = "") -> tuple[SimpleNamespace, list[np.ndarray]]:
    """A room of boxes (object, low, high), and the triangles of each; the last box may have a material."""
    vertices, triangles, owner, pieces = [], [], [], []
    objects = list(dict.fromkeys(name for name, _, _ in boxes))
    for name, low, high in boxes:
        corners = [(x, y, z) for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
        pieces.append(np.arange(len(triangles), len(triangles) + 12))
        triangles += [tuple(index + len(vertices) for index in face) for face in _FACES]
        vertices += corners
        owner += [objects.index(name)] * 12
    count = len(triangles)
    of_material = np.full(count, -1, np.int32)
    if material:
        of_material[pieces[-1]] = 0
    room = SimpleNamespace(
        vertices=np.array(vertices, np.float32),
        triangles=np.array(triangles, np.int32),
        triangle_object=np.array(owner, np.int32),
        triangle_material=of_material,
        objects=objects,
        materials=[material] if material else [],
    )
    return room, pieces


def name_of(*boxes: tuple[str, tuple, tuple], material: str = "") -> str:
    """The name of the lamp that the last box is."""
    room, pieces = room_of(*boxes, material=material)
    (name,) = fixture_names(room, [{"triangles": pieces[-1].tolist()}])
    return name


def test_words_of_names():
    assert words("CeilingPanel_light.001") == ["ceiling", "panel", "light"]
    assert words("12-34") == [] and words("Lámpara 2") == ["lámpara"]
    assert free_name("Lamp", []) == "Lamp" and free_name("Lamp", ["Lamp", "Lamp 2"]) == "Lamp 3"


def test_an_object_that_is_a_lamp_gives_its_name():
    assert name_of(("Shell", *SHELL), ("Reading_Lamp.002", (1, 1, 1), (1.2, 1.2, 1.2))) == "Reading lamp"


def test_a_bulb_is_named_after_the_lamp_that_holds_it():
    table_lamp = ("Table_lamp", (1.0, 1.0, 0.8), (1.3, 1.3, 1.2))
    bulb = ("Bulb", (1.1, 1.1, 1.25), (1.2, 1.2, 1.35))
    assert name_of(("Shell", *SHELL), table_lamp, bulb) == "Table lamp bulb"
    far = ("Bulb", (4.1, 4.1, 1.25), (4.2, 4.2, 1.35))
    assert name_of(("Shell", *SHELL), table_lamp, far) == "Table bulb"


def test_a_material_tells_where_the_object_does_not():
    lamp = ("scan", (1, 1, 1), (1.2, 1.2, 1.2))
    assert name_of(("scan", *SHELL), lamp, material="DeskLamp_glow") == "Desk lamp glow"


@pytest.mark.parametrize(
    ("low", "high", "name"),
    [
        ((2, 2, 2.98), (3, 3, 3.0), "Ceiling panel"),
        ((1, 2, 2.96), (4, 2.1, 3.0), "Ceiling strip"),
        ((0.0, 2, 1.5), (0.02, 3, 2.3), "Wall panel"),
        ((2, 2, 0.01), (2.4, 2.5, 0.5), "Floor lamp"),
        ((2, 2, 0.9), (2.1, 2.1, 1.0), "Table bulb"),
        ((2, 2, 2.2), (2.5, 2.4, 2.5), "Hanging lamp"),
    ],
)
def test_place_and_shape_in_a_room_that_is_one_mesh(low, high, name):
    if name == "Wall panel":  # a box has no mean normal: only the side towards the room emits
        room, pieces = room_of(("scan", *SHELL), ("scan", low, high))
        assert fixture_names(room, [{"triangles": pieces[-1][10:].tolist()}]) == [name]
    else:
        assert name_of(("scan", *SHELL), ("scan", low, high)) == name


def test_lamps_in_a_part_of_the_shell_are_numbered_in_order():
    lamps = [("Ceilings", (x, 2, 2.9), (x + 0.4, 2.4, 2.91)) for x in (1.0, 2.0)]
    room, pieces = room_of(("Floor", (0, 0, 0), (6, 5, 0.1)), ("Ceilings", (0, 0, 2.9), (6, 5, 3.0)), *lamps)
    entries = [{"triangles": piece.tolist()} for piece in pieces[2:]]
    assert fixture_names(room, entries) == ["Ceiling panel", "Ceiling panel 2"]
    assert fixture_names(room, [{"triangles": []}]) == ["Lamp"]


@pytest.mark.parametrize(
    ("class_name", "name"), [("floor lamp", "Floor lamp"), ("walls", "Wall bulb"), ("", "Table bulb")]
)
def test_classes_of_parts_tell_where_objects_do_not(class_name, name):
    room, pieces = room_of(("scan", *SHELL), ("scan", (2, 2, 0.9), (2.1, 2.1, 1.0)))
    triangle = np.zeros(len(room.triangles), np.int32)
    triangle[pieces[1]] = 1
    parts = RoomParts(triangle, [RoomPart(0, "a", "A"), RoomPart(1, "b", "B", class_name=class_name)])
    assert fixture_names(room, [{"triangles": pieces[1].tolist()}], parts) == [name]
