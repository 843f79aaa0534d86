# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The data folder and the folders of runs in it."""

from __future__ import annotations

import errno
import sys
from pathlib import Path

import pytest

from fipt_blender.bridge import places
from fipt_blender.core.run.errors import FiptError


def test_data_folder_is_the_platforms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(places.DATA_VARIABLE, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert places.default_data_folder() == tmp_path / "fipt_blender"
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert places.default_data_folder() == tmp_path / "local" / "fipt_blender"
    monkeypatch.setenv(places.DATA_VARIABLE, str(tmp_path / "named"))
    assert places.default_data_folder() == tmp_path / "named"


def test_run_folders_are_fresh_and_safely_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (places.new_run_folder(tmp_path, "../Living room: 2?") for _ in range(2))
    assert first != second and first.parent == second.parent == tmp_path / "runs"
    assert first.name.startswith("Living-room-2-") and not list(first.iterdir())
    assert places.new_run_folder(tmp_path, "").name.startswith("run-")
    (tmp_path / "file").touch()
    with pytest.raises(FiptError) as caught:
        places.new_run_folder(tmp_path / "file", "room")
    assert caught.value.code == "run-unwritable"

    def full(*arguments: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(FiptError) as caught:
        places.new_run_folder(tmp_path, "room")
    assert caught.value.code == "disk-full"
