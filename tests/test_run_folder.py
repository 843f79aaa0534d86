# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A run folder writes nothing outside itself; damaged files, and files that do not fit each other, are refused."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.lock import hold, holder, open_lockable
from fipt_blender.core.run.replacing import atomic_folder
from fipt_blender.core.run.run_files import read_atlas, read_emitters, read_room_files
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import run_job
from samples.child_processes import posix
from samples.refusals import error_of


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "precious").write_text("precious")
    return folder


FOLDERS = (*("results", "report", "textures", "renders", "stage", "survey", "messages", "images", "align"),)
INNER = ("stage/pixels", "renders/rerender", "results/maps", "report/images")


@posix  # elsewhere links need rights
@pytest.mark.parametrize("name", [*FOLDERS, *INNER, "engine.lock", "log.txt", "messages/estimate.jsonl"])
def test_links_that_lead_outside_are_refused(run_folder: RunFolder, outside: Path, name: str) -> None:
    path = run_folder.root / name
    path.parent.mkdir(exist_ok=True)
    if path.is_dir():
        path.rmdir()
    path.symlink_to(outside / "precious" if path.suffix else outside)
    for use in (
        lambda: run_folder.create(make_settings()),
        lambda: run_job.open_job(run_folder, []),
        lambda: hold(run_folder, ["estimate"]).__enter__(),
    ):
        caught = error_of(use)
        assert caught.code == "run-linked" and str(path) in caught.text
    assert [entry.name for entry in outside.iterdir()] == ["precious"]
    assert (outside / "precious").read_text() == "precious"


@posix
def test_links_within_the_folder_and_to_it_are_followed(run_folder: RunFolder, tmp_path: Path) -> None:
    (run_folder.stage / "a").mkdir()
    (run_folder.stage / "b").symlink_to(run_folder.stage / "a")
    (tmp_path / "link").symlink_to(run_folder.root)
    RunFolder(tmp_path / "link").create(make_settings())
    with hold(RunFolder(tmp_path / "link"), ["estimate"]):
        pass


@posix
def test_a_pipe_in_place_of_a_file_stops_nothing(run_folder: RunFolder) -> None:
    for path in (run_folder.engine_lock, run_folder.statistics_json):
        os.mkfifo(path)
    assert holder(run_folder) is None
    assert "no regular file" in str(error_of(read_document, run_folder.statistics_json, dict))


@posix
def test_a_lock_is_no_link_and_no_other_special_file(tmp_path: Path, outside: Path) -> None:
    (tmp_path / "lock").symlink_to(outside / "precious")
    for path in (tmp_path / "lock", Path("/dev/null"), outside):
        assert error_of(open_lockable, path).code == "run-unwritable"
    assert (outside / "precious").read_text() == "precious"


def test_a_damaged_run_json_is_refused(run_folder: RunFolder) -> None:
    settings = ([1], {"preset": ["draft"]}, {"seed": 1e30})
    damaged = [json.dumps({"format": "fipt-run", "version": 1, "settings": each}) for each in settings]
    for content in (*damaged, "", "[]", '{"format": ["fipt-run"], "version": 1}', "[" * 100_000):
        run_folder.run_json.write_text(content)
        assert error_of(run_folder.read).code in ("run-damaged", "setting-unknown", "setting-invalid"), content


def test_a_run_with_settings_that_are_gone_is_read_without_them(run_folder: RunFolder) -> None:
    settings = make_settings("draft", {"seed": 3})
    run_folder.create(settings)
    data = json.loads(run_folder.run_json.read_text())
    data["settings"] |= {"doubt_pixels": False, "lamp_outlines": True, "emission": "joint", "lambda_joint": 0.5}
    run_folder.run_json.write_text(json.dumps(data))
    assert run_folder.read() == settings
    data["settings"]["of_a_newer_version"] = 1
    run_folder.run_json.write_text(json.dumps(data))
    assert error_of(run_folder.read).code == "setting-unknown"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_is_replaced_when_the_new_one_is_complete_never_before(run_folder: RunFolder) -> None:
    results = run_folder.results
    (results / "old").touch()
    with pytest.raises(KeyboardInterrupt), atomic_folder(results) as new:
        (new / "half").touch()
        raise KeyboardInterrupt
    assert names(results) == ["old"] and not new.exists()
    with atomic_folder(results) as new:
        (new / "new").touch()
        assert names(results) == ["old"]
    assert names(results) == ["new"]
    assert not {"results.new", "results.old"} & set(names(run_folder.root))
    # A kill between the two renamings loses nothing.
    results.rename(run_folder.root / "results.old")
    (run_folder.root / "results.new").mkdir()
    run_folder.create(make_settings())
    assert names(results) == ["new"]


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
