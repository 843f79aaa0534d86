# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays to image files and photographs to arrays, by what Blender itself can read and write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, atomic_path
from .images import LINEAR
from .renders import changed, read_pixels


def view_entry(capture: dict[str, Any], name: str) -> dict[str, Any]:
    """A view's entry of capture.json.

    Raises:
        FiptError: ``view-missing``.
    """
    for view in capture["views"]:
        if view["name"] == name:
            return view
    raise FiptError(
        "view-missing", f"The capture of this run has no view '{name}'.", "Choose one of its views."
    )


def photograph(run: RunFolder, view: dict[str, Any]) -> np.ndarray:
    """A view's photograph, (H, W, 3) f32 scene-linear, first row at the top.

    Raises:
        FiptError: ``image-missing`` or ``path-outside``.
    """
    path = run.resolve(view["image"])
    try:
        return read_pixels(path)
    except (RuntimeError, ValueError):
        raise FiptError(
            "image-missing",
            f"The photograph {path} can't be read.",
            "Bring the file back to its place, or import the capture again.",
        ) from None


def save_exr(path: Path, pixels: np.ndarray) -> None:
    """Write scene-linear values (H, W, 3), first row at the top, as float EXR, whole or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    _save(path, pixels, "OPEN_EXR", is_float=True)


def save_png(path: Path, display: np.ndarray) -> None:
    """Write display values in [0, 1] (H, W, 3), first row at the top, as 8-bit PNG, whole or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    _save(path, display, "PNG", is_float=False)


def _save(path: Path, pixels: np.ndarray, file_format: str, is_float: bool) -> None:
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(path.stem, width, height, alpha=False, float_buffer=is_float)
    try:
        image.colorspace_settings.is_data = True  # otherwise saving converts float values to sRGB
        values = np.ones((height, width, 4), np.float32)
        values[..., :3] = pixels[::-1]
        image.pixels.foreach_set(values.ravel())
        with atomic_path(path) as temporary:
            image.filepath_raw, image.file_format = str(temporary), file_format
            _written(path, image.save)
    finally:
        bpy.data.images.remove(image)


def save_look(source: Path, path: Path, scene: bpy.types.Scene) -> None:
    """Write a scene-linear image as the scene's view transform shows it, as PNG.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    image = bpy.data.images.load(str(source))
    image.colorspace_settings.name = LINEAR
    settings = scene.render.image_settings
    media = {"media_type": "IMAGE"} if "media_type" in settings.bl_rna.properties else {}
    try:
        png = {"file_format": "PNG", "color_mode": "RGB", "color_depth": "8"}
        with changed(settings, media), changed(settings, png), atomic_path(path) as temporary:
            _written(path, lambda: image.save_render(str(temporary), scene=scene))
    finally:
        bpy.data.images.remove(image)


def _written(path: Path, write: Any) -> None:
    try:
        write()
    except RuntimeError as error:
        raise FiptError(
            "run-unwritable",
            f"{path} could not be written ({str(error).strip()}).",
            "Free some space, or choose a folder that you may write to.",
        ) from None
