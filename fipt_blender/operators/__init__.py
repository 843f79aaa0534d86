# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: gather, call, report. One file a section of the panel, each with its CLASSES.

At their top they import bpy, the standard library, `bridge` and the light modules of `core/job` alone; what
needs numpy (all of `blend`) is imported where it is used, since this is imported while Blender starts.
"""

from __future__ import annotations

import bpy

from . import capture, check, environment, estimate, insert, lights, materials, parts, storage, views

_MODULES = (environment, storage, capture, views, parts, estimate, materials, lights, insert, check)


def register() -> None:
    """Register all operators."""
    for module in _MODULES:
        for each in module.CLASSES:
            bpy.utils.register_class(each)


def unregister() -> None:
    """Take all operators back."""
    for module in reversed(_MODULES):
        for each in reversed(module.CLASSES):
            bpy.utils.unregister_class(each)
