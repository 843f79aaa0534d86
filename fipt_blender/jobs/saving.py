# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Saving a file brings the textures of results beside it that were applied while it had no name."""

from __future__ import annotations

import bpy

_before: dict[str, str] = {}  # paths of images as they were, by name, until the file is saved


def register() -> None:
    """Listen to saving."""
    bpy.app.handlers.save_pre.append(_bring)
    bpy.app.handlers.save_post.append(_after)


def unregister() -> None:
    """Stop listening."""
    bpy.app.handlers.save_pre.remove(_bring)
    bpy.app.handlers.save_post.remove(_after)


@bpy.app.handlers.persistent
def _bring(path: str, *_: object) -> None:
    from pathlib import Path

    from ..blend.collecting import bring, pictures_in_runs
    from ..core.run.errors import FiptError

    _before.clear()
    # A file that has a name and is saved under another one is a copy, or finds its textures where they are.
    if not path or (bpy.data.filepath and Path(path) != Path(bpy.data.filepath)):
        return
    images = pictures_in_runs(Path(path).parent)
    _before.update({image.name: image.filepath_raw for image in images})
    try:
        bring(images, Path(path))
    except FiptError as error:  # the file is saved with the textures where they are
        from .window import show_notice

        _restore()
        print(f"fipt: {error}")
        if not bpy.app.background:
            show_notice(str(error), "WARNING")


@bpy.app.handlers.persistent
def _after(*_: object) -> None:
    if not bpy.data.filepath:  # a copy was saved, which has its own textures
        _restore()
    _before.clear()


def _restore() -> None:
    for name, path in _before.items():
        if name in bpy.data.images:
            bpy.data.images[name].filepath_raw = path
