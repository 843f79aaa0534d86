"""Reads and writes image files as arrays with Blender's own image code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ...core.run.contents import CapturedView
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..image_datablocks import image_values
from ..png16 import decode_srgb
from ..save import write_error

# Image settings of a still by the scene's color management. From Blender 5.0 the type of media comes first,
# since it decides on formats.
STILL_IMAGE = {
    name: value
    for name, value in (("media_type", "IMAGE"), ("color_management", "FOLLOW_SCENE"))
    if name in bpy.types.ImageFormatSettings.bl_rna.properties
}
# Of all layers and passes of a render; depths are floats of 32 bits in any case.
LAYERED_IMAGE = {
    **({**STILL_IMAGE, "media_type": "MULTI_LAYER_IMAGE"} if "media_type" in STILL_IMAGE else STILL_IMAGE),
    "file_format": "OPEN_EXR_MULTILAYER",
    "color_depth": "16",
    "exr_codec": "ZIP",
}
PNG = {"file_format": "PNG", "color_mode": "RGB", "color_depth": "8"}


def photograph(run: RunFolder, view: CapturedView) -> np.ndarray:
    """A view's photograph, (H, W, 3) f32 scene-linear, first row at the top.

    One that is not HDR is read as if its response were sRGB's curve.
    """
    path = run.resolve(view.image)
    try:
        pixels = read_pixels(path)
        if not pixels.size:
            raise ValueError("no pixels")
        return decode_srgb(pixels) if view.encoded else pixels
    except (RuntimeError, ValueError):
        raise FiptError("image-missing.photograph", path=path, name=view.name) from None


def read_pixels(path: Path, channels: int = 3) -> np.ndarray:
    """Pixels of an image file as they are stored, (H,W,channels) f32, first row at the top."""
    image = bpy.data.images.load(str(path))
    try:
        image.colorspace_settings.is_data = True
        return image_values(image)[::-1, :, :channels].copy()
    finally:
        bpy.data.images.remove(image)


def write_image(path: Path, temporary: Path, write: Callable[[], object]) -> None:
    """Write `temporary`, which becomes `path`."""
    try:
        write()
        # On a full disk Blender writes a part of a PNG and reports nothing.
        if path.suffix == ".png" and b"IEND" not in temporary.read_bytes()[-16:]:
            raise RuntimeError("the file is incomplete")
    except RuntimeError as error:
        raise write_error(path, error, "run-unwritable") from None
