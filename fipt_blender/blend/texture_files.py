# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the textures of results are kept: beside the .blend file, packed into it, or in the run folder.

The run folder is usually in the user's data folder, which no other machine has.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import atomic_path
from .image_datablocks import load_texture, load_tiles, read_texture
from .png16 import encode_png, encode_srgb


@dataclass(frozen=True)
class TextureFiles:
    """Loads textures from a run folder and keeps them elsewhere.

    Attributes:
        folder: folder to which the files are copied; None leaves them in the run folder.
        pack: pack them into the .blend file.
        png: keep them as PNGs of 16 bits, which more programs read than EXR.
    """

    folder: Path | None = None
    pack: bool = False
    png: bool = False

    def copy(self, path: Path, is_data: bool | None = None) -> None:
        """Copy a file of the run folder to `folder`, if there is one, in the chosen format.

        Args:
            path: of the file.
            is_data: whether its values, 0 to 1, are not colours; None for radiance, which stays as it is.

        Raises:
            FiptError: ``textures-unwritable``.
        """
        target = self._kept(path, is_data)
        if target == path:
            return
        try:
            with atomic_path(target) as temporary:
                if target.suffix == path.suffix:
                    shutil.copyfile(path, temporary)
                else:
                    values = read_texture(path)
                    temporary.write_bytes(encode_png(values if is_data else encode_srgb(values)))
        except FiptError as error:
            raise FiptError(
                "textures-unwritable",
                f"The textures could not be copied beside the .blend file. {error.text}",
                "Free some space, save the file in a folder in which you may write, or choose"
                " 'In the File' as Textures in the section Materials.",
            ) from error

    def _kept(self, path: Path, is_data: bool | None) -> Path:
        """Where a file of the run folder is kept."""
        if self.png and is_data is not None:
            path = path.with_suffix(".png")
        return path if self.folder is None else self.folder / path.name

    def load(self, path: Path, is_data: bool | None) -> bpy.types.Image:
        """The image of a file of the run folder; `copy` comes first, with the same arguments."""
        path = self._kept(path, is_data)
        return self._placed(load_texture(path, bool(is_data)))

    def load_tiles(self, paths: Mapping[int, Path], is_data: bool) -> bpy.types.Image:
        """Files of the run folder, by their UDIM numbers, as one image; `copy` comes first."""
        kept = {number: self._kept(path, is_data) for number, path in paths.items()}
        return self._placed(load_tiles(kept, is_data))

    def _placed(self, image: bpy.types.Image) -> bpy.types.Image:
        if self.folder is not None:
            image.filepath = bpy.path.relpath(image.filepath)
        if self.pack:
            image.pack()
        return image


IN_RUN_FOLDER = TextureFiles()


def texture_files(scene: bpy.types.Scene) -> TextureFiles:
    """Where the textures of a scene are kept: as its settings say; packed while the file has no name."""
    keep, png = scene.fipt.materials.texture_files, scene.fipt.materials.texture_format == "PNG"
    if keep == "IN_RUN":
        return TextureFiles(png=png)
    if keep == "PACKED" or not bpy.data.filepath:
        return TextureFiles(pack=True, png=png)
    blend = Path(bpy.data.filepath)
    folder = blend.with_name(f"{blend.stem}_textures")
    # The textures of every run have the same names.
    runs = {other.fipt.run_folder for other in bpy.data.scenes if other.fipt.run_folder}
    folder = folder / Path(scene.fipt.run_folder).name if len(runs) > 1 else folder
    return TextureFiles(folder, png=png)
