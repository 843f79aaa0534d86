# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A run that a crashed Blender has left behind is offered again; saved ones and those in use are not."""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path

import bpy
import pytest

from fipt_blender import machine
from fipt_blender.bridge import unsaved
from fipt_blender.core import conventions
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import recovery
from fipt_blender.panels import start
from samples.camera_views import random_views
from samples.layouts import drawn_by

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def data(tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(tmp_path))
    recovery.forget()
    return tmp_path


def make_run(data: Path, name: str, hours: float) -> RunFolder:
    """A run with a capture, last changed so many hours ago, by a Blender that has ended since."""
    run = RunFolder(data / "runs" / name)
    run.create(make_settings())
    world = conventions.world_from_source("z", 1.0).tolist()
    rig = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    write_json(run.ingest_json, {**rig, "views": random_views(), "world_from_source": world})
    unsaved.mark(run.root)
    path = unsaved.mark_of(run.root)
    path.write_text(json.dumps({**json.loads(path.read_text()), "started": "earlier"}))
    for file in (*run.root.rglob("*"), run.root):
        os.utime(file, (time.time() - 3600.0 * hours,) * 2)
    return run


def test_the_newest_run_without_a_file_or_a_blender_is_offered(data):
    make_run(data, "old", 9.0)
    saved, left, alive = (make_run(data, name, hours) for name, hours in (("a", 1.0), ("b", 2.0), ("c", 3.0)))
    unsaved.unmark(saved.root)
    unsaved.mark(alive.root)
    found = unsaved.newest(data, [])
    assert found is not None and found.folder == left.root and found.size > 0
    assert unsaved.newest(data, [left.root]).folder.name == "old"
    shutil.rmtree(left.root)
    assert unsaved.newest(data, []).folder.name == "old" and not unsaved.mark_of(left.root).exists()


def test_saving_the_file_makes_its_run_known(data):
    run = make_run(data, "a", 1.0)
    bpy.context.scene.fipt.run_folder = str(run.root)
    bpy.ops.wm.save_as_mainfile(filepath=str(data / "room.blend"))
    assert unsaved.newest(data, []) is None


def test_a_run_that_was_left_behind_is_opened_again(data):
    run = make_run(data, "a", 1.0)
    recovery.look_for_unsaved()
    assert "fipt.recover_run" in drawn_by(start.FIPT_PT_start)[0]
    assert bpy.ops.fipt.recover_run(folder=str(run.root)) == {"FINISHED"}
    fipt = bpy.context.scene.fipt
    assert len(fipt.capture.views) == len(random_views()) and fipt.run_folder == str(run.root)
