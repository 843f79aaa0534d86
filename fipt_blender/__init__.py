# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Factorized Inverse Path Tracing for Blender: materials and lights of a room from its photographs.

bpy is imported only while registering, so that the engine imports as `core` where there is no bpy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial

_undo: list[Callable[[], object]] = []


def register() -> None:
    """Register the preferences, the scene's state, operators, panels and `blender --command fipt`.

    Where something fails, what was registered before is taken back.
    """
    import bpy

    from . import operators, panels, preferences, properties, running

    try:
        for each in preferences.CLASSES:
            bpy.utils.register_class(each)
            _undo.append(partial(bpy.utils.unregister_class, each))
        preferences.recall()
        _undo.append(_hide_overlay)
        for room in (properties, operators, panels, running):
            room.register()
            _undo.append(room.unregister)
        command = bpy.utils.register_cli_command("fipt", _run_command_line)
        _undo.append(partial(bpy.utils.unregister_cli_command, command))
    except BaseException:
        unregister()
        raise


def unregister() -> None:
    """Take everything back, in reverse order."""
    while _undo:
        _undo.pop()()


def _run_command_line(arguments: Sequence[str]) -> int:
    """`blender --command fipt`; imported when it is used, as starting Blender should not wait for it."""
    from . import cli

    return cli.main(arguments)


def _hide_overlay() -> None:
    """Take down what is drawn over the room, where that was ever loaded."""
    overlay = sys.modules.get(f"{__package__}.blend.overlay")
    if overlay is not None:
        overlay.hide()
