# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets of import, estimation and check renders, in files of Blender's own preset system."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase

from ..properties.capture import IMPORT_OPTIONS


class FIPT_OT_add_import_preset(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the import settings"""

    bl_idname = "fipt.add_import_preset"
    bl_label = "Add Import Preset"
    bl_options = {"REGISTER", "INTERNAL"}
    preset_menu = "FIPT_PT_import_presets"
    preset_subdir = "fipt/import"
    preset_defines = ["settings = bpy.context.scene.fipt.capture"]
    # Without what belongs to one capture alone.
    preset_values = [
        f"settings.{name}"
        for name in IMPORT_OPTIONS
        if name not in ("mesh", "images", "panorama", "panorama_place", "panorama_heading")
    ]


class FIPT_OT_add_estimate_preset(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the estimation's settings"""

    bl_idname = "fipt.add_estimate_preset"
    bl_label = "Add Estimate Preset"
    bl_options = {"REGISTER", "INTERNAL"}
    preset_menu = "FIPT_PT_estimate_presets"
    preset_subdir = "fipt/estimate"
    preset_defines = ["settings = bpy.context.scene.fipt.estimate"]
    preset_values = ["settings.preset", "settings.device", "settings.changes"]
