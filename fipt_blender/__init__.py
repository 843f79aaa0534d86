"""Factorized Inverse Path Tracing for Blender: materials and lights of a room from its photographs.

bpy is imported only in `register`, so that a Python without bpy can import the engine, `core`.
"""

from __future__ import annotations

import atexit
import sys
from collections.abc import Callable, Sequence
from functools import partial

_undo: list[Callable[[], object]] = []


def register() -> None:
    """Register the preferences, the scene's state, operators, panels and `blender --command fipt`.

    If one of them fails, those before it are unregistered again.
    """
    import bpy

    from . import machine, operators, panels, properties
    from .blend.capture import other_cameras, pair_marks
    from .blend.lights import selected
    from .blend.results import dropped
    from .jobs import session
    from .panels import preferences

    try:
        bpy.utils.register_class(preferences.FIPT_Preferences)
        _undo.append(partial(bpy.utils.unregister_class, preferences.FIPT_Preferences))
        machine.recall()
        watchers = (session, other_cameras, pair_marks, selected, dropped)
        for module in (properties, operators, panels, *watchers):
            module.register()
            _undo.append(module.unregister)
        _undo.append(_hide_overlay)  # while the scenes still have their settings
        command = bpy.utils.register_cli_command("fipt", _run_command_line)
        _undo.append(partial(bpy.utils.unregister_cli_command, command))
    except BaseException:
        unregister()
        raise
    if not bpy.app.binary_path:  # as a module, Blender crashes or hangs at exit while classes are registered
        atexit.register(unregister)


def unregister() -> None:
    """Unregister everything, in reverse order."""
    while _undo:
        _undo.pop()()


def _run_command_line(arguments: Sequence[str]) -> int:
    """`blender --command fipt`; imported on use, to keep Blender's start fast."""
    from . import cli

    return cli.main(arguments)


def _hide_overlay() -> None:
    """Hide the colours drawn over the room, if the module was ever imported."""
    module = sys.modules.get(f"{__package__}.blend.capture.overlay")
    if module is not None:
        module.hide()
