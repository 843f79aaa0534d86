# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a run as icons for the panel; loaded by timers and operators, never while drawing."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import bpy
import bpy.utils.previews


class PictureIcons:
    """Icons of image files; none in background."""

    def __init__(self) -> None:
        self._collection: bpy.utils.previews.ImagePreviewCollection | None = None

    def load(self, paths: Iterable[Path]) -> None:
        """Replace the icons by those of these files; missing files are skipped."""
        self.clear()
        if bpy.app.background:
            return
        self._collection = bpy.utils.previews.new()
        for path in paths:
            if path.is_file():
                # Accessing the size reads the file now instead of at the first drawing.
                tuple(self._collection.load(str(path), str(path), "IMAGE", force_reload=True).image_size)

    def icon(self, path: Path) -> int:
        """The icon number of a loaded file; 0 if it is not loaded."""
        if self._collection is None or str(path) not in self._collection:
            return 0
        return int(self._collection[str(path)].icon_id)

    def clear(self) -> None:
        """Free the icons."""
        if self._collection is not None:
            bpy.utils.previews.remove(self._collection)
            self._collection = None


estimate_pictures = PictureIcons()  # the estimate so far
doubt_pictures = PictureIcons()  # the parts that the engine asks about
state_pictures = PictureIcons()  # thumbnails of light states


def clear() -> None:
    """Free all icons."""
    estimate_pictures.clear()
    doubt_pictures.clear()
    state_pictures.clear()
