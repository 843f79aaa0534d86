# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Versions of the section Estimate: the estimates that the run keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..jobs import running, runstate
from .estimate import draw_setting
from .sidebar import SubSection, draw_text, size_text

if TYPE_CHECKING:
    from ..core.run.versions import Version


class FIPT_PT_estimate_versions(SubSection, bpy.types.Panel):
    """Earlier estimates of this run: use, compare, name and delete them"""

    bl_label = "Versions"
    bl_parent_id = "FIPT_PT_estimate"
    bl_order = 2

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return runstate.known(context.scene.fipt.run_folder).results

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        state = runstate.known(context.scene.fipt.run_folder)
        materials = context.scene.fipt.materials
        shown = materials.applied_version if materials.object_count else ""
        column = layout.column()
        column.enabled = running.current() is None
        for version in state.versions:
            _draw_version(column.box(), version, shown)
        text = iface_("{} in all").format(size_text(state.size))
        layout.label(text=text, icon="DISK_DRIVE", translate=False)
        if shown and state.versions and shown != state.versions[0].id:
            text = iface_(
                "The room shows another estimate than the one in use. Apply Results shows the one in use."
            )
            draw_text(layout, context, text, icon="INFO")
        column = layout.column()
        column.enabled = running.current() is None
        draw_setting(column, context.scene.fipt.estimate, "kept_versions")


def _draw_version(layout: bpy.types.UILayout, version: Version, shown: str) -> None:
    """One version: title, what it differs in, size, and what can be done with it."""
    icon = "RADIOBUT_ON" if version.current else "RADIOBUT_OFF"
    column = layout.column(align=True)
    row = column.row()
    row.alignment = "LEFT"
    button = row.operator("fipt.use_version", text=version.title, icon=icon, emboss=False, translate=False)
    button.version = version.id
    facts = [version.made if version.name else "", version.what]
    if text := ", ".join(filter(None, facts)):
        column.label(text=text, icon="BLANK1", translate=False)
    row = column.row(align=True)
    icon = "CHECKMARK" if version.id == shown else "BLANK1"
    row.label(text=size_text(version.size), icon=icon, translate=False)
    buttons = [("fipt.rename_version", "GREASEPENCIL")]
    if not version.current:
        buttons += [("fipt.compare_versions", "SPLIT_HORIZONTAL"), ("fipt.delete_version", "X")]
    for name, icon in buttons:
        row.operator(name, text="", icon=icon, emboss=False).version = version.id
