# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The side panel: draws state, holds no logic. One file a section, each with its CLASSES."""

from __future__ import annotations

import bpy

from . import capture, check, estimate, insert, lights, materials, parts

_MODULES = (capture, parts, estimate, materials, lights, insert, check)


def register() -> None:
    """Register all panels and lists."""
    for module in _MODULES:
        for each in module.CLASSES:
            bpy.utils.register_class(each)


def unregister() -> None:
    """Take them back."""
    for module in reversed(_MODULES):
        for each in reversed(module.CLASSES):
            bpy.utils.unregister_class(each)
