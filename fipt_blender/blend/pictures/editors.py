"""Shows pictures in Image Editors."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..color_spaces import encoded_space
from ..marks import PICTURE


def load_picture(path: Path) -> bpy.types.Image | None:
    """A picture's PNG, reloaded from disk; None where it is missing."""
    if not path.is_file():
        return None
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    image.colorspace_settings.name = encoded_space()
    image[PICTURE] = True
    return image


def show_in_editors(context: bpy.types.Context, image: bpy.types.Image) -> bool:
    """Show an image in the open Image Editors that show one of ours or none; whether there are any."""
    shown = False
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                space = area.spaces.active
                if space.image is None or PICTURE in space.image:
                    space.image = image
                    shown = True
    return shown


def open_editor(context: bpy.types.Context, image: bpy.types.Image) -> None:
    """Show an image in an open Image Editor, else in a new window, as Blender shows renders."""
    if show_in_editors(context, image) or context.window is None:
        return
    existing = set(context.window_manager.windows)
    bpy.ops.wm.window_new()
    for window in set(context.window_manager.windows) - existing:
        area = max(window.screen.areas, key=lambda area: area.width * area.height)
        area.type = "IMAGE_EDITOR"
        area.spaces.active.image = image
    bpy.app.timers.register(_fit_pictures, first_interval=0.2)  # a new window has no size yet


def _fit_pictures() -> None:
    """Zoom the editors that show a picture of ours to fit it."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type != "IMAGE_EDITOR" or PICTURE not in (area.spaces.active.image or {}):
                continue
            region = next(region for region in area.regions if region.type == "WINDOW")
            with bpy.context.temp_override(window=window, area=area, region=region):
                bpy.ops.image.view_all(fit_view=True)
