# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photograph and render of a view, wiped side by side: a picture whose left part is the photograph.

It lies over the view as its photograph does, so that Blender shows both parts with the scene's view transform
and exposure. The right part is the render, or transparent: the viewport is seen there.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.capture.averaging import means
from ...core.run.errors import FiptError
from ..image_datablocks import linear_values, load_radiance
from ..marks import KEPT_PHOTOGRAPH, PICTURE, VIEW, all_view_cameras
from .backdrop import show_photograph, show_photographs, show_picture

NAME = "FIPT Compare"
_MAX_WIDTH = 1920  # of the picture: a wider one would not follow the pointer


@dataclass(frozen=True)
class _Pair:
    """The two pictures that are compared, (H,W,4) f32 rows from the bottom up, alpha premultiplied."""

    scene: str
    camera: str
    left: np.ndarray
    right: np.ndarray


_pair: _Pair | None = None


def start(scene: bpy.types.Scene, mode: str) -> bpy.types.Image:
    """Show the comparison over the scene's camera, in place of an earlier one.

    Args:
        scene: its camera must be that of a view, with its photograph.
        mode: "RENDER" for the view's render in the section Render, "VIEWPORT" for the viewport itself.

    Raises:
        FiptError: ``view-missing``, ``image-missing``, ``render-missing``, ``color-space-missing``.
    """
    end(scene)
    camera = scene.camera
    if camera is None or VIEW not in camera:
        raise FiptError(
            "view-missing",
            "The scene's active camera is no camera of the capture.",
            "Click a view in the section Capture to look through its camera.",
        )
    photograph = _photograph(camera)
    if photograph is None:
        raise FiptError(
            "image-missing",
            "The photograph of this view is missing.",
            "Import the capture again, from the folder where its photographs are now.",
        )
    left = pixels_of(photograph)
    right = np.zeros_like(left)
    if mode == "RENDER":
        image = _render(scene, camera[VIEW])
        right = means(pixels_of(image), left.shape[1], left.shape[0]).astype(np.float32)
        right[..., 3] = 1.0
    return _show(scene, mode, left, right)


def start_pair(scene: bpy.types.Scene, left: np.ndarray, right: np.ndarray) -> bpy.types.Image:
    """Compare two pictures (H,W,4) that are shown as they are, over the scene's camera.

    Args:
        scene: its camera must be that of a view.
        left, right: display values, linear; the scene's exposure is taken out of them.
    """
    end(scene)
    gain = np.array([*[2.0**-scene.view_settings.exposure] * 3, 1.0], np.float32)
    right = means(right, left.shape[1], left.shape[0]).astype(np.float32)
    return _show(scene, "VERSIONS", left * gain, right * gain)


def _show(scene: bpy.types.Scene, mode: str, left: np.ndarray, right: np.ndarray) -> bpy.types.Image:
    global _pair
    _pair = _Pair(scene.name, scene.camera.name, left, right)
    image = bpy.data.images.new(NAME, left.shape[1], left.shape[0], alpha=True, float_buffer=True)
    image.alpha_mode, image.use_view_as_render = "PREMUL", True
    image[PICTURE] = True
    show_picture(scene.camera, image)
    scene.fipt.check.compare = mode
    move(scene)
    _listen()
    return image


def follow(scene: bpy.types.Scene) -> None:
    """Compare the view to which the scene's camera has changed, as long as a comparison is shown."""
    mode = scene.fipt.check.compare
    if mode == "VERSIONS":  # its pictures are of one view
        end(scene)
    elif mode != "OFF":
        try:
            start(scene, mode)
        except FiptError:
            end(scene)


def refresh(scene: bpy.types.Scene) -> None:
    """Show over all views what belongs there: the comparison, else photographs if the panel says so."""
    show_photographs(scene)
    follow(scene)


