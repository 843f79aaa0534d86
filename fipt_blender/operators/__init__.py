# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: gather options, call the work, report. One file per section of the panel.

They are imported while Blender starts, so a module imports at its top only what declaring its classes needs.
Jobs (`jobs`, `bridge`), work on Blender's data (`blend`) and the heavier modules of the standard library are
imported inside functions.
"""

from __future__ import annotations

import bpy

from ..properties import classes_of
from . import (
    alignment,
    capture,
    check,
    emptying,
    environment,
    estimate,
    export,
    hints,
    lights,
    materials,
    new_light,
    photographs,
    presets,
    start,
)

MODULES = (
    environment,
    photographs,
    start,
    capture,
    alignment,
    estimate,
    hints,
    materials,
    emptying,
    export,
    lights,
    new_light,
    check,
    presets,
)


CLASSES = classes_of(MODULES)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
