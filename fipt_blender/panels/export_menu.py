# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The entry of the menu File > Export."""

from __future__ import annotations

import bpy


def _draw(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator("fipt.export_room", text="FIPT Room (.glb/.usd)")


def register() -> None:
    """Add the entry."""
    bpy.types.TOPBAR_MT_file_export.append(_draw)


def unregister() -> None:
    """Remove it."""
    bpy.types.TOPBAR_MT_file_export.remove(_draw)
