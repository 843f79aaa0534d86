# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the section Capture draws."""

from __future__ import annotations

import bpy
import pytest

from fipt_blender.core.run.errors import FiptError
from fipt_blender.jobs import running
from fipt_blender.panels import capture
from samples.layouts import drawn_by

pytestmark = pytest.mark.usefixtures("registered")


def test_a_warning_goes_once_its_remedy_was_followed(tmp_path):
    info = running.RunningJob("Import Capture", "capture", bpy.context.scene.name, tmp_path)
    info.warnings += [{"code": "mesh-missing"}, {"code": "images-not-hdr"}]
    running.refuse(info, FiptError("odd", "The file is odd.", "Export it again."))
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    assert info.warnings == [{"code": "images-not-hdr"}]


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
