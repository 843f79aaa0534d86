# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the section Capture draws."""

from __future__ import annotations

import bpy
import pytest

from fipt_blender.blend.marks import ADDED, DRAWN
from fipt_blender.core.run.errors import FiptError
from fipt_blender.jobs import running
from fipt_blender.panels import capture
from samples.layouts import drawn_by

pytestmark = pytest.mark.usefixtures("registered")


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (["images/IMG_1", "images/IMG_2"], "IMG_1"),
        (["train/000", "val/000"], "train/000"),
        (["a/left/1", "a/left/2"], "1"),
        (["000", "001"], "000"),
    ],
)
def test_names_of_views_without_their_common_folder(names, shown):
    settings = bpy.context.scene.fipt.capture
    for name in names:
        settings.views.add().name = name
    settings.count_views()
    assert capture.shown_name(names[0], settings.name_prefix) == shown


@pytest.mark.parametrize("has_run", [False, True])
def test_a_failed_import_is_told_once(monkeypatch, tmp_path, has_run):
    """Before a first import the scene has no run folder; later it has that of the last one that succeeded."""
    scene = bpy.context.scene
    scene.fipt.run_folder = str(tmp_path / "earlier") if has_run else ""
    info = running.RunningJob("Import Capture", "capture", scene.name, tmp_path / "failed")
    running.refuse(info, FiptError("odd", "The file is odd.", "Export it again."))
    drawn: list[str] = []
    told = lambda layout, context, error, run: drawn.append(error["text"])  # noqa: E731
    monkeypatch.setattr(capture, "draw_error", told)
    monkeypatch.setattr("fipt_blender.panels.job.draw_error", told)
    capture.draw_import(None, bpy.context)
    assert drawn == ["The file is odd."]


def test_a_warning_goes_once_its_remedy_was_followed(tmp_path):
    info = running.RunningJob("Import Capture", "capture", bpy.context.scene.name, tmp_path)
    info.warnings += [{"code": "mesh-missing"}, {"code": "images-not-hdr"}]
    running.refuse(info, FiptError("odd", "The file is odd.", "Export it again."))
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    assert info.warnings == [{"code": "images-not-hdr"}]


def room_texts() -> str:
    """What the panel Room tells."""
    return " ".join(drawn_by(capture.FIPT_PT_capture_room)[0])


def test_a_room_without_mesh_is_told_as_long_as_it_has_none():
    assert "no mesh" not in room_texts(), "before an import nothing is missing"
    bpy.context.scene.fipt.capture.views.add().name = "a"
    assert "The room has no mesh" in room_texts()
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    assert "no mesh" not in room_texts()


def test_the_room_says_that_missing_surfaces_come_after_the_check_until_it_is_done():
    bpy.context.scene.fipt.capture.views.add().name = "a"
    bpy.ops.mesh.primitive_cube_add()
    item = bpy.context.object
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    assert "start with Check Views" in room_texts()
    item[ADDED] = DRAWN
    assert "Check Views" not in room_texts()
    del item[ADDED]
    bpy.context.scene.fipt.capture.unseen_share = 0.1
    assert "Check Views" not in room_texts() and "fipt.find_missing_surfaces" in room_texts()


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("format", "-Y is up by the format"),
        ("option", "-Y is up by the import settings"),
        ("planes", "10.3° from -Y is up by the planes of the room"),
        ("cameras", "10.3° from -Y is up by the cameras"),
    ],
)
def test_what_is_up_is_told_with_a_choice_of_the_others(source, told):
    settings = bpy.context.scene.fipt.capture
    assert "up" not in drawn_by(capture.FIPT_PT_capture)[1]
    settings.imported_up, settings.up_source, settings.up_angle = "-y", source, 10.3
    texts, properties = drawn_by(capture.FIPT_PT_capture)[:2]
    assert told in " ".join(texts) and "up" in properties
