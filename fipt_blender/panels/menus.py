# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The menu View > FIPT, by which the menu search (F3) finds the operators; File > Import and Export."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from . import manual

KEY = {"type": "F", "value": "PRESS", "shift": True, "alt": True}
# Operators of each section, with texts where the operators' own names do not tell enough.
SECTIONS: dict[str, Sequence[tuple[str, str]]] = {
    "Photographs": (("find_brackets", ""), ("prepare", "")),
    "Capture": (
        ("set_up_engine", ""),
        ("choose_capture", ""),
        ("import_capture", ""),
        ("hide_startup_objects", ""),
        ("import_mesh", ""),
        ("set_room", ""),
        ("simplify_room", ""),
        ("use_scene_cameras", ""),
        ("place_panorama", ""),
        ("look_through", "Look Through View"),
        ("pick_pair", "Pick Points for Alignment"),
        ("align_by_pairs", ""),
        ("check_views", ""),
        ("show_coverage", ""),
        ("find_missing_surfaces", ""),
        ("add_surface", ""),
        ("select_added", ""),
        ("try_example", ""),
    ),
    "Parts": (("show_parts", ""),),
    "Estimate": (
        ("estimate", ""),
        ("resume", "Resume Estimate"),
        ("cancel", "Cancel Job"),
        ("add_hint", "Add Hint on Part"),
        ("read_doubts", ""),
        ("reestimate", ""),
    ),
    "Materials": (
        ("apply_results", ""),
        ("pick_part", "Pick Part of Room"),
        ("select_part_faces", "Select Faces of Part"),
        ("set_part_color", ""),
        ("reset_part", "Reset Adjustment of Part"),
        ("mark_part_assets", "Mark Material of Part as Asset"),
        ("remove_from_room", ""),
        ("bring_back", "Bring Back to Room"),
        ("export_room", ""),
        ("revert", "Revert Results"),
    ),
    "Lights": (
        ("add_light", "Add Light to Room"),
        ("aim_light", ""),
        ("select_light", "Select Light of the List"),
        ("reset_light", ""),
        ("save_light_state", ""),
        ("recall_light_state", ""),
        ("fixture_to_area_light", "Convert Fixture to Blender Light"),
        ("area_light_to_fixture", "Convert Back to Fixture"),
        ("set_ies_profile", ""),
        ("make_light_groups", ""),
        ("calibrate_light", ""),
        ("match_exposure", ""),
        ("prepare_eevee", "Set Up Room for EEVEE"),
        ("bake_probe", ""),
        ("use_cycles", ""),
    ),
    "Check": (
        ("add_ball", "Add Ball to Room"),
        ("final_picture", "Final Picture of Room"),
        ("plate_nodes", ""),
        ("set_rendering", ""),
        ("write_report", ""),
        ("open_report", ""),
    ),
}

LABELS = {"Check": "Render"}  # of sections that are called otherwise than their classes

_keymap_items: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


class FIPT_MT_main(bpy.types.Menu):
    """The operators of the sidebar, by its sections"""

    bl_label = "FIPT"

    def draw(self, context: bpy.types.Context) -> None:
        for label in SECTIONS:
            self.layout.menu(f"FIPT_MT_{label.lower()}")
        if manual.address():
            self.layout.separator()
            self.layout.operator("fipt.help", text="Guide", icon="HELP").chapter = ""


def _section_menu(label: str, operators: Sequence[tuple[str, str]]) -> type[bpy.types.Menu]:
    """The menu of a section."""

    def draw(self: bpy.types.Menu, context: bpy.types.Context) -> None:
        self.layout.operator_context = "INVOKE_DEFAULT"
        for name, text in operators:
            if text:
                self.layout.operator(f"fipt.{name}", text=text)
            else:
                self.layout.operator(f"fipt.{name}")

    name = f"FIPT_MT_{label.lower()}"
    return type(
        name, (bpy.types.Menu,), {"bl_label": LABELS.get(label, label), "bl_idname": name, "draw": draw}
    )


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
        states = context.scene.fipt.lights.states
        if states:
            layout.separator()
        for state in states:
            layout.operator("fipt.recall_light_state", text=state.name, translate=False).state = state.name


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


MENUS = [_section_menu(label, operators) for label, operators in SECTIONS.items()]


def register() -> None:
    """Add the menu, the key and the addresses of the documentation."""
    bpy.types.VIEW3D_MT_view.append(_draw_menu)
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)
    bpy.types.TOPBAR_MT_file_export.append(_draw_export)
    bpy.utils.register_manual_map(online_manual)
    configuration = bpy.context.window_manager.keyconfigs.addon
    if configuration is not None:
        keymap = configuration.keymaps.new(name="3D View", space_type="VIEW_3D")
        item = keymap.keymap_items.new("wm.call_menu_pie", **KEY)
        item.properties.name = "FIPT_MT_pie"
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


def draw_shortcut(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The pie menu's key, to be changed in the preferences."""
    configuration = context.window_manager.keyconfigs.user
    keymap = None if configuration is None else configuration.keymaps.get("3D View")
    items = [] if keymap is None else keymap.keymap_items
    for item in items:
        if item.idname == "wm.call_menu_pie" and item.properties.name == "FIPT_MT_pie":
            row = layout.row(align=True)
            row.label(text="Pie Menu in 3D Viewports", icon="EVENT_OS")
            row.prop(item, "active", text="")
            row.prop(item, "type", text="", full_event=True)


def online_manual() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Called by Blender for *Online Manual*."""
    chapters = {label.lower(): [name for name, _ in listed] for label, listed in SECTIONS.items()}
    return manual.manual_map(chapters)


def _draw_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.menu("FIPT_MT_main")


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator_context = "INVOKE_DEFAULT"
    self.layout.operator("fipt.choose_capture", text="Room Capture (FIPT)")


def _draw_export(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator("fipt.export_room", text="FIPT Room (.glb/.usd)")
