# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean Up: pictures of earlier results go when no .blend file that is known shows them, and nothing else."""

from __future__ import annotations

import gzip
import random
import shutil
from pathlib import Path

import bpy
import pytest

from fipt_blender.blend import marks
from fipt_blender.blend.collecting import missing_pictures
from fipt_blender.blend.unused_pictures import unused_pictures
from fipt_blender.core.run.runfolder import RunFolder
from samples.applied_rooms import ConstantFields
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def estimate_again(monkeypatch):
    """A function that applies a result with a new base colour and returns the name of its folder."""
    count = 0

    def applied() -> str:
        nonlocal count
        count += 1
        monkeypatch.setattr(ConstantFields, "base_color", (0.05 * count, 0.3, 0.1))
        scene = bpy.context.scene
        RunFolder(scene.fipt.run_folder).fields_npz.write_bytes(b"estimate %d" % count)
        assert ops.apply_results() == {"FINISHED"}
        return shown()

    return applied


def shown() -> str:
    """The name of the folder of the pictures that the open file shows."""
    (name,) = {Path(image.filepath).parent.name for image in bpy.data.images if marks.TEXTURE in image}
    return name


def sets(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} if folder.is_dir() else set()


@pytest.mark.parametrize(
    ("keep", "kind", "place"),
    [
        ("IN_RUN", "zstd", "beside"),
        ("BESIDE", "gzip", "backup"),
        ("IN_RUN", "plain", "run"),
        ("BESIDE", "zstd", "recent"),
    ],
)
def test_pictures_of_known_files_stay(scene, tmp_path, monkeypatch, estimate_again, keep, kind, place):
    blend = tmp_path / "shot" / "kitchen.blend"
    blend.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    scene.fipt.materials.texture_files = keep
    run = RunFolder(scene.fipt.run_folder).root
    store = run / "applied" if keep == "IN_RUN" else blend.with_name("kitchen_textures")
    away = tmp_path / "other" / "shot.blend"
    other = {
        "beside": blend.with_name("copy.blend"),
        "backup": blend.with_name("kitchen.blend2"),
        "run": run / "room.blend",
        "recent": away,
    }[place]
    other.parent.mkdir(exist_ok=True)
    if place == "recent":
        (tmp_path / "recent-files.txt").write_text(f"{tmp_path / 'gone.blend'}\n{away}\n")
        monkeypatch.setattr(bpy.utils, "user_resource", lambda kind, path="", **_: str(tmp_path / path))
    first = estimate_again()
    bpy.ops.wm.save_as_mainfile(filepath=str(other), copy=True, compress=kind == "zstd")
    if kind == "gzip":
        other.write_bytes(gzip.compress(other.read_bytes()))
    second, third = estimate_again(), estimate_again()
    bpy.ops.wm.save_mainfile()
    assert sets(store) == {first, second, third}
    assert ops.clean_up_pictures() == {"FINISHED"}
    assert sets(store) == {first, third}
    other.unlink()
    assert ops.clean_up_pictures() == {"FINISHED"}
    assert sets(store) == {third} and not missing_pictures()


@pytest.mark.parametrize("seed", range(2))
def test_every_file_that_is_left_shows_its_pictures(scene, tmp_path, estimate_again, seed):
    rng = random.Random(seed)
    blend = tmp_path / "kitchen.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    made: dict[Path, str] = {}
    for index in range(5):
        name = estimate_again()
        for path in (blend, tmp_path / f"copy{index}.blend"):
            if rng.random() < 0.5:
                bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=path != blend, compress=rng.random() < 0.5)
                made[path] = name
    for path in [path for path in made if path != blend and rng.random() < 0.4]:
        path.unlink()
        del made[path]
    backups = set()
    if (backup := blend.with_name("kitchen.blend1")).is_file():
        with bpy.data.libraries.load(str(backup)) as (_, _):
            backups = {each for each in sets(tmp_path / "kitchen_textures") if each.encode() in _bytes(backup)}
    ops.clean_up_pictures()
    assert sets(tmp_path / "kitchen_textures") == {*made.values(), shown()} | backups
    for path in made:
        bpy.ops.wm.open_mainfile(filepath=str(path))
        assert not missing_pictures() and shown() == made[path]


def _bytes(path: Path) -> bytes:
    import zstandard

    data = path.read_bytes()
    if data[:4] != b"\x28\xb5\x2f\xfd":
        return data
    with open(path, "rb") as file:
        return zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True).read()


@pytest.mark.parametrize(
    ("fault", "compress"),
    [("half", False), ("half", True), ("empty", False), ("flipped", True), ("no Blender file", False)],
)
def test_a_file_that_can_not_be_read_may_use_all(scene, tmp_path, estimate_again, compress, fault):
    blend, damaged = tmp_path / "kitchen.blend", tmp_path / "damaged.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    estimate_again()
    bpy.ops.wm.save_as_mainfile(filepath=str(damaged), copy=True, compress=compress)
    data = bytearray(damaged.read_bytes())
    if fault == "flipped":
        data[:] = data[:2000] + bytes(2000) + data[4000:-100] + bytes(100)
    content = {"half": data[: len(data) // 2], "empty": b"", "flipped": data, "no Blender file": b"PK" * 99}
    damaged.write_bytes(content[fault])
    estimate_again()
    before = sets(tmp_path / "kitchen_textures")
    assert unused_pictures() == ([], [damaged])
    assert ops.clean_up_pictures() == {"FINISHED"}
    assert sets(tmp_path / "kitchen_textures") == before and len(before) == 2


def test_nothing_but_folders_of_pictures_is_removed(scene, tmp_path, estimate_again):
    blend = tmp_path / "kitchen.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    old, present = estimate_again(), estimate_again()
    store = tmp_path / "kitchen_textures"
    kept = {present, "mine", "0123456789ab", "abcdefabcdef", "link0123", "ffffffffffff"}
    (store / "mine").mkdir()
    shutil.copytree(store / old, store / "0123456789ab")
    (store / "0123456789ab" / "notes.txt").write_text("the artist's")
    (store / "abcdefabcdef").write_text("a file")
    shutil.copytree(store / old, store / "link0123")
    (store / "ffffffffffff").symlink_to(store / "link0123", target_is_directory=True)
    others = tmp_path / "other_textures" / old
    shutil.copytree(store / old, others)  # of another file, which may lie elsewhere
    assert ops.clean_up_pictures() == {"FINISHED"}
    assert sets(store) == kept and others.is_dir()


def test_what_undo_may_bring_back_stays(scene, tmp_path, estimate_again):
    blend = tmp_path / "kitchen.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    old = estimate_again()
    bpy.ops.ed.undo_push(message="before")
    estimate_again()
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.save_mainfile()  # twice: the backup shows the new result, too
    assert "Undo" in refused(ops.clean_up_pictures)
    bpy.ops.ed.undo()
    assert shown() == old and not missing_pictures()
    assert "Undo" in refused(ops.clean_up_pictures)  # Redo
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    assert ops.clean_up_pictures() == {"FINISHED"}
    assert sets(tmp_path / "kitchen_textures") == {shown()} != {old}
