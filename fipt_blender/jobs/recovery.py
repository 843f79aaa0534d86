# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The run that a Blender has left behind without saving its scene, offered again by the section Start.

While drawing, the answer comes from a cache, which a timer fills soon after.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import machine
from .window import redraw

if TYPE_CHECKING:
    from ..bridge.unsaved import Unsaved

_found: dict[str, Unsaved | None] = {}  # by data folder


def register() -> None:
    """Let saved files know their runs."""
    bpy.app.handlers.save_post.append(_note_saved)


def unregister() -> None:
    """Remove the handler and forget what was found."""
    bpy.app.handlers.save_post.remove(_note_saved)
    _found.clear()


def known() -> Unsaved | None:
    """The newest run of which no file knows; None before the timer has looked."""
    data = str(machine.data_folder())
    if data not in _found and not bpy.app.background and not bpy.app.timers.is_registered(look_for_unsaved):
        bpy.app.timers.register(look_for_unsaved, first_interval=0.0)
    return _found.get(data)


def forget() -> None:
    """Look again at the next drawing."""
    _found.clear()


def look_for_unsaved() -> None:
    from ..bridge.unsaved import newest

    data = machine.data_folder()
    used = [Path(bpy.path.abspath(scene.fipt.run_folder)).absolute() for scene in bpy.data.scenes]
    _found[str(data)] = newest(data, used)
    redraw()


@bpy.app.handlers.persistent
def _note_saved(*_: object) -> None:
    from ..bridge.places import runs_folder
    from ..bridge.unsaved import unmark

    runs = runs_folder(machine.data_folder())
    for scene in bpy.data.scenes:
        folder = Path(bpy.path.abspath(scene.fipt.run_folder))
        if scene.fipt.run_folder and folder.parent == runs:  # others have no mark
            unmark(folder)
