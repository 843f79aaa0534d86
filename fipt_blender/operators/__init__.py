# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: gather, call, report. One file a section of the panel, each with its CLASSES.

They are imported while Blender starts, so they import at their top only what declaring them needs. Jobs
(`runjob`, `mainjob`, `datajob`, `bridge`), work on Blender's data (`blend`) and the heavier modules of the
standard library are imported where they are used.
"""

from __future__ import annotations

import bpy

from . import capture, check, environment, estimate, insert, lights, materials, parts, storage, views

_MODULES = (environment, storage, capture, views, parts, estimate, materials, lights, insert, check)


register, unregister = bpy.utils.register_classes_factory(
    [each for module in _MODULES for each in module.CLASSES]
)
