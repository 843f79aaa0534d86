"""The operators: gather options, call the work, report. One file per section of the panel.

They are imported while Blender starts, so a module imports at its top only what declaring its classes needs.
Jobs (`jobs`, `bridge`), work on Blender's data (`blend`) and the heavier modules of the standard library are
imported inside functions.
"""

from __future__ import annotations

import bpy

from ..properties import classes_of
from . import menus

MODULES = tuple(module for modules in menus.CHAPTERS.values() for module in modules)
CLASSES = [*menus.MENUS, *classes_of([*MODULES, menus])]
_register, _unregister = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the operators, menus and keys."""
    _register()
    menus.register()


def unregister() -> None:
    """Unregister them."""
    menus.unregister()
    _unregister()
