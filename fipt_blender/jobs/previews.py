# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview images of a run as icons for the panel; loaded by timers, never while drawing."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import bpy
import bpy.utils.previews

_collections: list[bpy.utils.previews.ImagePreviewCollection] = []


def load(paths: Iterable[Path]) -> None:
    """Replace the icons by those of the given image files; missing files are skipped."""
    clear()
    if bpy.app.background:
        return
    collection = bpy.utils.previews.new()
    _collections.append(collection)
    for path in paths:
        if path.is_file():
            # Accessing the size reads the file now instead of at the first drawing.
            tuple(collection.load(str(path), str(path), "IMAGE", force_reload=True).image_size)


def icon(path: Path) -> int:
    """The icon number of a loaded file; 0 if it is not loaded."""
    for collection in _collections:
        if str(path) in collection:
            return int(collection[str(path)].icon_id)
    return 0


def clear() -> None:
    """Free all icons."""
    while _collections:
        bpy.utils.previews.remove(_collections.pop())
