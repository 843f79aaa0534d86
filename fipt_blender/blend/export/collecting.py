# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of the open file with all that it needs, for another machine."""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...core.run.errors import FiptError
from ..collecting import bring, image_files, missing_pictures
from ..save import write_error

UNSAVED = "room.blend"  # the copy's name where the open file has none


@dataclass(frozen=True)
class Collected:
    """A copy of the open file that another machine can open.

    Attributes:
        path: of the copy.
        left: other files that it needs, which stay where they are.
    """

    path: Path
    left: tuple[Path, ...]


def collect_room(folder: Path) -> Collected:
    """Save a copy of the open file into a folder, with the files of its images.

    The open file stays as it is, except that what was painted on images is packed into it.

    Args:
        folder: of the copy; where it has something in it, a new folder NAME_collected there.

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
            stack.callback(setattr, image, "filepath_raw", image.filepath_raw)
        bring(outside, target)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(target), copy=True, check_existing=False, compress=True)
        except RuntimeError as error:
            raise write_error(target, error, "blend-unwritable") from None
        named = {Path(os.path.normpath(path)) for path in bpy.utils.blend_paths(absolute=True, packed=False)}
    return Collected(target, tuple(sorted(path for path in named if not path.is_relative_to(folder))))
