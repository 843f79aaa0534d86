"""The pictures of applied results: which are missing, bringing them to the .blend file, and a copy of the
open file with all that it needs, for another machine.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from .marks import TEXTURE
from .save import write_error
from .texture_files import IN_RUN, SET_NAME, copy_picture

UNSAVED = "room.blend"  # the copy's name where the open file has none


def missing_pictures() -> list[str]:
    """Names of the files that pictures of results in the open file name and that are not there."""
    return sorted({path.name for image in _outside() for path in image_files(image) if not path.is_file()})


def check_pictures() -> None:
    """Read the pictures of results before their pixels are used, also those that could not be read before."""
    images = _outside()
    for image in images:
        if not image.size[0]:  # Blender doesn't try again by itself
            image.reload()
    if missing := sorted({image_files(image)[0].name for image in images if not image.size[0]}):
        raise FiptError("file-missing.check-pictures", number_of_missing=len(missing), missing=missing[0])


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
    """Copy images' files to folders in NAME_textures beside a .blend file NAME; the images name them then."""
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
        place = str(folder / pattern)
        # Without a name of the file, Blender could not read relative ones; it makes them relative itself.
        image.filepath_raw = bpy.path.relpath(place) if bpy.data.filepath else place


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


def collect_room(folder: Path) -> tuple[Path, list[Path]]:
    """Save a copy of the open file into a folder, with the files of its images.

    The open file stays as it is, except that what was painted on images is packed into it.

    Args:
        folder: of the copy; where it has something in it, a new folder NAME_collected there.

    Returns:
        The copy, and other files that it needs, which stay where they are.
    """
    if missing := missing_pictures():
        raise FiptError("file-missing.check-pictures", number_of_missing=len(missing), missing=missing[0])
    blend = Path(bpy.data.filepath or UNSAVED)
    if folder.is_dir() and any(folder.iterdir()):
        folder = folder / f"{blend.stem}_collected"
    target = folder / blend.name
    if target.exists():
        raise FiptError("file-exists", target=target)
    images = [
        image for image in bpy.data.images if image.library is None and image.source in ("FILE", "TILED")
    ]
    for image in images:
        if image.is_dirty:  # what was painted is in no file yet
            image.pack()
    outside = [image for image in images if image.packed_file is None and image.filepath]
    outside = [image for image in outside if all(path.is_file() for path in image_files(image))]
    with ExitStack() as stack:
        for image in outside:
            stack.callback(setattr, image, "filepath_raw", image.filepath_raw)
        bring(outside, target)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(target), copy=True, check_existing=False, compress=True)
        except RuntimeError as error:
            raise write_error(target, error, "blend-unwritable") from None
        named = {Path(os.path.normpath(path)) for path in bpy.utils.blend_paths(absolute=True, packed=False)}
    return target, sorted(path for path in named if not path.is_relative_to(folder))
