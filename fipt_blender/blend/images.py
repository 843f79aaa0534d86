# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Image files as Blender images with the colour space that belongs to their content."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import bpy

LINEAR = "Linear Rec.709"


def load_radiance(path: Path) -> bpy.types.Image | None:
    """A scene-linear colour image; None where the file is missing, since a picture is only for looking at."""
    if not path.is_file():
        return None
    image = bpy.data.images.load(str(path), check_existing=True)
    image.colorspace_settings.name = LINEAR
    return image


def load_data(path: Path) -> bpy.types.Image:
    """An image whose values are no colours (roughness, metallic, confidence)."""
    image = bpy.data.images.load(str(path), check_existing=True)
    image.colorspace_settings.is_data = True
    return image


def load_texture(path: Path, is_data: bool) -> bpy.types.Image:
    """A texture of a run; read anew, since an earlier bake may have had the same name."""
    image = load_data(path) if is_data else bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    # Reloading forgets the colour space in some versions.
    if is_data:
        image.colorspace_settings.is_data = True
    else:
        image.colorspace_settings.name = LINEAR
    return image


def remove_unused_images(images: Iterable[bpy.types.Image]) -> None:
    """Remove those images that nothing uses any more."""
    bpy.data.batch_remove([image for image in images if image.users == 0])
