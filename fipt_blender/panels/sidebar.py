# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of all sections of the side panel: their place, lists of rows, and text that wraps."""

from __future__ import annotations

import textwrap

import bpy
from bpy.types import Context, PropertyGroup, UILayout

from . import manual, path

CATEGORY = "FIPT"
_CHARACTER_PIXELS = 7.0  # mean width of the default font at scale 1


class Section:
    """Mix-in of a section's panel: the tab "FIPT" in the sidebar of the 3D Viewport."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY
    presets: type[bpy.types.Panel] | None = None  # the menu of presets in the header

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Called by Blender: a section is shown when the artist can use it; see `path`."""
        return path.is_shown(cls.__name__, context)

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Called by Blender: the state of a section, presets, and the button of the guide's chapter."""
        layout = self.layout  # type: ignore[attr-defined]
        name = type(self).__name__
        helps = bool(manual.address()) and not getattr(self, "bl_parent_id", "")  # RNA gives panels one
        buttons = helps + (self.presets is not None)
        text = path.state_text(name, self.bl_label, buttons, context)  # type: ignore[attr-defined]
        if text:
            row = layout.row()
            row.active = False
            row.label(text=text, translate=False)
        if self.presets is not None:
            self.presets.draw_panel_header(layout)
        if helps:
            chapter = manual.chapter_of(name)
            layout.operator("fipt.help", text="", icon="QUESTION", emboss=False).chapter = chapter

    def fields(self) -> bpy.types.UILayout:
        """The panel's layout for properties: names on the left, values on the right, no animation buttons."""
        layout = self.layout  # type: ignore[attr-defined]
        layout.use_property_split = True
        layout.use_property_decorate = False
        return layout


class SubSection(Section):
    """Mix-in of a closed subpanel of a section; a subclass names the section in `bl_parent_id`."""

    bl_options = {"DEFAULT_CLOSED"}


class Rows:
    """Mix-in of a list, before `bpy.types.UIList`; a subclass draws the row of one item."""

    def draw_item(
        self, context: Context, layout: UILayout, data: PropertyGroup, item: PropertyGroup, icon: int,
        active_data: PropertyGroup, active_property: str, index: int = 0, flt_flag: int = 0,
    ) -> None:  # fmt: skip
        """Called by Blender; most lists need no more than the item."""
        self.draw_row(context, layout, item, index)

    def draw_row(self, context: Context, layout: UILayout, item: PropertyGroup, index: int) -> None:
        """Draw an item, the `index`-th of the list."""
        raise NotImplementedError


def size_text(size: float) -> str:
    """A size in MB or GB (powers of 1000)."""
    return f"{size / 1e9:.1f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"


def draw_text(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", alert: bool = False
) -> None:
    """Draw a text of any length, wrapped to the region's width; Blender would truncate a label."""
    width = context.region.width / context.preferences.system.ui_scale if context.region else 240.0
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    lines = textwrap.wrap(text, max(int((width - 50.0) / _CHARACTER_PIXELS), 8)) or [""]
    for index, line in enumerate(lines):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")
