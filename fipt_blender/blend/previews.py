"""Pictures of a run as icons for the panel; read by timers, operators and threads, never while drawing."""

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
        for path in paths:
            if path.is_file():
                self.add(path)
                # Accessing the size reads the file now instead of at the first drawing.
                if self._collection is not None:
                    tuple(self._collection[str(path)].image_size)

    def add(self, path: Path) -> int:
        """The icon number of a file, which Blender reads in a thread of its own where it is drawn first."""
        if bpy.app.background:
            return 0
        if self._collection is None:
            self._collection = bpy.utils.previews.new()
        if str(path) not in self._collection:
            self._collection.load(str(path), str(path), "IMAGE")
        return self.icon(path)

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
view_pictures = PictureIcons()  # the photographs
doubt_pictures = PictureIcons()  # the parts that the engine asks about


def clear() -> None:
    """Free all icons."""
    estimate_pictures.clear()
    view_pictures.clear()
    doubt_pictures.clear()
