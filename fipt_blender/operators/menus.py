"""The menu View > FIPT, by which the menu search (F3) finds the operators; File > Import and Export."""

from __future__ import annotations

from collections.abc import Iterable
from types import ModuleType
from typing import Any

import bpy

from ..panels import manual
from ..panels.preferences import PIE, PIE_KEY
from ..properties import classes_of
from . import (
    alignment,
    capture,
    check,
    emptying,
    environment,
    estimate,
    export,
    hints,
    lights,
    materials,
    new_light,
    photographs,
    start,
)

# The modules of the operators, by the guide's chapter that explains them.
CHAPTERS = {
    "install": (environment,),
    "photographs": (photographs,),
    "capture": (start, capture, alignment),
    "estimate": (estimate, hints),
    "materials": (materials, emptying, export),
    "lights": (lights, new_light),
    "check": (check,),
}
_LABELS = {
    "install": "Engine",
    "check": "Render",
}  # of sections that are called otherwise than their chapters

_keymap_items: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


class FIPT_MT_main(bpy.types.Menu):
    """The operators of the sidebar, by its sections"""

    bl_label = "FIPT"

    def draw(self, context: bpy.types.Context) -> None:
        for menu in MENUS:
            self.layout.menu(menu.__name__)
        if manual.address():
            self.layout.separator()
            self.layout.operator("fipt.help", text="Guide", icon="HELP")


def operators_of(modules: Iterable[ModuleType]) -> list[str]:
    """Names of the operators of modules that need nothing else than a call, in the order of their source."""
    found: list[Any] = [each for each in classes_of(modules) if issubclass(each, bpy.types.Operator)]
    return [each.bl_idname for each in found if getattr(each, "listed", "INTERNAL" not in each.bl_options)]


def _section_menu(chapter: str, operators: Iterable[str]) -> type[bpy.types.Menu]:
    """The menu of a section."""

    def draw(self: bpy.types.Menu, context: bpy.types.Context) -> None:
        self.layout.operator_context = "INVOKE_DEFAULT"
        for name in operators:
            self.layout.operator(name)

    name = f"FIPT_MT_{chapter}"
    label = _LABELS.get(chapter, chapter.capitalize())
    return type(name, (bpy.types.Menu,), {"bl_label": label, "bl_idname": name, "draw": draw})


class FIPT_MT_maps(bpy.types.Menu):
    """What the room shows"""

    bl_label = "Show Map"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.operator_enum("fipt.show_map", "shown")


class FIPT_MT_pie_lights(bpy.types.Menu):
    """The room's lights"""

    bl_label = "Lights of the Room"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("fipt.switch_lights", text="All On", icon="LIGHT").on = True
        layout.operator("fipt.switch_lights", text="All Off", icon="OUTLINER_DATA_LIGHT").on = False
        layout.operator_context = "INVOKE_DEFAULT"
        layout.operator("fipt.add_light", text="Add Light by Pointing", icon="EYEDROPPER").place = "PICK"


class FIPT_MT_pie(bpy.types.Menu):
    """Photograph, picture, map and lights around the pointer"""

    bl_label = "FIPT"

    def draw(self, context: bpy.types.Context) -> None:
        pie = self.layout.menu_pie()
        pie.operator("fipt.look_through", text="Photograph", icon="IMAGE_DATA").toggle = True  # left
        pie.operator("fipt.final_picture", icon="RENDER_STILL")  # right
        pie.menu("FIPT_MT_maps", text="Map", icon="NODE_TEXTURE")  # below
        pie.menu("FIPT_MT_pie_lights", text="Lights", icon="LIGHT")  # above
        pie.operator("fipt.look_through", text="Previous View", icon="TRIA_LEFT").step = -1
        pie.operator("fipt.look_through", text="Next View", icon="TRIA_RIGHT").step = 1


MENUS = [_section_menu(chapter, operators_of(modules)) for chapter, modules in CHAPTERS.items()]


def register() -> None:
    """Add the menu, the key and the addresses of the documentation."""
    bpy.types.VIEW3D_MT_view.append(_draw_menu)
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)
    bpy.types.TOPBAR_MT_file_export.append(_draw_export)
    bpy.utils.register_manual_map(online_manual)
    configuration = bpy.context.window_manager.keyconfigs.addon
    if configuration is not None:
        keymap = configuration.keymaps.new(name="3D View", space_type="VIEW_3D")
        item = keymap.keymap_items.new("wm.call_menu_pie", **PIE_KEY)
        item.properties.name = PIE
        _keymap_items.append((keymap, item))


def unregister() -> None:
    """Remove them."""
    while _keymap_items:
        keymap, item = _keymap_items.pop()
        keymap.keymap_items.remove(item)
    bpy.utils.unregister_manual_map(online_manual)
    bpy.types.TOPBAR_MT_file_export.remove(_draw_export)
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
    bpy.types.VIEW3D_MT_view.remove(_draw_menu)


def online_manual() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Called by Blender for *Online Manual*."""
    return manual.manual_map({chapter: operators_of(modules) for chapter, modules in CHAPTERS.items()})


def _draw_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.menu("FIPT_MT_main")


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator_context = "INVOKE_DEFAULT"
    self.layout.operator("fipt.choose_capture", text="Room Capture (FIPT)")


def _draw_export(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator("fipt.export_room", text="FIPT Room (.glb/.usd)")
