# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Lights: what it says of a fixture."""

from __future__ import annotations

import bpy

from fipt_blender.blend.marks import FIXTURE, NAMED
from fipt_blender.panels.lights import report_name


def test_the_reports_name_is_told_of_renamed_fixtures_only():
    item = bpy.data.objects.new("Ceiling panel", None)
    assert report_name(item) == ""
    item[FIXTURE], item[NAMED] = "Fixture.001", "Ceiling panel"
    assert report_name(item) == ""
    item.name = "Big light"
    assert report_name(item) == "Ceiling panel"
    bpy.data.objects.remove(item)
