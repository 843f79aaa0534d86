# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Array files and documents of a run folder that are damaged or do not fit each other are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.run.run_files import read_atlas, read_emitters, read_room_files
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.refusals import error_of

ROOM = {
    "vertices": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32),
    "triangles": np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    "corner_normals": np.tile(np.float32([0, 0, 1]), (2, 3, 1)),
    "triangle_object": np.zeros(2, np.int32),
    "triangle_material": np.array([-1, 0], np.int32),
    "triangle_polygon": np.zeros(2, np.int32),
}
ATLAS = {"corner_uv": np.zeros((2, 3, 2), np.float32), "triangle_image": np.array([0, -1], np.int32)}
IMAGE = {"name": "Room.001", "width": 8, "height": 8}
FIXTURE = {"name": "a", "triangles": [0, 1], "radiance": [1, 1, 1], "back_radiance": [0, 0, 0]}


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    folder = RunFolder(tmp_path)
    np.savez(folder.room_npz, **ROOM)
    write_json(folder.room_json, {"objects": ["a"], "materials": ["b"]})
    np.savez(folder.atlas_npz, **ATLAS)
    write_json(folder.atlas_json, {"mode": "uv", "images": [IMAGE]})
    write_json(folder.emitters_json, {"fixtures": [FIXTURE], "environment": None})
    return folder


def read_all(run: RunFolder) -> None:
    room, _ = read_room_files(run)
    read_atlas(run, len(room["triangles"]))
    read_emitters(run, len(room["triangles"]))


def refused(run: RunFolder) -> str:
    caught = error_of(read_all, run)
    assert caught.code == "file-damaged" and caught.remedy
    return caught.text


@pytest.mark.parametrize("name", ["room.npz", "atlas.npz"])
def test_damaged_archives_are_refused(run: RunFolder, name: str) -> None:
    path = run.root / name
    data = path.read_bytes()
    encrypted = data.replace(b"PK\x01\x02-\x03-\x00\x00", b"PK\x01\x02-\x03-\x00\x01")
    damaged = (data[: len(data) // 2], data[:30] + bytes(100) + data[130:], encrypted)
    for content in (*damaged, b"", b"PK\x05\x06" + bytes(18), b"\x80\x04N."):
        path.write_bytes(content)
        assert content != data and name in refused(run)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"triangles": ROOM["triangles"] + 5}, "missing vertices"),
        ({"triangle_object": ROOM["triangle_object"] + 1}, "missing objects"),
        ({"triangle_material": ROOM["triangle_material"] + 1}, "missing materials"),
        ({"triangles": ROOM["triangles"].astype(np.float32)}, "whole numbers"),
        ({"vertices": ROOM["vertices"][:, :2]}, "vertices"),
        ({"corner_normals": ROOM["corner_normals"][:1]}, "corner_normals"),
        ({"triangle_polygon": np.array(["x", "y"])}, "triangle_polygon"),
    ],
)
def test_a_room_that_does_not_fit_itself_is_refused(run: RunFolder, change: dict, text: str) -> None:
    np.savez(run.room_npz, **{**ROOM, **change})
    assert text in refused(run)


def test_an_atlas_of_another_room_is_refused(run: RunFolder) -> None:
    longer = {"corner_uv": np.zeros((3, 3, 2)), "triangle_image": np.zeros(3, int)}
    for change in ({"triangle_image": np.array([1, 0], np.int32)}, longer):
        np.savez(run.atlas_npz, **{**ATLAS, **change})
        assert "does not fit" in refused(run)


def test_names_of_images_are_file_names(run: RunFolder) -> None:
    for name in ("../../EVIL", "..", "", "a/b", "a\\b", "C:x", "a\0b", "x" * 300, ".hidden", "a\n", 5):
        run.atlas_json.write_text(json.dumps({"mode": "uv", "images": [{**IMAGE, "name": name}]}))
        assert "images[0].name should be a file name" in refused(run), name


def test_fixtures_of_another_room_are_refused(run: RunFolder) -> None:
    write_json(run.emitters_json, {"fixtures": [{**FIXTURE, "triangles": [2]}], "environment": None})
    assert "triangles that the room lacks" in refused(run)
    write_json(run.emitters_json, {"fixtures": [], "environment": {"image": "../../x.exr"}})
    assert "environment.exr" in refused(run)
