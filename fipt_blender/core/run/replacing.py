# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of a run that are replaced when their new content is complete, never before.

Standard library only.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .runfolder import RunFolder, beside, explained_write_errors, recover_folder


def _delete(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def atomic_folder(folder: Path, discard: Callable[[Path], None] = _delete) -> Iterator[Path]:
    """A new folder beside `folder` that replaces it if the block ends without an exception.

    A kill between the two renamings at the end leaves the old folder, complete, under another name;
    `RunFolder.recover` brings it back.

    Args:
        folder: the path of both.
        discard: what becomes of the old folder; called again where a kill has interrupted it.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    new, old = beside(folder)
    with explained_write_errors(folder):
        recover_folder(folder)
        if old.exists():
            discard(old)
        _remove(new)
        new.mkdir(parents=True)
    try:
        yield new
        with explained_write_errors(folder):
            _remove(old)
            if folder.exists():
                os.rename(folder, old)
            os.rename(new, folder)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        with suppress(OSError):
            recover_folder(folder)
        raise
    if old.exists():
        with explained_write_errors(folder):
            discard(old)


def keep_inputs(run: RunFolder, folder: Path) -> None:
    """Keep in the folder of new results what they were made from.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    for path in run.made_from():
        if path.exists():
            with explained_write_errors(folder / path.name):
                link_or_copy(path, folder / path.name)


def link_folder(source: Path, target: Path, leave: Collection[str] = ()) -> None:
    """Give a folder all files of another one, as `link_or_copy`, except the entries `leave`."""
    target.mkdir(exist_ok=True)
    for entry in source.iterdir():
        if entry.name in leave:
            continue
        if entry.is_dir():
            shutil.copytree(entry, target / entry.name, copy_function=link_or_copy, dirs_exist_ok=True)
        else:
            link_or_copy(entry, target / entry.name)


def _remove(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)


def link_or_copy(source: str | Path, target: str | Path) -> None:
    """One file under two names where the disk can do that: no file of a run is ever written in place."""
    try:
        os.link(source, target)
    except FileExistsError:  # copying would write into a file that has other names
        raise
    except OSError:
        shutil.copy2(source, target)
