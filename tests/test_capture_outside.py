# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths in transforms.json do not lead out of the capture, unless the user has named the folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fipt_blender.core.capture.formats import read_rig
from fipt_blender.core.capture.rig import ReadOptions
from fipt_blender.core.run.errors import FiptError
from samples.capture_files import make_samples, write_transforms


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
            read_rig(capture, "auto", ReadOptions())
        assert caught.value.code == "path-outside" and "--images" in caught.value.remedy


def test_the_users_folder_and_our_own_files_are_trusted(capture: Path) -> None:
    outside = capture.parent / "other" / "secret.exr"
    with_path(capture, "file_path", str(outside))
    for options in (ReadOptions(images=outside.parent), ReadOptions(own_paths=True)):
        assert read_rig(capture, "auto", options).views[0].image == outside


def test_paths_inside_stay_usable(capture: Path) -> None:
    inside = capture / "images" / "000_0001.exr"
    for path in (str(inside), "./images/000_0001.exr", "images/../images/000_0001.exr"):
        with_path(capture, "file_path", path)
        assert read_rig(capture, "auto", ReadOptions()).views[0].image.resolve() == inside.resolve()
    # A photograph that was moved together with the file is found by its name.
    with_path(capture, "file_path", "/gone/elsewhere/000_0001.exr")
    (capture / "000_0001.exr").write_bytes(inside.read_bytes())
    assert read_rig(capture, "auto", ReadOptions()).views[0].image == capture / "000_0001.exr"
