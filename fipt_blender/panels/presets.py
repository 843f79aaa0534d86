# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The menus of presets of two groups of settings; see operators/presets.py."""

from __future__ import annotations

import bpy
from bl_ui.utils import PresetPanel
from bpy.types import Context, UILayout


class FIPT_PT_import_presets(PresetPanel, bpy.types.Panel):
    """Presets of the import settings"""

    bl_label = "Import Presets"
    preset_subdir = "fipt/import"
    preset_operator = "script.execute_preset"
    preset_add_operator = "fipt.add_import_preset"


class FIPT_PT_estimate_presets(PresetPanel, bpy.types.Panel):
    """Presets of the estimation's settings"""

    bl_label = "Estimate Presets"
    preset_subdir = "fipt/estimate"
    preset_operator = "script.execute_preset"
    preset_add_operator = "fipt.add_estimate_preset"


def draw_import_presets(layout: UILayout, context: Context) -> None:
    """The button that opens the first of them."""
    FIPT_PT_import_presets.draw_panel_header(layout)


def draw_estimate_presets(layout: UILayout, context: Context) -> None:
    """The button that opens the second."""
    FIPT_PT_estimate_presets.draw_panel_header(layout)
