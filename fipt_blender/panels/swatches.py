"""Icons of a single colour, for legends."""

from __future__ import annotations

import bpy
import bpy.utils.previews

_SIZE = 16  # pixels along an edge
_BORDER = (0.0, 0.0, 0.0, 1.0)

_collections: list[bpy.utils.previews.ImagePreviewCollection] = []


def icon(color: tuple[float, float, float]) -> int:
    """The icon number of a square of a colour (display RGB, 0 to 1); 0 without a window."""
    if bpy.app.background:
        return 0
    if not _collections:
        _collections.append(bpy.utils.previews.new())
    collection, name = _collections[0], str(color)
    if name not in collection:
        preview = collection.new(name)
        preview.icon_size = (_SIZE, _SIZE)
        preview.icon_pixels_float = square_pixels(color)
    return int(collection[name].icon_id)


def square_pixels(color: tuple[float, float, float]) -> list[float]:
    """RGBA pixels of a square with a black border."""
    inner = range(1, _SIZE - 1)
    return [
        value
        for y in range(_SIZE)
        for x in range(_SIZE)
        for value in ((*color, 1.0) if x in inner and y in inner else _BORDER)
    ]


def clear() -> None:
    """Free all icons."""
    while _collections:
        bpy.utils.previews.remove(_collections.pop())
