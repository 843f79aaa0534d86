# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows renders, photographs and error images: in the panel's list, over the view, in Image Editors."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..capture.backdrop import show_photograph, show_picture
from ..capture.cameras import find_camera, use_view
from ..capture.compare import end
from ..capture.look import enter_camera
from ..color_spaces import set_encoded, set_linear
from ..marks import PICTURE
from .view_check import read_checks


def take_checks(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Fill the panel's list from the run's check.json.

    Raises:
        FiptError: ``file-damaged``.
    """
    settings = scene.fipt.check
    checked = sorted(read_checks(run).views, key=lambda view: (view.split != "held_back", view.view))
    settings.views.clear()
    for view in checked:
        item = settings.views.add()
        item.name, item.held_back = view.view, view.split == "held_back"
        item.psnr, item.psnr_linear = view.psnr, view.psnr_linear
        item.render, item.error = str(run.resolve(view.render)), str(run.resolve(view.error))
    count = max(len(checked), 1)
    settings.mean_psnr = sum(view.psnr for view in checked) / count
    settings.mean_psnr_linear = sum(view.psnr_linear for view in checked) / count


def show_active(scene: bpy.types.Scene, context: bpy.types.Context) -> bpy.types.Image | None:
    """Show the chosen picture of the active view, and look through its camera; None where there is none.

    The picture is shown over the view in 3D views, and in Image Editors that show one of ours or none.
    """
    settings = scene.fipt.check
    view = settings.views[settings.active]
    try:
        camera = find_camera(view.name, scene)
    except FiptError:
        camera = None
    image = None
    if settings.picture != "PHOTOGRAPH":
        image = load_picture(Path(view.render if settings.picture == "RENDER" else view.error))
    if camera is not None:
        end(scene)
        use_view(scene, camera)
        show_photograph(scene, camera)
        backgrounds = camera.data.background_images
        if settings.picture == "PHOTOGRAPH" and backgrounds:
            image = backgrounds[0].image
            camera.data.show_background_images = True
            backgrounds[0].alpha = 1.0
        elif image is not None:
            show_picture(camera, image)
        enter_camera(context, scene)
    if image is not None:
        show_in_editors(context, image)
    return image


def load_picture(path: Path) -> bpy.types.Image | None:
    """An image file, reloaded from disk; None where it is missing."""
    if not path.is_file():
        return None
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    is_radiance = path.suffix == ".exr"
    (set_linear if is_radiance else set_encoded)(image)
    image.use_view_as_render = is_radiance  # the scene's view transform and exposure
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
