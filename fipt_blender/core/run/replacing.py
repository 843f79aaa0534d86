# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of a run that are replaced when their new content is complete, never before.

Standard library only.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .runfolder import RunFolder, beside, explained_write_errors, recover_folder


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """A new folder beside `folder` that replaces it if the block ends without an exception.

    A kill between the two renamings at the end leaves the old folder, complete, under another name;
    `RunFolder.recover` brings it back.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    new, old = beside(folder)
    with explained_write_errors(folder):
        recover_folder(folder)
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
    shutil.rmtree(old, ignore_errors=True)


def keep_inputs(run: RunFolder, folder: Path) -> None:
    """Keep in the folder of new results what they were made from.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    for path in run.made_from():
        if path.exists():
            with explained_write_errors(folder / path.name):
                _link_or_copy(path, folder / path.name)


def _remove(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)


def _link_or_copy(source: Path, target: Path) -> None:
    """One file under two names where the disk can do that: no file of a run is ever written in place."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
