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
from ..collecting import bring, copy_picture, image_files, missing_pictures
from ..save import write_error
from .exporting import SUFFIXES

UNSAVED = "room.blend"  # the copy's name where the open file has none


@dataclass(frozen=True)
class Collected:
    """A copy of the open file that another machine can open.

    Attributes:
        path: of the copy.
        exports: files of exports beside it.
        left: other files that it needs, which stay where they are.
    """

    path: Path
    exports: tuple[Path, ...]
    left: tuple[Path, ...]


def collect_room(folder: Path, pack: bool) -> Collected:
    """Save a copy of the open file into a folder, with the files of its images and its exports.

    The open file stays as it is, except that what was painted on images is packed into it.

    Args:
        folder: of the copy; where it has something in it, a new folder NAME_collected there.
        pack: pack the images into the copy; exports then stay where they are.

    Raises:
        FiptError: ``file-missing``, ``file-exists``, ``textures-unwritable``, or what
            `save.write_error` returns.
    """
    if missing := missing_pictures():
        text = f"{len(missing)} pictures are missing, the first is {missing[0]}."
        raise FiptError("file-missing", text, "Use Find Missing Files, or apply the results again.")
    blend = Path(bpy.data.filepath or UNSAVED)
    if folder.is_dir() and any(folder.iterdir()):
        folder = folder / f"{blend.stem}_collected"
    target = folder / blend.name
    if target.exists():
        raise FiptError("file-exists", f"{target} exists.", "Choose another folder.")
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
            if pack:
                image.pack()
                stack.callback(image.unpack, method="REMOVE")
            else:
                stack.callback(setattr, image, "filepath_raw", image.filepath_raw)
        bring([] if pack else outside, target)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(target), copy=True, check_existing=False, compress=True)
        except RuntimeError as error:
            raise write_error(target, error, "blend-unwritable") from None
        named = {Path(os.path.normpath(path)) for path in bpy.utils.blend_paths(absolute=True, packed=False)}
    exports = () if pack or not bpy.data.filepath else _exports(blend)
    for path in exports:
        copy_picture(path, folder / path.relative_to(blend.parent))
    return Collected(
        target, exports, tuple(sorted(path for path in named if not path.is_relative_to(folder)))
    )


def _exports(blend: Path) -> tuple[Path, ...]:
    """Files of exports that lie beside a .blend file under its name, with those that they need."""
    exports = [blend.with_suffix(suffix) for suffix in SUFFIXES if blend.with_suffix(suffix).is_file()]
    found = set(exports)
    for path in exports:
        if path.suffix == ".gltf":
            document = json.loads(path.read_text("utf-8"))
            files = [*document.get("buffers", ()), *document.get("images", ())]
            found |= {blend.with_name(Path(file["uri"]).name) for file in files if "uri" in file}
        elif path.suffix in (".usd", ".usda", ".usdc"):
            found |= set(blend.with_name("textures").glob("*"))
    return tuple(sorted(path for path in found if path.is_file()))
