# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of applied results: which are missing or elsewhere, and bringing them to the .blend file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import atomic_path
from .marks import TEXTURE
from .texture_files import SET_NAME


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
    check_pictures(needs_name=not pack)
    images = _outside()
    for image in images:
        if pack or image.is_dirty:  # what was painted is in no file yet
            image.pack()
    bring(_outside(), Path(bpy.data.filepath))
    return len(images)


def check_pictures(needs_name: bool = True) -> None:
    """Check that the open file has a name, and its pictures.

    Raises:
        FiptError: ``file-unsaved`` or ``file-missing``.
    """
    if needs_name and not bpy.data.filepath:
        raise FiptError("file-unsaved", "The file has no name yet.", "Save it first.")
    if missing := missing_pictures():
        text = f"{len(missing)} pictures are missing, the first is {missing[0]}."
        raise FiptError("file-missing", text, "Use Find Missing Files, or apply the results again.")


def bring(images: Iterable[bpy.types.Image], blend: Path) -> None:
    """Copy images' files to folders in NAME_textures beside a .blend file NAME, and let the images name them.

    Raises:
        FiptError: ``textures-unwritable``.
    """
    folders: dict[Path, str] = {}
    for image in images:
        files = image_files(image)
        source = files[0].parent
        # A set of results has a name that no other one has; other folders are numbered.
        name = source.name if SET_NAME.fullmatch(source.name) else f"{len(folders) + 1}-{source.name}"
        name = folders.setdefault(source, name)
        folder = blend.with_name(f"{blend.stem}_textures") / name
        for path in files:
            copy_picture(path, folder / path.name)
        pattern = image.filepath_raw.replace("\\", "/").rpartition("/")[2]
        image.filepath_raw = bpy.path.relpath(str(folder / pattern))


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
