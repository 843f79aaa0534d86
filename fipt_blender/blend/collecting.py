# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of applied results: which are missing, and bringing them to the .blend file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import atomic_path
from .marks import TEXTURE
from .texture_files import IN_RUN, SET_NAME


def missing_pictures() -> list[str]:
    """Names of the files that pictures of results in the open file name and that are not there."""
    return sorted({path.name for image in _outside() for path in image_files(image) if not path.is_file()})


def pictures_in_runs(folder: Path) -> list[bpy.types.Image]:
    """The pictures of results that lie in run folders other than `folder`, where a .blend file is saved."""
    found = []
    for image in _outside():
        files = image_files(image)
        store = files[0].parent
        in_run = store.parent.name == IN_RUN and SET_NAME.fullmatch(store.name)
        if in_run and store.parent.parent != folder and all(path.is_file() for path in files):
            found.append(image)
    return found


def bring(images: Iterable[bpy.types.Image], blend: Path) -> None:
    """Copy images' files to folders in NAME_textures beside a .blend file NAME, and let the images name them.

    Raises:
        FiptError: ``textures-unwritable``.
    """
    folders: dict[Path, str] = {}
    start = None if bpy.data.filepath else str(blend.parent)
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
        image.filepath_raw = bpy.path.relpath(str(folder / pattern), start=start)


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
