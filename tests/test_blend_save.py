"""Files that Blender can't write: what the user reads, whatever Blender names as the reason."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import bpy
import pytest

from fipt_blender.blend import save
from fipt_blender.blend.pictures import cycles, image_files
from fipt_blender.core.run.errors import FiptError
from samples.refusals import error_of


def saving_fails(path: Path) -> FiptError:
    path.mkdir(parents=True)  # Blender can't replace a folder
    return error_of(save.save_blend, path)


def fail(number: int):
    def reserve(folder: Path) -> None:
        raise OSError(number, os.strerror(number))

    return reserve


@pytest.mark.parametrize(
    ("number", "code", "words"),
    [(errno.ENOSPC, "disk-full", "room.blend"), (errno.EACCES, "run-unwritable", "Permission denied")],
)
def test_what_the_system_says_is_named(tmp_path, monkeypatch, number, code, words):
    monkeypatch.setattr(save, "reserve", fail(number))
    error = saving_fails(tmp_path / "room.blend")
    assert error.code == code and words in error.text
    assert ("Free some space" in error.remedy) is (code == "disk-full")


def test_a_disk_that_is_nearly_full_is_named(tmp_path, monkeypatch):
    usage = type("Usage", (), {"free": 3_000_000})
    monkeypatch.setattr(save.shutil, "disk_usage", lambda folder: usage)
    error = saving_fails(tmp_path / "room.blend")
    assert error.code == "disk-full" and "3 MB" in error.text


def test_nothing_is_left_of_the_probe(tmp_path):
    save.reserve(tmp_path)
    assert not list(tmp_path.iterdir())
    save.save_blend(tmp_path / "room.blend")
    assert (tmp_path / "room.blend").exists()


def test_a_picture_that_was_cut_off_is_no_picture(tmp_path, monkeypatch):
    path = tmp_path / "a.png"

    def write() -> None:
        path.write_bytes(b"\x89PNG and a part of the pixels")

    monkeypatch.setattr(save, "reserve", fail(errno.ENOSPC))
    assert error_of(image_files.write_image, path, path, write).code == "disk-full"


def test_a_render_that_was_cut_off_is_no_render(tmp_path, monkeypatch):
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.render.resolution_x = scene.render.resolution_y = 8
    cycles.render_exr(scene, tmp_path / "a.exr", cycles.RenderOptions(1))
    monkeypatch.setattr(save, "reserve", fail(errno.ENOSPC))
    assert error_of(cycles.render_exr, scene, tmp_path / "b.exr", cycles.RenderOptions(1)).code == "disk-full"
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]
