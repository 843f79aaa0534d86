"""Where the textures of results are kept: beside the .blend file; in the run folder until it has a name.

Each set of pictures has a folder of its own, whose name is a digest of their content. No later set is written
over it, so that a .blend file shows the results that it was saved with, and so do Undo and Revert. The run
folder is usually in the user's data folder, which no other machine has.
"""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder, atomic_path
from .image_datablocks import load_texture, read_texture
from .marks import TEXTURE
from .png16 import encode_png, encode_srgb

_DIGITS = 12  # of a set's digest: two of a thousand sets have the same one with a probability below 1e-8
IN_RUN = "applied"  # a run's folder of sets
SET_NAME = re.compile(rf"[0-9a-f]{{{_DIGITS}}}")


@contextmanager
def written_picture(target: Path) -> Iterator[Path]:
    """Where a picture of results is written; it gets to its place whole."""
    try:
        with atomic_path(target) as temporary:
            yield temporary
    except (RuntimeError, FiptError) as error:
        raise FiptError("textures-unwritable", parent=target.parent, error=error) from error


def copy_picture(path: Path, target: Path) -> None:
    """Copy a file; one that is there already stays."""
    if not target.is_file():
        with written_picture(target) as temporary:
            shutil.copyfile(path, temporary)


@dataclass(frozen=True)
class TextureFiles:
    """Loads textures of a run from the folder in which they are kept.

    Attributes:
        folder: of this set of textures alone.
        png: keep them as PNGs of 16 bits, which more programs read than EXR.
        relative: the .blend file names them relative to itself.
    """

    folder: Path
    png: bool = False
    relative: bool = False

    def copy(self, path: Path, is_data: bool | None = None) -> None:
        """Bring a file of the run folder to `folder` in the chosen format; one that is there already stays.

        Args:
            path: of the file.
            is_data: whether its values, 0 to 1, are not colours; None for radiance, which stays as it is.
        """
        target = self._kept(path, is_data)
        if target.suffix == path.suffix:
            copy_picture(path, target)
        elif not target.is_file():
            with written_picture(target) as temporary:
                values = read_texture(path)
                temporary.write_bytes(encode_png(values if is_data else encode_srgb(values)))

    def _kept(self, path: Path, is_data: bool | None) -> Path:
        """Where a file of the run folder is kept."""
        name = Path(path.name)
        return self.folder / (name.with_suffix(".png") if self.png and is_data is not None else name)

    def load(self, path: Path, is_data: bool | None) -> bpy.types.Image:
        """The image of a file of the run folder; `copy` comes first, with the same arguments."""
        image = load_texture(self._kept(path, is_data), bool(is_data))
        path = bpy.path.relpath(image.filepath) if self.relative else image.filepath
        if image.filepath != path:  # setting it reads the file anew, without what the artist has painted
            image.filepath = path
        image[TEXTURE] = True
        return image


def in_run_folder(run: RunFolder, png: bool = False) -> TextureFiles:
    """The present textures of a run, kept in its folder."""
    return TextureFiles(run.root / IN_RUN / content_name(run), png)


def content_name(run: RunFolder) -> str:
    """A name for the present textures and environment of a run, which others do not have."""
    digest = hashlib.blake2b(digest_size=_DIGITS // 2)
    pictures = sorted(run.textures.glob("*.exr")) if run.textures.is_dir() else []
    for path in (*pictures, run.environment_exr):
        if path.is_file():
            digest.update(path.name.encode())
            with open(path, "rb") as file:
                digest.update(hashlib.file_digest(file, "blake2b").digest())
    return digest.hexdigest()


def texture_files(scene: bpy.types.Scene, run: RunFolder, name: str = "") -> TextureFiles:
    """Where the textures of a scene are kept: beside the file; in the run folder while it has no name.

    Args:
        scene, run: whose textures.
        name: of a set that is no run's, a digest of its content; its files are EXRs.
    """
    png = scene.fipt.materials.texture_format == "PNG" and not name
    name = name or content_name(run)
    if not bpy.data.filepath:
        return TextureFiles(run.root / IN_RUN / name, png)
    blend = Path(bpy.data.filepath)
    return TextureFiles(blend.with_name(f"{blend.stem}_textures") / name, png, True)
