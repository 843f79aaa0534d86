"""Image files as Blender images, with the colour space of their content, and images as arrays."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np

from ..core.run.errors import FiptError
from .color_spaces import encoded_space, linear_space, to_scene_linear
from .png16 import decode_srgb

MOST_PATH_BYTES = 1023


def check_length(path: Path) -> None:
    """Refuse a path that is longer than Blender's."""
    if len(os.fsencode(path)) > MOST_PATH_BYTES:
        raise FiptError(
            "path-long", path=str(path)[:80], number_of_path=len(str(path)), most_path_bytes=MOST_PATH_BYTES
        )


def load_radiance(path: Path, encoded: bool) -> bpy.types.Image | None:
    """A linear image, shown as renders are, or one of codes (`encoded`) as it is; None where it is not."""
    if not path.is_file():
        return None
    check_length(path)
    image = bpy.data.images.load(str(path), check_existing=True)
    _set_color_space(image, path, False)
    image.use_view_as_render = not encoded  # the scene's view transform and exposure
    return image


def load_texture(path: Path, is_data: bool) -> bpy.types.Image:
    """A texture of a run. One that is in the file stays, since no other content has its path."""
    image = bpy.data.images.load(str(path), check_existing=True)
    if not (image.has_data or image.packed_file):  # the file may have been missing
        image.reload()
    _set_color_space(image, path, is_data)
    return image


def _set_color_space(image: bpy.types.Image, path: Path, is_data: bool) -> None:
    """Set the colour space; reading a file sets it in some versions."""
    settings = image.colorspace_settings
    name = linear_space() if path.suffix.lower() == ".exr" else encoded_space()
    if is_data and not settings.is_data:
        settings.is_data = True
    elif not is_data and settings.name != name:
        settings.name = name


def read_texture(path: Path) -> np.ndarray:
    """(H, W, 3) values of an EXR texture, bottom row first."""
    image = bpy.data.images.load(str(path))
    try:
        image.colorspace_settings.is_data = True  # as they are in the file
        pixels = image_values(image)
    finally:
        bpy.data.images.remove(image)
    return pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)


def linear_values(image: bpy.types.Image) -> np.ndarray:
    """(H, W, channels) f32 scene-linear values of an image, bottom row first.

    Blender converts files of floats when it reads them, but leaves codes of 8 bits as they are.
    """
    values = image_values(image)
    if not image.is_float and image.colorspace_settings.name == encoded_space():
        values[..., :3] = to_scene_linear(decode_srgb(values[..., :3]))
    return values


def image_values(image: bpy.types.Image) -> np.ndarray:
    """(H, W, channels) f32 values of an image, bottom row first."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)


def save_values(values: np.ndarray, path: Path, most: int | None = None) -> None:
    """Save values (H, W, 3), bottom row first, as they are: as an EXR of floats or a PNG of 8 bits.

    Args:
        path: whose suffix is .exr or .png.
        most: width and height that a larger image is scaled down to, texels.
    """
    height, width, _ = values.shape
    is_exr = path.suffix == ".exr"
    # As data, since Blender 4.5 saves other new images of floats with sRGB's transfer function.
    image = bpy.data.images.new(path.stem, width, height, alpha=False, float_buffer=is_exr, is_data=True)
    try:
        pixels = np.ones((height, width, 4), np.float32)
        pixels[..., :3] = values
        image.pixels.foreach_set(pixels.ravel())
        shrink = min(1.0, (most or max(width, height)) / max(width, height))
        if shrink < 1.0:
            image.scale(max(1, round(width * shrink)), max(1, round(height * shrink)))
        image.filepath_raw, image.file_format = str(path), "OPEN_EXR" if is_exr else "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)


def remove_unused_images(images: Iterable[bpy.types.Image]) -> None:
    """Remove those images that nothing uses any more."""
    bpy.data.batch_remove([image for image in images if image.users == 0])
