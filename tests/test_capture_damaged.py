"""Damaged and hostile captures: each ends with a clear error within bounded time and memory."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import OpenEXR
import PIL.Image
import pytest

from fipt_blender.core.capture import encoded, images, ingest
from fipt_blender.core.capture.files import view_name
from fipt_blender.core.capture.formats import colmap_sizes
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.rig import RigView
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.run.runfolder import RunFolder
from samples import fuzz, fuzz_samples, fuzz_targets
from samples.refusals import error_of

COLMAP_FILES = ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")


# -------------------------------------------------------------------------------------------------- COLMAP


@pytest.mark.parametrize("name", COLMAP_FILES)
def test_a_colmap_file_cut_off_anywhere_is_refused(tmp_path: Path, name: str) -> None:
    fuzz_samples.write_colmap(tmp_path, text=False)
    model = tmp_path / "sparse" / "0"
    data = (model / name).read_bytes()
    colmap_sizes.check_model(model)
    for length in (0, 8, len(data) - 4):
        (model / name).write_bytes(data[:length])
        error = error_of(read_rig, tmp_path, "colmap", CaptureOptions())
        assert error.code == "rig-damaged" and name in error.text
    for length in range(len(data)):
        (model / name).write_bytes(data[:length])
        with pytest.raises(ValueError, match=rf"^{name} is cut off"):
            colmap_sizes.check_model(model)
    (model / name).write_bytes(data + b"\0")
    with pytest.raises(ValueError, match="1 bytes more"):
        colmap_sizes.check_model(model)


# ---------------------------------------------------------------------------------------------------- JSON


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"train_filenames": 5}, "train_filenames"),
        ({"frames": 5}, "frames"),
        ({"frames": [[]]}, r"frames\[0\]"),
        ({"w": [12]}, "w should be"),
        ({"fl_x": "9"}, "fl_x"),
        ({"fl_x": float("nan")}, "fl_x"),
        ({"up_axis": ["z"]}, "up_axis"),
        ({"w": 1e30}, "w should be"),
    ],
)
def test_wrong_types_in_transforms_are_named(tmp_path: Path, change: dict, text: str) -> None:
    fuzz_samples.write_transforms(tmp_path)
    data = json.loads((tmp_path / "transforms.json").read_text())
    (tmp_path / "transforms.json").write_text(json.dumps({**data, **change}))
    error = error_of(read_rig, tmp_path, "transforms", CaptureOptions())
    assert error.code == "rig-damaged"
    assert re.search(text, error.text), error.text


def test_a_refusal_of_the_system_is_an_error_with_a_remedy(tmp_path: Path, monkeypatch) -> None:
    fuzz_samples.write_transforms(tmp_path)

    def refuse(self: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "is_file", refuse)
    error = error_of(read_rig, tmp_path, "auto", CaptureOptions())
    assert error.code == "capture-unreadable" and "Permission denied" in error.text


# --------------------------------------------------------------------------------------------------- names


def named(*names: str) -> list[str]:
    views = tuple(
        RigView(name, None, Path(f"{index}.exr"), 1, 1, fuzz_samples.PINHOLE, np.eye(4), None, None)
        for index, name in enumerate(names)
    )
    return [view.name for view in ingest.distinct_views(views)]


def test_made_up_names_never_meet_given_ones() -> None:
    assert named("a", "a", "a~2") == ["a", "a~2", "a~2~2"]
    assert named("a~2", "a", "a") == ["a~2", "a", "a~3"]
    assert named("a", "A", "b") == ["a", "A~2", "b"]


@pytest.mark.parametrize("name", ["a\0b", "\ud800", "x" * 300, "ä" * 300, "a\nb", "/".join("abcdefghijkl" * 30)])
def test_names_can_be_names_of_files(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{view_name(name + '.png')}.exr"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"")
    assert path.is_file() and path.is_relative_to(tmp_path)
    assert view_name("x" * 300 + "1.png") != view_name("x" * 300 + "2.png")


# -------------------------------------------------------------------------------------------------- images


def test_only_png_is_read_from_png_files(tmp_path: Path) -> None:
    path = tmp_path / "ids.png"
    for content in (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", b"\xff\xd8\xff\xe0" + bytes(64)):
        path.write_bytes(content)
        assert error_of(images.read_ids, path).code == "image-unreadable"
        assert error_of(images.read_size, path).code == "image-unreadable"


def test_a_large_mask_is_read_and_a_huge_one_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(PIL.Image, "MAX_IMAGE_PIXELS", 1000)
    PIL.Image.new("L", (100, 90)).save(tmp_path / "large.png")
    assert images.read_ids(tmp_path / "large.png").shape == (90, 100)
    monkeypatch.setattr(encoded, "MOST_PIXELS", 8000)
    PIL.Image.new("L", (100, 90)).save(tmp_path / "huge.png")
    for read in (images.read_ids, images.read_size):
        assert error_of(read, tmp_path / "huge.png").code == "image-too-large"


def test_an_exr_of_few_bytes_does_not_take_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    pixels = {name: np.zeros((2, 2), np.float16) for name in "RGB"}
    for side, code in ((12_000, "image-unreadable"), (30_000, "image-too-large")):
        window = (np.array([0, 0], np.int32), np.array([side, side], np.int32))
        OpenEXR.File({"displayWindow": window, "type": OpenEXR.scanlineimage}, pixels).write(str(path))
        for read in (images.read_radiance, images.read_ids, images.read_size):
            assert error_of(read, path).code == code


def test_a_photograph_replaced_by_another_size_is_named(tmp_path: Path) -> None:
    fuzz_samples.write_capture(tmp_path)
    view = load_capture(RunFolder(tmp_path)).views[0]
    images.write_exr(view.image, np.zeros((4, 6, 3)))
    error = error_of(view.radiance)
    assert error.code == "image-size" and "6 x 4" in error.text and "12 x 8" in error.text


# ----------------------------------------------------------------------------------------------- mutations


@pytest.mark.parametrize("target", fuzz_targets.TARGETS, ids=lambda target: target.name)
def test_mutated_captures_never_crash_hang_or_touch_other_files(target: fuzz_targets.Target) -> None:
    """Few inputs; FIPT_FUZZ=400 tries as many for each reader."""
    fuzz.try_target(target, int(os.environ.get("FIPT_FUZZ", "5")), seed=7)
