# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged meshes of rooms: each fault is named for what it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.surface.room import load_room
from samples.refusals import error_of
from samples.small_rooms import make_room, write_room

CORNERS = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    "changes, code, text",
    [
        *(({"triangles": np.array([[0, 1, 2], [0, 2, index]], np.int32)}, "file-damaged", "missing vertices")
          for index in (4, 2**30, -1)),
        *(({"vertices": np.full((4, 3), value, np.float32)}, "mesh-damaged", "infinity")
          for value in (np.inf, -np.inf, np.nan)),
        ({"vertices": np.zeros((4, 3), np.float32)}, "mesh-empty", ""),
    ],
)  # fmt: skip
def test_faults_are_named_for_what_they_are(tmp_path: Path, changes: dict, code: str, text: str) -> None:
    """A square of two triangles, with other arrays: missing vertices are named before areas are computed."""
    write_room(tmp_path, make_room([CORNERS]), **changes)
    error = error_of(load_room, RunFolder(tmp_path))
    assert error.code == code and text in error.text
