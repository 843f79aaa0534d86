# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of applied results: which are missing or elsewhere, and bringing them to the .blend file."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import atomic_path
from .marks import TEXTURE


def missing_pictures() -> list[str]:
    """Names of the files that pictures of results in the open file name and that are not there."""
    return sorted({path.name for image in _outside() for path in image_files(image) if not path.is_file()})


def pictures_elsewhere() -> int:
    """How many pictures of results lie outside of the folder of the open file, and outside of the file.

    Those in a run folder are meant to.
    """
    if not bpy.data.filepath or not _beside():
        return 0
    folder = Path(bpy.data.filepath).parent
    return sum(not path.is_relative_to(folder) for image in _outside() for path in image_files(image)[:1])


def collect_pictures(pack: bool) -> int:
    """Copy the pictures of results beside the open file, or pack them into it; the file is then complete.

    Args:
        pack: pack them.

    Returns:
        How many pictures.

    Raises:
        FiptError: ``file-unsaved``, ``file-missing`` or ``textures-unwritable``.
    """
    if not pack and not bpy.data.filepath:
        raise FiptError("file-unsaved", "The file has no name yet.", "Save it first.")
    missing = missing_pictures()
    if missing:
        text = f"{len(missing)} pictures are missing, the first is {missing[0]}."
        raise FiptError("file-missing", text, "Use Find Missing Files, or apply the results again.")
    blend = Path(bpy.data.filepath)
    images = _outside()
    for image in images:
        if pack or image.is_dirty:  # what was painted is in no file yet
            image.pack()
            continue
        files = image_files(image)
        folder = blend.with_name(f"{blend.stem}_textures") / files[0].parent.name
        for path in files:
            copy_picture(path, folder / path.name)
        name = files[0].name if image.source != "TILED" else Path(image.filepath).name
        image.filepath = bpy.path.relpath(str(folder / name))
    return len(images)


def _outside() -> list[bpy.types.Image]:
    """The pictures of results that are not packed into the file."""
    images = (image for image in bpy.data.images if TEXTURE in image and image.library is None)
    return [image for image in images if image.packed_file is None]


def image_files(image: bpy.types.Image) -> list[Path]:
    """The files of an image: one for each tile."""
    path = Path(os.path.normpath(bpy.path.abspath(image.filepath)))
    if image.source != "TILED":
        return [path]
    return [path.with_name(path.name.replace("<UDIM>", str(tile.number))) for tile in image.tiles]


def _beside() -> bool:
    settings = bpy.context.scene.fipt.materials
    return str(settings.texture_files) == "BESIDE"


def copy_picture(path: Path, target: Path) -> None:
    """Copy a file; one that is there already stays.

    Raises:
        FiptError: ``textures-unwritable``.
    """
    if target.is_file():
        return
    try:
        with atomic_path(target) as temporary:
            shutil.copyfile(path, temporary)
    except FiptError as error:
        raise FiptError(
            "textures-unwritable",
            f"The pictures could not be copied beside the .blend file. {error.text}",
            "Free some space, or save the file in a folder in which you may write.",
        ) from error
