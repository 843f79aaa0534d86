"""The content of the data folder: listing and deleting runs and environments, and nothing else.

Standard library only. Deleting is a generator that yields between folders, so that windows stay responsive.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..core.run.contents import RunNote
from ..core.run.documents import load_document
from ..core.run.errors import FiptError
from ..core.run.kinds import HeadError
from ..core.run.lock import holder
from ..core.run.runfolder import RunFolder
from .pins import environments, managed_environments
from .places import runs_folder

RUN, ENVIRONMENT = "run", "environment"


@dataclass(frozen=True)
class Item:
    """A folder that the add-on has made.

    Attributes:
        kind: `RUN` or `ENVIRONMENT`.
        folder: its path.
        modified: time of the last change at its top level (seconds since 1970).
        current: whether it is an environment that this version of the add-on uses.
    """

    kind: str
    folder: Path
    modified: float
    current: bool = False


def list_items(data: Path) -> list[Item]:
    """Runs, newest first, then environments; other folders are not listed."""
    runs = [path for path in _children(runs_folder(data)) if is_run(path)]
    items = [Item(RUN, path, _modified(path)) for path in runs]
    items.sort(key=lambda item: -item.modified)
    used = set(managed_environments(data))
    for path in environments(data):
        items.append(Item(ENVIRONMENT, path, _modified(path), path in used))
    return items


def is_run(folder: Path) -> bool:
    """Whether a folder is a run: it contains our run.json or, if it was made for a run, is still empty."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    try:
        load_document(folder / "run.json", RunNote)
    except FileNotFoundError:
        return not any(folder.iterdir())
    except (OSError, ValueError) as error:
        return isinstance(error, HeadError) and error.field == "version"
    return True


def why_in_use(item: Item, used: Sequence[Path]) -> str:
    """Why a folder must be kept; "" if it may be deleted.

    Args:
        item: the folder.
        used: folders and files that the open .blend file or a job of this Blender needs.
    """
    if any(path == item.folder or path.is_relative_to(item.folder) for path in used):
        return "used by the open file"
    if item.kind == RUN and holder(RunFolder(item.folder)) is not None:
        return "an engine is working in it"
    # A run that was changed so recently may belong to a job, which holds no lock between engine commands.
    if item.kind == RUN and time.time() - item.modified < 120.0:
        return "changed just now"
    return ""


def size(folder: Path) -> int:
    """The size of a folder in bytes; what disappears meanwhile does not count."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += os.lstat(os.path.join(parent, name)).st_size
    return total


def delete(item: Item, data: Path, used: Sequence[Path]) -> Iterator[None]:
    """Delete a run or an environment; a generator that yields between folders.

    The file by which the folder is recognised (run.json or setup.json) is deleted last, so that an
    interrupted deletion can be continued.

    Raises:
        FiptError: ``run-foreign`` if the folder was not made by the add-on or is elsewhere, ``run-busy`` if
            it is in use, ``run-unwritable`` if something can't be deleted.
    """
    known = {existing.folder: existing for existing in list_items(data)}
    if item.folder not in known:
        raise FiptError("run-foreign.delete", folder=item.folder)
    if reason := why_in_use(known[item.folder], used):
        raise FiptError("run-busy.delete", folder=item.folder, reason=reason)
    yield from delete_folder(item.folder)


def delete_folder(folder: Path) -> Iterator[None]:
    """Delete a run's or an environment's folder, as `delete` does, wherever it is and without its checks.

    Raises:
        FiptError: ``run-unwritable``.
    """
    last = ("run.json", "setup.json")
    try:
        for child in sorted(folder.iterdir(), key=lambda path: path.name in last):
            if child.is_dir() and not child.is_symlink():
                for parent, _, names in os.walk(child, topdown=False):
                    for name in names:
                        os.unlink(os.path.join(parent, name))
                    yield
                shutil.rmtree(child)
            else:
                child.unlink()
        folder.rmdir()
    except OSError as error:
        raise FiptError(
            "run-unwritable.delete-folder", filename=error.filename or folder, strerror=error.strerror
        ) from error


def _children(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _modified(folder: Path) -> float:
    newest = 0.0
    for path in (folder, *_children(folder), folder / "stage", folder / "log.txt"):
        with suppress(OSError):
            newest = max(newest, path.stat().st_mtime)
    return newest
