# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the parts that the engine asks about, as icons; loaded by operators, never while drawing."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import bpy
import bpy.utils.previews

_collections: list[bpy.utils.previews.ImagePreviewCollection] = []


def load(paths: Iterable[Path]) -> None:
    """Replace the icons by those of these files; missing files are skipped."""
    clear()
    if bpy.app.background:
        return
    collection = bpy.utils.previews.new()
    _collections.append(collection)
    for path in paths:
        if path.is_file():
            # Accessing the size reads the file now instead of at the first drawing.
            tuple(collection.load(str(path), str(path), "IMAGE", force_reload=True).image_size)


def icon(path: str) -> int:
    """The icon number of a loaded file; 0 if it is not loaded."""
    for collection in _collections:
        if path in collection:
            return int(collection[path].icon_id)
    return 0


def clear() -> None:
    """Free all icons."""
    while _collections:
        bpy.utils.previews.remove(_collections.pop())
