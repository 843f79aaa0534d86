# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job's timer has to tell Blender's windows: redraw the panels, add an undo step."""

from __future__ import annotations

import bpy


def redraw() -> None:
    """Redraw the sidebars and preferences that show jobs."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PREFERENCES"):
                for region in area.regions:
                    if region.type in ("UI", "WINDOW") and (area.type, region.type) != ("VIEW_3D", "WINDOW"):
                        region.tag_redraw()


def push_undo(text: str) -> None:
    """Add an undo step for a change that a timer made to Blender's data."""
    windows = bpy.context.window_manager.windows
    if windows:
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.ed.undo_push(message=text)
