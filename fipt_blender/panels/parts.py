# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Parts of the section Estimate: selects how surfaces of the same material are recognised."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..properties.parts import SOURCES
from .capture import shown_colors
from .sidebar import SubSection, draw_text

_NAMES = {identifier: name for identifier, name, _, _ in SOURCES}
_TEXTS = {identifier: text for identifier, _, text, _ in SOURCES}


class FIPT_PT_parts(SubSection, bpy.types.Panel):
    """Select which surfaces are made of the same material"""

    bl_label = "Parts"
    bl_parent_id = "FIPT_PT_estimate"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        import json

        layout = self.fields()
        parts = context.scene.fipt.parts
        layout.prop(parts, "source")
        if parts.source == "folder":
            layout.prop(parts, "folder")
        draw_text(layout, context, iface_(_TEXTS[parts.source]))
        source = parts.engine_source
        if parts.source == "auto" and parts.auto_source:
            source = parts.auto_source
            text = iface_("Automatic uses: {}").format(iface_(_NAMES.get(source, source)))
            draw_text(layout, context, text, icon="SHADERFX")
        if parts.counts:
            count = json.loads(parts.counts).get(source)
            if count is not None:
                layout.label(text=iface_("{} parts").format(count), icon="MOD_EXPLODE", translate=False)
        shown = shown_colors(context.scene) == "parts"
        layout.operator(
            "fipt.show_parts", text="Hide Parts" if shown else "Show Parts", icon="OVERLAY", depress=shown
        ).show = not shown
