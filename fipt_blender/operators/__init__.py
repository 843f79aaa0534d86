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
    additions,
    aim,
    alignment,
    calibration,
    capture,
    check,
    eevee,
    environment,
    estimate,
    example,
    export,
    hints,
    insert,
    light_states,
    lights,
    materials,
    new_light,
    part_materials,
    parts,
    photographs,
    picture,
    presets,
    scale_points,
    start,
    storage,
    versions,
    views,
)

MODULES = (
    environment,
    storage,
    photographs,
    scale_points,
    start,
    capture,
    views,
    additions,
    alignment,
    parts,
    estimate,
    example,
    hints,
    versions,
    materials,
    part_materials,
    export,
    lights,
    calibration,
    new_light,
    light_states,
    eevee,
    aim,
    insert,
    picture,
    check,
    presets,
)


CLASSES = classes_of(MODULES)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
