# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview images of a run as icons for the panel, loaded while nothing is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews

_collections: list[Any] = []


def load(paths: Iterable[Path]) -> None:
    """Make icons of image files, in place of the earlier ones; those that can't be read are left out."""
    clear()
    if bpy.app.background:
        return
    collection = bpy.utils.previews.new()
    _collections.append(collection)
    for path in paths:
        if path.is_file():
            # Asking for its size reads it now and not when it is drawn first.
            tuple(collection.load(str(path), str(path), "IMAGE", force_reload=True).image_size)


def icon(path: Path) -> int:
    """The icon of a loaded file; 0 where there is none."""
    for collection in _collections:
        if str(path) in collection:
            return int(collection[str(path)].icon_id)
    return 0


def clear() -> None:
    """Free all icons."""
    while _collections:
        bpy.utils.previews.remove(_collections.pop())
