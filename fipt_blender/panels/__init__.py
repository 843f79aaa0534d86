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
)

CLASSES = classes_of(MODULES)
_register, _unregister = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the panels, and the job's place in the status bar."""
    _register()
    progress.register()


def unregister() -> None:
    """Unregister the panels and free their icons."""
    progress.unregister()
    _unregister()
    swatches.clear()
