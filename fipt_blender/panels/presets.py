"""Presets of import and estimation, in files of Blender's own preset system."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel
from bpy.types import Context, UILayout

from ..properties.capture import IMPORT_OPTIONS

# Options that belong to one capture alone.
_OF_CAPTURES = ("mesh", "images", "panorama", "panorama_place", "panorama_heading")


def _presets(name: str, group: str, values: list[str]) -> tuple[type, type]:
    """The menu of presets of values of `scene.fipt.GROUP`, and the operator that adds and removes them."""
    menu, operator = f"FIPT_PT_{name}_presets", f"fipt.add_{name}_preset"
    shown = {
        "bl_label": f"{name.capitalize()} Presets",
        "preset_operator": "script.execute_preset",
        "preset_add_operator": operator,
    }
    adds = {
        "bl_idname": operator,
        "bl_label": f"Add {name.capitalize()} Preset",
        "bl_description": "Add or remove a preset",
        "bl_options": {"REGISTER", "INTERNAL"},
        "preset_menu": menu,
        "preset_defines": [f"settings = bpy.context.scene.fipt.{group}"],
        "preset_values": [f"settings.{value}" for value in values],
    }
    made = {"preset_subdir": f"fipt/{name}", "__module__": __name__}
    return (
        type(menu, (PresetPanel, bpy.types.Panel), {**shown, **made}),
        type(f"FIPT_OT_add_{name}_preset", (AddPresetBase, bpy.types.Operator), {**adds, **made}),
    )


FIPT_PT_import_presets, FIPT_OT_add_import_preset = _presets(
    "import", "capture", [name for name in IMPORT_OPTIONS if name not in _OF_CAPTURES]
)
FIPT_PT_estimate_presets, FIPT_OT_add_estimate_preset = _presets(
    "estimate", "estimate", ["preset", "device", "changes"]
)


def draw_import_presets(layout: UILayout, context: Context) -> None:
    """The button that opens the first menu."""
    FIPT_PT_import_presets.draw_panel_header(layout)  # type: ignore[attr-defined]


def draw_estimate_presets(layout: UILayout, context: Context) -> None:
    """The button that opens the second one."""
    FIPT_PT_estimate_presets.draw_panel_header(layout)  # type: ignore[attr-defined]
