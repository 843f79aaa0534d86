# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading the parts of a run: units, what no unit holds, runs that describe none, and damaged files."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.core.run import parts
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.refusals import error_of

OBJECTS = ["Side_table", "floor"]
OF_OBJECT = np.array([0, 0, 0, 1, 1], np.int32)


def entry(index, name, pixels=10):
    return {
        "id": index, "key": f"mask:{index + 1}", "name": name, "single": True, "class": None, "triangles": 1,
        "pixels": pixels, "area": 1.0, "base_color": [0.1, 0.2, 0.3], "roughness": 0.5, "metallic": 0.0,
        "confidence": [1.0, 0.5, 0.0],
    }  # fmt: skip


@pytest.fixture
def run(tmp_path):
    folder = RunFolder(tmp_path)
    folder.results.mkdir()
    write(folder, [0, 0, -1, 1, -1], [entry(0, "Top"), entry(1, "Floor")])
    return folder


def write(folder, units, entries, **changes):
    np.savez(folder.parts_npz, triangle_part=np.array(units, np.int32), single=np.ones(len(entries), bool))
    document = {"format": "fipt-parts", "version": 1, "source": "masks", "parts": entries}
    write_json(folder.parts_json, document | changes)


def names(found: parts.RoomParts) -> list[str]:
    return [found.parts[index].name for index in found.triangle]


def test_units_and_the_rest_of_objects_are_parts(run):
    found = parts.read_parts(run, OF_OBJECT, OBJECTS)
    assert names(found) == ["Top", "Top", "Side table", "Floor", "Floor 2"]  # names are unique
    assert found.source == "masks"
    top, rest = found.parts[found.triangle[0]], found.parts[found.triangle[2]]
    assert (top.triangles, top.pixels, top.roughness, top.key) == (2, 10, 0.5, "mask:1")
    assert (rest.unit, rest.key, rest.roughness) == (parts.NO_UNIT, "rest:Side_table", None)


def test_units_of_few_pixels_join_the_rest_of_their_object(run, monkeypatch):
    monkeypatch.setattr(parts, "MOST_PARTS", 1)
    write(run, [0, 0, -1, 1, -1], [entry(0, "Top", 5), entry(1, "Floor", 9)])
    assert names(parts.read_parts(run, OF_OBJECT, OBJECTS)) == [*["Side table"] * 3, "Floor", "Floor 2"]


def test_a_run_without_description_has_its_objects_as_parts(run):
    run.parts_json.unlink()
    assert names(parts.read_parts(run, OF_OBJECT, OBJECTS)) == ["Side table"] * 3 + ["Floor"] * 2


@pytest.mark.parametrize(
    ("units", "change"),
    [
        ([0, 0, -1, 1, -1], {"version": 2}),
        ([0, 0, -1, 1, -1], {"parts": [entry(0, "Top")]}),
        ([0, 0, -1, 1, -1], {"parts": [entry(1, "Top"), entry(0, "Floor")]}),
        ([0, 0, -1, 1, -1], {"parts": [entry(0, "Top"), entry(1, "Floor") | {"roughness": 2.0}]}),
        ([0, 0, 1], {}),
        ([0, 0, 2, 1, 1], {}),
    ],
)
def test_damaged_descriptions_and_units_of_another_room_are_refused(run, units, change):
    write(run, units, [entry(0, "Top"), entry(1, "Floor")], **change)
    assert error_of(parts.read_parts, run, OF_OBJECT, OBJECTS).code == "file-damaged"
