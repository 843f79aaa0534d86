# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets of import, estimation and check renders, in files of Blender's own preset system."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase


class FIPT_OT_add_import_preset(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the import settings"""

    bl_idname = "fipt.add_import_preset"
    bl_label = "Add Import Preset"
    bl_options = {"REGISTER", "INTERNAL"}
    preset_menu = "FIPT_PT_import_presets"
    preset_subdir = "fipt/import"
    preset_defines = ["settings = bpy.context.scene.fipt.capture"]
    preset_values = [
        "settings.format",
        "settings.up_axis",
        "settings.scale",
        "settings.hold_back",
        "settings.layer",
        "settings.clamp_negative",
        "settings.triangles",
        "settings.undo_applied_transform",
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
