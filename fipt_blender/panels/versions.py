# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Versions of the section Estimate: the estimates of the scene's capture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..jobs import running, runstate
from .sidebar import SubSection, draw_text

if TYPE_CHECKING:
    from ..core.run.versions import Version


class FIPT_PT_estimate_versions(SubSection, bpy.types.Panel):
    """Other estimates of this capture: apply and delete them"""

    bl_label = "Versions"
    bl_parent_id = "FIPT_PT_estimate"
    bl_order = 2

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = runstate.known(context.scene.fipt.run_folder)
        return bool(state.versions) or state.old_versions

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        state = runstate.known(context.scene.fipt.run_folder)
        column = layout.column()
        column.enabled = running.current() is None
        for version in state.versions:
            _draw_version(column.box(), version)
        if state.old_versions:
            text = "The run's folder 'versions' has results of an earlier release, which are not listed."
            draw_text(layout, context, iface_(text), icon="INFO")


def _draw_version(layout: bpy.types.UILayout, version: Version) -> None:
    """One version: title, what it differs in, and what can be done with it."""
    icon = "RADIOBUT_ON" if version.current else "RADIOBUT_OFF"
    column = layout.column(align=True)
    row = column.row()
    button = row.operator("fipt.use_version", text=version.title, icon=icon, emboss=False, translate=False)
    button.version = version.folder.name
    if not version.current:
        row.operator("fipt.delete_version", text="", icon="X", emboss=False).version = version.folder.name
    if version.what:
        column.label(text=version.what, icon="BLANK1", translate=False)