def end(scene: bpy.types.Scene) -> None:
    """Show photographs as before, and remove the comparison, if there is one."""
    global _pair
    scene.fipt.check.compare = "OFF"
    if _pair is not None and _pair.scene != scene.name:
        return
    _pair = None
    image = bpy.data.images.get(NAME)
    if image is None:
        return
    for camera in all_view_cameras(scene):
        if any(background.image == image for background in camera.data.background_images):
            show_photograph(scene, camera)
    bpy.data.images.remove(image)


def move(scene: bpy.types.Scene) -> None:
    """Draw the comparison with its divider where the panel has it."""
    image = bpy.data.images.get(NAME)
    if _pair is None or image is None or _pair.scene != scene.name:
        return
    image.pixels.foreach_set(wiped(_pair.left, _pair.right, scene.fipt.check.divider).ravel())
    image.update()


def compared_camera(scene: bpy.types.Scene) -> str:
    """Name of the camera over which the comparison lies; "" for none."""
    return _pair.camera if _pair is not None and _pair.scene == scene.name else ""


def wiped(left: np.ndarray, right: np.ndarray, divider: float) -> np.ndarray:
    """A picture (H,W,C) with the columns of `left` up to the divider (0 to 1), then those of `right`."""
    picture = right.copy()
    columns = round(divider * left.shape[1])
    picture[:, :columns] = left[:, :columns]
    return picture


def _render(scene: bpy.types.Scene, view: str) -> bpy.types.Image:
    """The render of a view in the section Render.

    Raises:
        FiptError: ``render-missing``.
    """
    rendered = scene.fipt.check.views.get(view)
    image = None if rendered is None else load_radiance(Path(bpy.path.abspath(rendered.render)))
    if image is None or not _loads(image):
        raise FiptError(
            "render-missing",
            f"There is no render of the view '{view}'.",
            "Use Render Views in the section Render with the choice Current, or compare with the viewport.",
        )
    return image


def _photograph(camera: bpy.types.Object) -> bpy.types.Image | None:
    kept: bpy.types.Image | None = camera.data.get(KEPT_PHOTOGRAPH)
    if kept is None and camera.data.background_images:
        kept = camera.data.background_images[0].image
    return kept if _loads(kept) else None


def _loads(image: bpy.types.Image | None) -> bool:
    """Whether an image's file can be read; Blender loads it when its size is asked for."""
    return image is not None and min(image.size) > 0


def pixels_of(image: bpy.types.Image) -> np.ndarray:
    """An image's linear values (H,W,4), made smaller where it is wider than the picture may be."""
    width, height = image.size
    if width <= _MAX_WIDTH:
        return _all_pixels(image)
    copy = image.copy()
    try:
        copy.scale(_MAX_WIDTH, max(round(height * _MAX_WIDTH / width), 1))
        return _all_pixels(copy)
    finally:
        bpy.data.images.remove(copy)


def _all_pixels(image: bpy.types.Image) -> np.ndarray:
    values = linear_values(image)
    picture = np.ones((*values.shape[:2], 4), np.float32)
    picture[..., : min(image.channels, 3)] = values[..., :3]
    return picture


@bpy.app.handlers.persistent
def _before_saving(*_: object) -> None:
    """Save files without the comparison, whose picture is in no file."""
    for scene in bpy.data.scenes:
        end(scene)


@bpy.app.handlers.persistent
def _after_loading(*_: object) -> None:
    """Forget the comparison of the file before."""
    global _pair
    _pair = None
    forget()


def _listen() -> None:
    if _before_saving not in bpy.app.handlers.save_pre:
        bpy.app.handlers.save_pre.append(_before_saving)
        bpy.app.handlers.load_post.append(_after_loading)


def forget() -> None:
    """Remove the comparison and the handlers, if there are any."""
    if _before_saving in bpy.app.handlers.save_pre:
        bpy.app.handlers.save_pre.remove(_before_saving)
        bpy.app.handlers.load_post.remove(_after_loading)
    _before_saving()
