# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Image files as Blender images, with the colour space of their content, and images as arrays."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import bpy
import numpy as np

from ..core.run.errors import FiptError
from .color_spaces import encoded_space, linear_space, to_scene_linear
from .png16 import decode_srgb

MOST_PATH_BYTES = 1023


def check_length(path: Path) -> None:
    """Refuse a path that is longer than Blender's.

    Raises:
        FiptError: ``path-long``.
    """
    if len(os.fsencode(path)) > MOST_PATH_BYTES:
        raise FiptError(
            "path-long",
            f"The path {str(path)[:80]}... has {len(str(path))} letters; Blender takes {MOST_PATH_BYTES}.",
            "Move the file to a folder with a shorter path.",
        )


def load_radiance(path: Path) -> bpy.types.Image | None:
    """A scene-linear image, or one of sRGB's codes, displayed as renders are; None where the file is missing.

    Raises:
        FiptError: ``path-long`` or ``color-space-missing``.
    """
    if not path.is_file():
        return None
    check_length(path)
    image = bpy.data.images.load(str(path), check_existing=True)
    _set_color_space(image, path, False)
    image.use_view_as_render = True  # the scene's view transform and exposure
    return image


def load_texture(path: Path, is_data: bool) -> bpy.types.Image:
    """A texture of a run. One that is in the file stays, since no other content has its path."""
    image = bpy.data.images.load(str(path), check_existing=True)
    if not (image.has_data or image.packed_file):  # the file may have been missing
        image.reload()
    _set_color_space(image, path, is_data)
    return image


def load_tiles(paths: Mapping[int, Path], is_data: bool) -> bpy.types.Image:
    """Textures of a run as the tiles of a new image.

    Args:
        paths: by UDIM number, the first one included; their names differ by the number alone.
        is_data: whether the values are not colours.
    """
    first = min(paths)
    path = paths[first]
    image = bpy.data.images.load(str(path))
    image.source = "TILED"
    image.filepath = str(path.with_name(tile_pattern(path.name, first)))
    for number in sorted(set(paths) - {first}):
        image.tiles.new(number)
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


def tile_pattern(name: str, number: int) -> str:
    """The name of a tile's file with Blender's token in place of its number."""
    return name.replace(f".{number}.", ".<UDIM>.", 1)


def tile_values(image: bpy.types.Image, number: int) -> np.ndarray:
    """(H, W, channels) f32 values of a tile, or of an image without tiles, bottom row first.

    Raises:
        FiptError: ``file-missing``.
    """
    if image.source != "TILED":
        return image_values(image)
    name = f".{number}."
    packed = next((each for each in image.packed_files if name in Path(each.filepath).name), None)
    with tempfile.TemporaryDirectory(prefix="fipt_tile_") as folder:
        path = Path(bpy.path.abspath(image.filepath).replace("<UDIM>", str(number)))
        if packed is not None:
            path = Path(folder) / path.name
            path.write_bytes(packed.packed_file.data)
        if not path.is_file():
            raise FiptError("file-missing", f"The texture {path} does not exist.", "Apply the results again.")
        tile = bpy.data.images.load(str(path))
        try:
            tile.colorspace_settings.name = image.colorspace_settings.name
            return image_values(tile)
        finally:
            bpy.data.images.remove(tile)


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


def remove_unused_images(images: Iterable[bpy.types.Image]) -> None:
    """Remove those images that nothing uses any more."""
    bpy.data.batch_remove([image for image in images if image.users == 0])
