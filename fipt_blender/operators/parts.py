# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Parts: which surfaces share a material."""

from __future__ import annotations

from typing import Annotated

import bpy

from .action import REGISTER, action
from .polls import needs


@action(
    "Show Parts",
    needs=(
        needs(
            lambda context: context.scene.fipt.parts.counts,
            "Use Check Views first, in the section Capture; it finds the parts as well",
        ),
    ),
    options=REGISTER,
)
def show_parts(scene: bpy.types.Scene, show: Annotated[bool, "Show or hide the colors"] = True) -> None:
    """Display the parts of the room, each in its own color."""
    from ..blend.capture import overlay, survey

    survey.show_parts(scene) if show else overlay.hide()
