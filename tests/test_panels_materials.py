# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Materials of Parts, drawn on a stand-in of Blender's layout."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import pytest

from fipt_blender.blend.marks import FIXTURE, NAMED
from fipt_blender.blend.results import part_list
from fipt_blender.blend.results.adjust import Adjustment
from fipt_blender.panels import materials
from fipt_blender.panels.lights import report_name
from samples.layouts import Layout

pytestmark = pytest.mark.usefixtures("registered")


@pytest.mark.parametrize(
    ("shading", "hue", "told"), [("SOLID", 0.3, True), ("SOLID", 0.0, False), ("RENDERED", 0.3, False)]
)
def test_solid_shading_does_not_show_the_sliders(monkeypatch, shading, hue, told):
    monkeypatch.setattr(part_list, "adjustment", lambda scene, key: Adjustment(hue=hue))
    parts = bpy.context.scene.fipt.materials.parts
    parts.clear()
    part = parts.add()
    part.known = True
    labels: list[str] = []
    context = SimpleNamespace(
        scene=bpy.context.scene,
        space_data=SimpleNamespace(shading=SimpleNamespace(type=shading)),
        region=None,
        preferences=bpy.context.preferences,
    )
    panel = SimpleNamespace(fields=lambda: Layout(labels))
    materials.FIPT_PT_materials_parts.draw(panel, context)
    assert ("Solid shading" in " ".join(labels)) is told
    assert "Estimated" in " ".join(labels)
    parts.clear()


@pytest.mark.parametrize(
    ("shading", "shown", "offered"),
    [("SOLID", "ESTIMATED", True), ("SOLID", "ROUGHNESS", False), ("MATERIAL", "ESTIMATED", False)],
)
def test_the_light_is_a_click_away_where_the_viewport_shows_textures_alone(shading, shown, offered):
    settings = bpy.context.scene.fipt.materials
    settings.object_count = 1
    settings.shown = shown
    properties: list[str] = []
    context = SimpleNamespace(
        scene=bpy.context.scene,
        space_data=SimpleNamespace(shading=SimpleNamespace(type=shading)),
        mode="OBJECT",
        region=None,
        preferences=bpy.context.preferences,
    )
    panel = SimpleNamespace(fields=lambda: Layout([], properties=properties))
    materials.FIPT_PT_materials.draw(panel, context)
    assert ("type" in properties) is offered


def test_after_apply_the_parts_come_first_and_settings_are_closed():
    parts, settings = materials.FIPT_PT_materials_parts, materials.FIPT_PT_materials_settings
    assert parts.bl_order < settings.bl_order
    assert "DEFAULT_CLOSED" in settings.bl_options and "DEFAULT_CLOSED" not in getattr(
        parts, "bl_options", set()
    )


def test_the_reports_name_is_told_of_renamed_fixtures_only():
    item = bpy.data.objects.new("Ceiling panel", None)
    assert report_name(item) == ""
    item[FIXTURE], item[NAMED] = "Fixture.001", "Ceiling panel"
    assert report_name(item) == ""
    item.name = "Big light"
    assert report_name(item) == "Ceiling panel"
    bpy.data.objects.remove(item)
