# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies in the data folder, how large it is, and how it is cleared without taking what is not ours.

Standard library only. Sizes and deletions are generators that yield between files, so that no window waits.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.job.errors import FiptError
from ..core.job.lock import holder
from ..core.job.runfolder import RUN_FORMAT, RunFolder
from .pins import environments, managed_environments
from .places import runs_folder

RUN, ENVIRONMENT = "run", "environment"
_RECENT_SECONDS = 120.0  # a job between two engine commands holds no lock


@dataclass(frozen=True)
class Item:
    """One folder of ours.

    Attributes:
        kind: `RUN` or `ENVIRONMENT`.
        folder: where it lies.
        modified: when something last changed at its top (seconds since 1970).
        current: an environment that this version of the add-on uses.
    """

    kind: str
    folder: Path
    modified: float
    current: bool = False


def list_items(data: Path) -> list[Item]:
    """Runs, newest first, then environments; folders that are neither are passed over."""
    runs = [path for path in _children(runs_folder(data)) if is_run(path)]
    items = [Item(RUN, path, _modified(path)) for path in runs]
    items.sort(key=lambda item: -item.modified)
    used = set(managed_environments(data))
    for path in environments(data):
        items.append(Item(ENVIRONMENT, path, _modified(path), path in used))
    return items


def is_run(folder: Path) -> bool:
    """Whether a folder is a run's: one with our run.json, or one made for a run and still empty."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    try:
        data = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return not any(folder.iterdir())
    except (OSError, ValueError):
        return False
    return isinstance(data, dict) and data.get("format") == RUN_FORMAT


def why_in_use(item: Item, used: Sequence[Path]) -> str:
    """Why a folder must stay, "" where it may go.

    Args:
        item: the folder.
        used: folders and files that the open .blend or a job of this Blender needs.
    """
    if any(path == item.folder or path.is_relative_to(item.folder) for path in used):
        return "used by the open file"
    if item.kind == RUN and holder(RunFolder(item.folder)) is not None:
        return "an engine works in it"
    if item.kind == RUN and time.time() - item.modified < _RECENT_SECONDS:
        return "changed just now"
    return ""


def measure(folder: Path) -> Iterator[int]:
    """The bytes that a folder takes, as far as they are counted, after each folder in it."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(os.path.join(parent, name)).st_size
            except OSError:  # it may go while we look
                pass
        yield total


def delete(item: Item, data: Path, used: Sequence[Path]) -> Iterator[None]:
    """Delete a run or an environment, yielding now and then; its run.json goes last.

    So a deletion that is broken off leaves something that is still known as ours.

    Raises:
        FiptError: ``run-foreign`` where the folder is not ours or lies elsewhere, ``run-busy`` where it is in
            use, ``run-unwritable`` where something can't be deleted.
    """
    known = {each.folder: each for each in list_items(data)}
    if item.folder not in known:
        raise FiptError(
            "run-foreign",
            f"{item.folder} is no run and no environment of this add-on.",
            "Delete it yourself if you want it gone.",
        )
    if reason := why_in_use(known[item.folder], used):
        raise FiptError("run-busy", f"{item.folder} is kept: {reason}.", "Try again later.")
    for child in sorted(item.folder.iterdir(), key=lambda path: path.name in ("run.json", "setup.json")):
        try:
            if child.is_dir() and not child.is_symlink():
                yield from _delete_tree(child)
            else:
                child.unlink()
        except OSError as error:
            raise _undeletable(child, error) from error
        yield
    try:
        item.folder.rmdir()
    except OSError as error:
        raise _undeletable(item.folder, error) from error


def _delete_tree(folder: Path) -> Iterator[None]:
    for parent, folders, names in os.walk(folder, topdown=False):
        for name in names:
            os.unlink(os.path.join(parent, name))
        for name in folders:
            path = os.path.join(parent, name)
            if os.path.islink(path):
                os.unlink(path)
            else:
                os.rmdir(path)
        yield
    shutil.rmtree(folder)


def _undeletable(path: Path, error: OSError) -> FiptError:
    return FiptError(
        "run-unwritable",
        f"{path} can't be deleted ({error.strerror}).",
        "Close what uses it, or delete it yourself.",
    )


def _children(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _modified(folder: Path) -> float:
    newest = 0.0
    for path in (folder, *_children(folder), folder / "stage", folder / "log.txt"):
        try:
            newest = max(newest, path.stat().st_mtime)
        except OSError:
            pass
    return newest
