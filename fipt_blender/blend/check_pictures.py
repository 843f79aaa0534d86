# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders, photographs and errors before the artist: in the panel's list, over the view, in editors."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder
from .backdrop import show_photograph, show_picture
from .cameras import find_camera, use_view
from .images import LINEAR
from .look import view_spaces
from .view_check import read_checks

PICTURE = "fipt_picture"  # marks an image that we showed in an editor


def take_checks(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Bring the panel's list up to date with the run's check.json.

    Raises:
        FiptError: ``file-damaged``.
    """
    settings = scene.fipt.check
    lines = sorted(
        read_checks(run).get("views", []), key=lambda line: (line["split"] != "held_back", line["view"])
    )
    settings.views.clear()
    for line in lines:
        item = settings.views.add()
        item.name, item.held_back = line["view"], line["split"] == "held_back"
        item.psnr, item.psnr_linear = line["psnr"], line["psnr_linear"]
        item.render, item.error = str(run.resolve(line["render"])), str(run.resolve(line["error"]))
    count = max(len(lines), 1)
    settings.mean_psnr = sum(line["psnr"] for line in lines) / count
    settings.mean_psnr_linear = sum(line["psnr_linear"] for line in lines) / count


def show_active(scene: bpy.types.Scene, context: bpy.types.Context) -> bpy.types.Image | None:
    """Look through the active view's camera at the chosen picture; None where there is none.

    It lies over the view in 3D views, and is shown in Image Editors that show one of ours or nothing.
    """
    settings = scene.fipt.check
    view = settings.views[settings.active]
    try:
        camera = find_camera(view.name)
    except FiptError:
        camera = None
    image = None
    if settings.picture != "PHOTOGRAPH":
        image = load_picture(Path(view.render if settings.picture == "RENDER" else view.error))
    if camera is not None:
        use_view(scene, camera)
        show_photograph(scene, camera)
        backgrounds = camera.data.background_images
        if settings.picture == "PHOTOGRAPH" and backgrounds:
            image = backgrounds[0].image
            camera.data.show_background_images = True
            backgrounds[0].alpha = 1.0
        elif image is not None:
            show_picture(camera, image)
        for space in view_spaces(context, scene):
            space.region_3d.view_perspective = "CAMERA"
    if image is not None:
        show_in_editors(context, image)
    return image


def load_picture(path: Path) -> bpy.types.Image | None:
    """An image file as it is on disk now; None where it is missing."""
    if not path.is_file():
        return None
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    image.colorspace_settings.name = LINEAR if path.suffix == ".exr" else "sRGB"
    image[PICTURE] = True
    return image


def show_in_editors(context: bpy.types.Context, image: bpy.types.Image) -> bool:
    """Show an image in the open Image Editors that show one of ours or nothing; whether there was one."""
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
    """Show an image in an Image Editor: an open one, else in a window of its own, as renders are."""
    if show_in_editors(context, image) or context.window is None:
        return
    before = set(context.window_manager.windows)
    bpy.ops.wm.window_new()
    for window in set(context.window_manager.windows) - before:
        area = max(window.screen.areas, key=lambda area: area.width * area.height)
        area.type = "IMAGE_EDITOR"
        area.spaces.active.image = image
    bpy.app.timers.register(_fit_pictures, first_interval=0.2)  # a new window has no size yet


def _fit_pictures() -> None:
    """Zoom the editors that show a picture of ours until it fills them."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type != "IMAGE_EDITOR" or PICTURE not in (area.spaces.active.image or {}):
                continue
            region = next(each for each in area.regions if each.type == "WINDOW")
            with bpy.context.temp_override(window=window, area=area, region=region):
                bpy.ops.image.view_all(fit_view=True)
