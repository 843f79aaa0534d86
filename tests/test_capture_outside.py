# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths in files do not lead out of the capture, unless the user has named the folder; one rule for all."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from benchmarks import fuzz_samples
from fipt_blender.core.capture.formats import read_rig
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.photographs.preparation import PreparationFolder, read_preparation
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.paths import foreign_fault, is_network, leads_outside
from fipt_blender.core.run.runfolder import RunFolder
from samples.capture_files import make_samples, write_transforms
from samples.child_processes import posix


def with_path(root: Path, key: str, value: str) -> None:
    data = json.loads((root / "transforms.json").read_text())
    data["frames"][0][key] = value
    (root / "transforms.json").write_text(json.dumps(data))


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Two photographs in the capture, one of the same kind outside."""
    write_transforms(tmp_path / "capture", make_samples(2))
    (tmp_path / "other").mkdir()
    inside = tmp_path / "capture" / "images" / "000_0001.exr"
    (tmp_path / "other" / "secret.exr").write_bytes(inside.read_bytes())
    return tmp_path / "capture"


@pytest.mark.parametrize("key", ["file_path", "mask_path"])
def test_paths_that_lead_outside_are_refused(capture: Path, key: str) -> None:
    outside = capture.parent / "other" / "secret.exr"
    for path in (
        str(outside),
        "../other/secret.exr",
        "images/../../other/secret.exr",
        "..\\\\other\\\\secret.exr",
    ):
        with_path(capture, key, path)
        with pytest.raises(FiptError, match="outside of the capture") as caught:
            read_rig(capture, "auto", CaptureOptions())
        assert caught.value.code == "path-outside" and "--images" in caught.value.remedy


def test_the_users_folder_and_our_own_files_are_trusted(capture: Path) -> None:
    outside = capture.parent / "other" / "secret.exr"
    with_path(capture, "file_path", str(outside))
    for options in (CaptureOptions(images=outside.parent), CaptureOptions(own_paths=True)):
        assert read_rig(capture, "auto", options).views[0].image == outside


def test_paths_inside_stay_usable(capture: Path) -> None:
    inside = capture / "images" / "000_0001.exr"
    for path in (str(inside), "./images/000_0001.exr", "images/../images/000_0001.exr"):
        with_path(capture, "file_path", path)
        assert read_rig(capture, "auto", CaptureOptions()).views[0].image.resolve() == inside.resolve()
    # A photograph that was moved together with the file is found by its name.
    with_path(capture, "file_path", "/gone/elsewhere/000_0001.exr")
    (capture / "000_0001.exr").write_bytes(inside.read_bytes())
    assert read_rig(capture, "auto", CaptureOptions()).views[0].image == capture / "000_0001.exr"


NETWORK = (
    "//server/share/a.exr",
    "\\\\server\\share\\a.exr",
    "\\\\.\\COM1",
    "\\\\?\\C:\\a.exr",
    "/\\server/a.exr",
)


@pytest.mark.parametrize("path", NETWORK)
def test_no_path_leads_to_another_computer_or_a_device(tmp_path: Path, path: str) -> None:
    assert is_network(path) and leads_outside(tmp_path, path) and foreign_fault(path)
    with pytest.raises(FiptError) as caught:
        RunFolder(tmp_path).resolve(path)
    assert caught.value.code == "path-outside"


def test_paths_of_the_synthetic_layout_stay_inside(tmp_path: Path) -> None:
    fuzz_samples.write_fipt_synthetic(tmp_path / "capture")
    (tmp_path / "secret.exr").write_bytes(b"x")
    file = tmp_path / "capture" / "train" / "transforms.json"
    data = json.loads(file.read_text())
    for path in (str(tmp_path / "secret.exr"), "../../secret.exr", *NETWORK[:2]):
        data["frames"][0]["file_path"] = path
        file.write_text(json.dumps(data))
        with pytest.raises(FiptError) as caught:
            read_rig(tmp_path / "capture", "auto", CaptureOptions())
        assert caught.value.code == "path-outside"
    data["frames"][0]["file_path"] = "./Image/001_0001.exr"
    file.write_text(json.dumps(data))
    rig = read_rig(tmp_path / "capture", "auto", CaptureOptions())
    assert rig.views[0].image.resolve() == (file.parent / "Image" / "001_0001.exr").resolve()


@posix
def test_a_capture_json_names_images_and_meshes_of_this_computer_only(tmp_path: Path) -> None:
    fuzz_samples.write_capture(tmp_path / "run")
    file = tmp_path / "run" / "capture.json"
    data = json.loads(file.read_text())
    (tmp_path / "a.exr").write_bytes(b"x")
    os.mkfifo(tmp_path / "pipe.exr")
    for key, allowed in (("image", "a.exr"), ("mesh", "room.obj")):
        holder = data if key == "mesh" else data["views"][0]
        kept = holder[key]
        holder[key] = str(tmp_path / allowed)  # which need not exist
        file.write_text(json.dumps(data))
        load_capture(RunFolder(tmp_path / "run"))
        for path in ("/etc/passwd", str(tmp_path / "pipe.exr"), "../a.exr", "/proc/self/environ"):
            holder[key] = path
            file.write_text(json.dumps(data))
            with pytest.raises(FiptError) as caught:
                load_capture(RunFolder(tmp_path / "run"))
            assert caught.value.code == "path-outside" and path in caught.value.text
        holder[key] = kept


def test_a_prepare_json_names_photographs_of_its_folder_only(tmp_path: Path) -> None:
    fuzz_samples.write_preparation(tmp_path)
    folder = PreparationFolder(tmp_path)
    data = json.loads(folder.prepare_json.read_text())
    assert len(read_preparation(folder).photographs) == 2
    for path in ("/etc/passwd", "../../a.exr", "a/../../b.exr", *NETWORK[:2]):
        changed = json.loads(json.dumps(data))
        changed["photographs"][0]["path"] = changed["groups"][0]["photographs"][0] = path
        folder.prepare_json.write_text(json.dumps(changed))
        with pytest.raises(FiptError, match="leads out of"):
            read_preparation(folder)
    for key in ("cameras", "masks"):
        changed = {**data, "settings": {**data["settings"], key: "//server/share"}}
        folder.prepare_json.write_text(json.dumps(changed))
        with pytest.raises(FiptError) as caught:
            read_preparation(folder)
        assert caught.value.code == "path-network"
