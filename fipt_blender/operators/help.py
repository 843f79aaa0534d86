# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Opens the guide's chapter on a section of the side panel."""

from __future__ import annotations

import bpy

from ..panels import manual
from .polls import all_of, needs


class FIPT_OT_help(bpy.types.Operator):
    """Open the guide's chapter on this section in the web browser"""

    bl_idname = "fipt.help"
    bl_label = "Open Guide"

    chapter: bpy.props.StringProperty(
        name="Chapter", description="The chapter; the guide's first page if empty", options={"SKIP_SAVE"}
    )

    poll = all_of(
        needs(
            lambda context: manual.address(),
            "The guide is part of the extension's zip. Install it, or read docs/guide.md",
        )
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        bpy.ops.wm.url_open(url=manual.address() + manual.chapter_page(self.chapter))
        return {"FINISHED"}
