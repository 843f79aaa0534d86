# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The side panel: draws state, holds no logic. One file a section, each with its CLASSES."""

from __future__ import annotations

import bpy

from . import capture, check, estimate, insert, lights, materials, parts

_MODULES = (capture, parts, estimate, materials, lights, insert, check)

register, unregister = bpy.utils.register_classes_factory(
    [each for module in _MODULES for each in module.CLASSES]
)
