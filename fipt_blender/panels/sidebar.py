# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What all sections of the side panel share: their place, and how a line of text is drawn."""

from __future__ import annotations

import textwrap

import bpy

CATEGORY = "FIPT"
_CHARACTER_PIXELS = 7.0  # mean width of the default font at scale 1


class Section:
    """Mix-in of a section's panel: the tab "FIPT" of the 3D view's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY

    def fields(self) -> bpy.types.UILayout:
        """The panel's layout for properties: names left, values right, nothing to animate."""
        layout = self.layout  # type: ignore[attr-defined]
        layout.use_property_split = True
        layout.use_property_decorate = False
        return layout


class SubSection(Section):
    """Mix-in of a folded part of a section; name the section in `bl_parent_id`."""

    bl_options = {"DEFAULT_CLOSED"}


def draw_text(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", alert: bool = False
) -> None:
    """A text of any length, broken into lines that fit the region; Blender cuts labels off."""
    width = context.region.width / context.preferences.system.ui_scale if context.region else 240.0
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    lines = textwrap.wrap(text, max(int((width - 50.0) / _CHARACTER_PIXELS), 16)) or [""]
    for index, line in enumerate(lines):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")
