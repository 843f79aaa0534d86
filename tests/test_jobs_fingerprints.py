# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingerprints change with every file that a job reads, and with no other."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from fipt_blender.blend.capture import mesh_names
from fipt_blender.jobs.fingerprints import folder_fingerprint, mesh_fingerprint


def write(path: Path, content: str | bytes = "x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def depends(find: Callable[[], str], path: Path) -> bool:
    """Whether a fingerprint changes with a file: with its time, and with its being there."""
    before = find()
    assert find() == before
    write(path, b"some other content")
    os.utime(path, (1e9, 1e9))
    changed = find() != before
    path.unlink()
    gone = find() != before
    assert changed or not gone
    return changed


def test_a_folder_counts_completely_but_for_the_output(tmp_path: Path) -> None:
    capture = tmp_path / "capture"
    for name in ("transforms.json", "0.exr", "masks/0.png", "run/x"):
        write(capture / name)
    for path in (capture, capture / "transforms.json"):
        for spelling in (capture / "run", capture / "masks" / ".." / "run"):
            find = partial(folder_fingerprint, path, exclude=spelling)
            assert depends(find, capture / "1.exr") and depends(find, capture / "masks" / "1.png")
            assert not depends(find, capture / "run" / "y")
        assert depends(partial(folder_fingerprint, path), capture / "run" / "y")
    before = folder_fingerprint(capture)
    (capture / "dangling").symlink_to(tmp_path / "nowhere")
    assert folder_fingerprint(capture) == before


@pytest.mark.parametrize("name", ["room.ply", "room.stl", "room.glb", "room.fbx", "room.obj", "room.usdz"])
def test_files_beside_a_mesh_do_not_count_but_those_below_a_usd_file(name: str, tmp_path: Path) -> None:
    mesh = write(tmp_path / name)
    find = partial(mesh_fingerprint, mesh)
    assert not depends(find, tmp_path / "letter.txt") and not depends(find, tmp_path / "films" / "a.mkv")
    before = find()
    os.utime(mesh, (1e9, 1e9))
    assert find() != before
    stage = write(tmp_path / "usd" / "room.usda")
    assert depends(partial(mesh_fingerprint, stage), stage.parent / "layers" / "walls.usdc")
    assert not depends(partial(mesh_fingerprint, stage, stage.parent / "run"), stage.parent / "run" / "x")


def test_the_files_that_an_obj_names_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_names, "BLOCK", 64)
    text = "# scan\no a\n" + "v 0 0 0\n" * 40 + "mtllib  a room.mtl\r\nmtllib one.mtl two.mtl\nf 1 2 3\n"
    mesh = write(tmp_path / "room.obj", text)
    find = partial(mesh_fingerprint, mesh)
    for name in ("a room.mtl", "one.mtl", "two.mtl", "room.mtl"):  # the last by its name, as Blender finds it
        assert depends(find, tmp_path / name), name
    lines = ["newmtl a", "map_Kd -s 1 1 1 oak floor.png", "\tmap_bump maps\\bump.png", "Kd 1 0 0", "NORM n.png"]
    write(tmp_path / "one.mtl", "\n".join(lines))
    for name in ("oak floor.png", "maps/bump.png", "n.png"):
        assert depends(find, tmp_path / name), name
    assert not depends(find, tmp_path / "other.png")
    write(tmp_path / "one.mtl", b"map_Kd a\0b\nmap_Kd \xff\xfe\nmap_Kd " + b"long" * 5000)
    assert find()


def test_the_files_that_a_gltf_names_count(tmp_path: Path) -> None:
    uris = ["room%20a.bin", "data:application/octet-stream;base64,AAAA"]
    document = {"buffers": [{"uri": uri} for uri in uris] + [{}], "images": [{"uri": "maps/oak.png"}]}
    text = json.dumps(document).encode()
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON")
    for mesh in (write(tmp_path / "room.gltf", text), write(tmp_path / "room.glb", head + text)):
        find = partial(mesh_fingerprint, mesh)
        assert depends(find, tmp_path / "room a.bin") and depends(find, tmp_path / "maps" / "oak.png")
        assert not depends(find, tmp_path / "other.bin")


@pytest.mark.parametrize("name", ["a.gltf", "a.glb", "a.obj"])
def test_damaged_files_have_fingerprints_too(name: str, tmp_path: Path) -> None:
    for content in ("", "{", "[1]", '{"images": 5}', b"glTF" + b"\xff" * 30, "[" * 100_000, '{"buffers": [0]}'):
        assert len(mesh_fingerprint(write(tmp_path / name, content))) == 24
