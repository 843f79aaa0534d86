"""The panels of the side panel, made of functions; lists of rows, and text that wraps."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from . import manual

_CHARACTER_PIXELS = 7.0  # mean width of the default font at scale 1
_HEADER_PIXELS = 74.0  # of a header's triangle, margins and button at scale 1
Draw = Callable[[UILayout, Context], None]


def panel(
    label: str,
    order: int,
    parent: str = "",
    closed: bool = False,
    name: str = "",
    shown: Callable[[Context], object] = lambda context: True,
    state: Callable[[Context], Sequence[str]] | None = None,
    **headers: Draw,
) -> Callable[[Draw], type[bpy.types.Panel]]:
    """Declare the panel that a function draws, in the tab "FIPT" of the 3D Viewport's sidebar.

    The class has the function's name. Properties have their names on the left, and no animation buttons.

    Args:
        label: its title.
        order: its place among the others of its parent.
        parent: name of the panel of which it is a part; "" for a section.
        closed: whether it is closed at first.
        name: of its class, if not the function's.
        shown: whether the artist can use it.
        state: texts of its state in its header, the longest one first.
        headers: what is drawn besides in its header: `before` the label, and `after` it on the right.
    """

    def declare(function: Draw) -> type[bpy.types.Panel]:
        def draw(self: Any, context: Context) -> None:
            self.layout.use_property_split = True
            self.layout.use_property_decorate = False
            function(self.layout, context)

        def draw_header_preset(self: Any, context: Context) -> None:
            if text := _fitting(state(context) if state else (), label, context):
                row = self.layout.row()
                row.active = False
                row.label(text=text, translate=False)
            if "after" in headers:
                headers["after"](self.layout, context)

        members: dict[str, Any] = {
            "__module__": function.__module__,
            "__doc__": function.__doc__,
            "bl_label": label,
            "bl_order": order,
            "bl_space_type": "VIEW_3D",
            "bl_region_type": "UI",
            "bl_category": "FIPT",
            "bl_options": {"DEFAULT_CLOSED"} if closed else set(),
            "poll": classmethod(lambda cls, context: bool(shown(context))),
            "draw": draw,
            "draw_header_preset": draw_header_preset,
        }
        if parent:
            members["bl_parent_id"] = parent
        if "before" in headers:
            members["draw_header"] = lambda self, context: headers["before"](self.layout, context)
        return type(name or function.__name__, (bpy.types.Panel,), members)

    return declare


def _fitting(texts: Sequence[str], label: str, context: Context) -> str:
    """The first text for which a header has room beside its label; "" if none."""
    if context.region is None:
        return next(iter(texts), "")
    room = (_width(context) - _HEADER_PIXELS) / _CHARACTER_PIXELS - len(iface_(label))
    return next((text for text in texts if len(text) <= room), "")


def draw_help(layout: UILayout, context: Context) -> None:
    """The button of the guide, where there is one."""
    if manual.address():
        layout.operator("fipt.help", text="", icon="QUESTION", emboss=False)


def rows(**members: Callable[..., Any]) -> Callable[[Callable[..., None]], type[bpy.types.UIList]]:
    """Declare the list whose rows a function draws, as `function(layout, context, item, index)`.

    Args:
        members: further methods of the class, such as `filter_items`.
    """

    def declare(function: Callable[..., None]) -> type[bpy.types.UIList]:
        def draw_item(
            self: Any, context: Context, layout: UILayout, data: PropertyGroup, item: PropertyGroup,
            icon: int, active_data: PropertyGroup, active: str, index: int = 0, flag: int = 0,
        ) -> None:  # fmt: skip
            function(layout, context, item, index)

        made = {"__module__": function.__module__, "__doc__": function.__doc__, "draw_item": draw_item}
        return type(function.__name__, (bpy.types.UIList,), {**made, **members})

    return declare


def size_text(size: float) -> str:
    """A size in MB or GB (powers of 1000)."""
    return f"{size / 1e9:.1f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"


def _width(context: Context) -> float:
    """Of the region that is drawn, in pixels at scale 1."""
    return context.region.width / context.preferences.system.ui_scale if context.region else 240.0


def draw_text(layout: UILayout, text: str, icon: str = "NONE", alert: bool = False) -> None:
    """Draw a text of any length, wrapped to the region's width; Blender would truncate a label."""
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    room = (_width(bpy.context) - 50.0) / _CHARACTER_PIXELS
    for index, line in enumerate(textwrap.wrap(text, max(int(room), 8)) or [""]):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")
