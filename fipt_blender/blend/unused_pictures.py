# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of applied pictures that no known .blend file uses, which Clean Up removes; nothing else is.

A .blend file uses a folder if its bytes contain the folder's name, a digest of the pictures.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import IO, Any

import bpy

from ..core.run.errors import FiptError
from .texture_files import SET_NAME

_BLEND = re.compile(r"\.blend\d*@?$")  # with backups, and files that are being saved
_PIECE = 1 << 22  # bytes that are searched at once


def unused_pictures() -> tuple[list[Path], list[Path]]:
    """Picture folders of the open file and of its runs that no known .blend file uses.

    Known are the open file, those beside it and in its run folders with their backups, its libraries,
    Blender's list of recent files, and the files that Blender saves by itself.

    Returns:
        The folders, and the .blend files that can't be read: if there is one, it may use all of them.
    """
    runs = {Path(bpy.path.abspath(scene.fipt.run_folder)) for scene in bpy.data.scenes} - {Path()}
    blend = Path(bpy.data.filepath) if bpy.data.filepath else None
    stores = [run / "applied" for run in runs]
    if blend is not None:
        stores.append(blend.with_name(f"{blend.stem}_textures"))
    left = {folder.name for store in stores for folder in _sets(store)}
    for block in (*bpy.data.images, *bpy.data.libraries):
        left = {name for name in left if name not in block.filepath}
    unread = []
    for path in sorted(_known_files(blend, runs)) if left else ():
        try:
            left -= _named_in(path, left)
        except Exception:  # each format has its own errors of damaged files
            unread.append(path)
    unused = [folder for store in stores for folder in _sets(store) if folder.name in left]
    return [] if unread else unused, unread


def remove_pictures(folder: Path) -> None:
    """Remove a folder of `unused_pictures`.

    Raises:
        FiptError: ``run-unwritable``.
    """
    try:
        for file in list(folder.iterdir()):
            file.unlink()
        folder.rmdir()
    except OSError as error:
        text = f"{folder} can't be deleted ({error.strerror})."
        remedy = "Close programs that use it, or delete it yourself."
        raise FiptError("run-unwritable", text, remedy) from error


def _sets(store: Path) -> list[Path]:
    """Folders that `texture_files` has made; one that holds anything but pictures is not ours to remove."""
    if not store.is_dir() or store.is_symlink():
        return []
    folders = [path for path in store.iterdir() if SET_NAME.fullmatch(path.name) and not path.is_symlink()]
    return sorted(
        folder
        for folder in folders
        if folder.is_dir()
        and all(file.is_file() and file.suffix in (".exr", ".png") for file in folder.iterdir())
    )


def _known_files(blend: Path | None, runs: set[Path]) -> set[Path]:
    folders = {*runs, Path(bpy.app.tempdir).parent}  # where files are saved automatically
    folders.add(Path(bpy.utils.resource_path("USER"), "autosave"))
    files = {Path(bpy.path.abspath(library.filepath)) for library in bpy.data.libraries}
    recent = Path(bpy.utils.user_resource("CONFIG", path="recent-files.txt"))
    if recent.is_file():
        files |= {Path(line) for line in recent.read_text("utf-8", "replace").splitlines() if line}
    for path in (blend, *files):
        if path is not None:
            folders.add(path.parent)
    beside = {path for folder in folders if folder.is_dir() for path in folder.iterdir()}
    return {path for path in files | beside if _BLEND.search(path.name) and path.is_file()}


def _named_in(path: Path, names: set[str]) -> set[str]:
    """Which of some ASCII names the content of a .blend file contains.

    Raises:
        Exception: the file can't be read to its end.
    """
    found, before = set[str](), b""
    for piece in _content(path):
        text = before + piece
        found |= {name for name in names - found if name.encode() in text}
        before = text[-64:]
    if b"ENDB" not in before:
        raise ValueError(f"{path} does not end as a .blend file does")
    return found


def _content(path: Path) -> Iterator[bytes]:
    """The bytes of a .blend file, uncompressed, in pieces."""
    with open(path, "rb") as file:
        start = file.read(4)
        file.seek(0)
        stream: IO[bytes] | Any = file
        if start[:2] == b"\x1f\x8b":
            stream = gzip.open(file)
        elif start == b"\x28\xb5\x2f\xfd":
            stream = _zstd_reader(file)
        elif start != b"BLEN":
            raise ValueError(f"{path} is no .blend file")
        with closing(stream):
            while piece := stream.read(_PIECE):
                yield piece


def _zstd_reader(file: IO[bytes]) -> Any:
    import zstandard  # which Blender's own builds have

    return zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
