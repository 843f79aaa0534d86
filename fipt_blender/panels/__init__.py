# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The side panel: draws the state, holds no logic. One file per section."""

from __future__ import annotations

import bpy

from ..properties import classes_of
from . import (
    alignment,
    capture,
    check,
    estimate,
    hints,
    lights,
    materials,
    menus,
    photographs,
    presets,
    progress,
    start,
    swatches,
)

MODULES = (
    start,
    photographs,
    capture,
    alignment,
    estimate,
    hints,
    materials,
    lights,
    check,
    presets,
    menus,
)

CLASSES = [*menus.MENUS, *classes_of(MODULES)]
_register, _unregister = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the panels, the job's place in the status bar, menus and keys."""
    _register()
    progress.register()
    menus.register()


def unregister() -> None:
    """Unregister the panels and free their icons."""
    menus.unregister()
    progress.unregister()
    _unregister()
    swatches.clear()
