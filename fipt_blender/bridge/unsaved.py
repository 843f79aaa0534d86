# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of which no .blend file knows: a mark beside the folder, removed by saving. Standard library only."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.run.documents import optional_document
from ..core.run.process_identity import host_name, process_start
from ..core.run.runfolder import RunFolder, write_json
from .places import runs_folder
from .storage import RUN, list_items, measure, why_in_use

SUFFIX = ".unsaved"  # of the mark, a file beside the run's folder, which must be empty at first


@dataclass(frozen=True)
class Unsaved:
    """A run that only a Blender knew that has ended.

    Attributes:
        folder: of the run, which has a capture.
        modified: seconds since the epoch.
        size: bytes.
    """

    folder: Path
    modified: float
    size: int


@dataclass(frozen=True)
class _Mark:
    """The process of a Blender, its machine and its start."""

    pid: int
    host: str
    started: str


def mark(folder: Path) -> None:
    """Note that only this process knows of a run.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    pid = os.getpid()
    write_json(mark_of(folder), _Mark(pid, host_name(), process_start(pid)))


def unmark(folder: Path) -> None:
    """Note that a .blend file knows of a run."""
    mark_of(folder).unlink(missing_ok=True)


def mark_of(folder: Path) -> Path:
    """The file that marks a run."""
    return folder.with_name(f"{folder.name}{SUFFIX}")


def newest(data: Path, used: Sequence[Path]) -> Unsaved | None:
    """The newest run of which neither a .blend file nor a Blender knows.

    Args:
        data: the data folder.
        used: paths that the open file needs.
    """
    for path in runs_folder(data).glob(f"*{SUFFIX}"):
        if not path.with_name(path.name.removesuffix(SUFFIX)).exists():
            path.unlink(missing_ok=True)  # of a run that was deleted
    for item in list_items(data):
        path = mark_of(item.folder)
        if item.kind != RUN or not path.is_file() or not RunFolder(item.folder).ingest_json.is_file():
            continue
        if why_in_use(item, used) or _is_alive(path):
            continue
        return Unsaved(item.folder, item.modified, max(measure(item.folder), default=0))
    return None


def _is_alive(path: Path) -> bool:
    """Whether the Blender that has written a mark may still be running."""
    blender = optional_document(path, _Mark)
    if blender is None or blender.host != host_name() or not blender.started:
        return False
    return process_start(blender.pid) == blender.started
