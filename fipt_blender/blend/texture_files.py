# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the textures of results are kept: beside the .blend file, packed into it, or in the run folder.

The run folder is usually in the user's data folder, which no other machine has.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import atomic_path
from .image_datablocks import load_texture


@dataclass(frozen=True)
class TextureFiles:
    """Loads textures from a run folder and keeps them elsewhere.

    Attributes:
        folder: folder to which the files are copied; None leaves them in the run folder.
        pack: pack them into the .blend file.
    """

    folder: Path | None = None
    pack: bool = False

    def copy(self, path: Path) -> None:
        """Copy a file of the run folder to `folder`, if there is one.

        Raises:
            FiptError: ``textures-unwritable``.
        """
        if self.folder is None:
            return
        target = self.folder / path.name
        try:
            with atomic_path(target) as temporary:
                shutil.copyfile(path, temporary)
        except FiptError as error:
            raise FiptError(
                "textures-unwritable",
                f"The textures could not be copied beside the .blend file. {error.text}",
                "Free some space, save the file in a folder in which you may write, or choose"
                " 'In the File' as Textures in the section Materials.",
            ) from error

    def load(self, path: Path, is_data: bool) -> bpy.types.Image:
        """The image of a file of the run folder; `copy` comes first."""
        if self.folder is not None:
            path = self.folder / path.name
        image = load_texture(path, is_data)
        if self.folder is not None:
            image.filepath = bpy.path.relpath(str(path))
        if self.pack:
            image.pack()
        return image


IN_RUN_FOLDER = TextureFiles()


def texture_files(scene: bpy.types.Scene) -> TextureFiles:
    """Where the textures of a scene are kept: as its settings say; packed while the file has no name."""
    keep = scene.fipt.materials.texture_files
    if keep == "IN_RUN":
        return IN_RUN_FOLDER
    if keep == "PACKED" or not bpy.data.filepath:
        return TextureFiles(pack=True)
    blend = Path(bpy.data.filepath)
    folder = blend.with_name(f"{blend.stem}_textures")
    # The textures of every run have the same names.
    runs = {other.fipt.run_folder for other in bpy.data.scenes if other.fipt.run_folder}
    return TextureFiles(folder / Path(scene.fipt.run_folder).name if len(runs) > 1 else folder)
