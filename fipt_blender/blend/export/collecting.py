# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of the open file with all that it needs, for another machine."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...core.run.errors import FiptError
from ..collecting import copy_picture, image_files, missing_pictures
from ..marks import all_view_cameras
from ..save import write_error
from .exporting import SUFFIXES


@dataclass(frozen=True)
class Collected:
    """A copy of the open file that another machine can open.

    Attributes:
        path: of the copy.
        images: number of images that came along.
        exports: names of the files of exports that came along.
        left: other files that the copy needs, which stay where they are.
    """

    path: Path
    images: int
    exports: tuple[str, ...]
    left: tuple[str, ...]


def collect_room(folder: Path, pack: bool, photographs: bool = True) -> Collected:
    """Save a copy of the open file into a folder, with the files of its images and its exports.

    The open file stays as it is, except that what was painted on images is packed into it.

    Args:
        folder: of the copy.
        pack: pack the images into the copy; exports then stay where they are.
        photographs: bring the photographs of views, too.

    Raises:
        FiptError: ``file-unsaved``, ``file-missing``, ``file-exists``, ``textures-unwritable``, or what
            `save.write_error` returns.
    """
    if not bpy.data.filepath:
        raise FiptError("file-unsaved", "The file has no name yet.", "Save it first.")
    if missing := missing_pictures():
        text = f"{len(missing)} pictures are missing, the first is {missing[0]}."
        raise FiptError("file-missing", text, "Use Find Missing Files, or apply the results again.")
    blend, target = Path(bpy.data.filepath), folder / Path(bpy.data.filepath).name
    if target.exists():
        raise FiptError("file-exists", f"{target} exists.", "Choose an empty folder.")
    shown = {picture.image for camera in _views() for picture in camera.data.background_images}
    images = [
        image
        for image in bpy.data.images
        if image.library is None and image.source in ("FILE", "TILED")
        if photographs or image not in shown
    ]
    for image in images:
        if image.is_dirty:  # what was painted is in no file yet
            image.pack()
    outside = [image for image in images if image.packed_file is None and image.filepath]
    outside = [image for image in outside if all(path.is_file() for path in image_files(image))]
    with ExitStack() as stack:
        names: dict[Path, str] = {}
        for image in outside:
            files, raw = image_files(image), image.filepath_raw
            if pack:
                image.pack()
                stack.callback(image.unpack, method="REMOVE")
                continue
            name = names.setdefault(files[0].parent, _free_name(files[0].parent.name, names))
            place = folder / f"{blend.stem}_textures" / name
            for path in files:
                copy_picture(path, place / path.name)
            image.filepath_raw = bpy.path.relpath(str(place / Path(raw.replace("\\", "/")).name))
            stack.callback(setattr, image, "filepath_raw", raw)
        _save_copy(target)
        left = _left(None if pack else folder)
    exports = () if pack else _exports(blend)
    for path in exports:
        copy_picture(path, folder / path.relative_to(blend.parent))
    return Collected(target, len(images), tuple(path.name for path in exports), left)


def _views() -> list[bpy.types.Object]:
    return [camera for scene in bpy.data.scenes for camera in all_view_cameras(scene)]


def _free_name(name: str, taken: dict[Path, str]) -> str:
    """A folder's name, numbered where another folder has it, in whatever case."""
    used, number = {each.lower() for each in taken.values()}, 2
    found = name
    while found.lower() in used:
        found, number = f"{name}_{number}", number + 1
    return found


def _save_copy(target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(target), copy=True, check_existing=False, compress=True)
    except RuntimeError as error:
        raise write_error(target, error, "blend-unwritable") from None


def _left(folder: Path | None) -> tuple[str, ...]:
    """Files outside of a folder that the open file names."""
    paths = (Path(os.path.normpath(path)) for path in bpy.utils.blend_paths(absolute=True, packed=False))
    return tuple(sorted({str(path) for path in paths if folder is None or not path.is_relative_to(folder)}))


def _exports(blend: Path) -> tuple[Path, ...]:
    """Files of exports that lie beside a .blend file under its name, with those that they need."""
    exports = {path for path in (blend.with_suffix(suffix) for suffix in SUFFIXES) if path.is_file()}
    found = set(exports)
    for path in exports:
        if path.suffix == ".gltf":
            document = json.loads(path.read_text("utf-8"))
            files = [*document.get("buffers", ()), *document.get("images", ())]
            found |= {blend.with_name(Path(file["uri"]).name) for file in files if "uri" in file}
        elif path.suffix in (".usd", ".usda", ".usdc"):
            found |= set(blend.with_name("textures").glob("*"))
    return tuple(sorted(path for path in found if path.is_file()))
