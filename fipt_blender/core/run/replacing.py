"""Folders of a run that are replaced when their new content is complete, never before.

Standard library only.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .runfolder import beside, explained_write_errors, recover_folder


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """A new folder beside `folder` that replaces it if the block ends without an exception.

    A kill between the two renamings at the end leaves the old folder, complete, under another name;
    `RunFolder.recover` brings it back.

    Args:
        folder: the path of both.
    """
    new, old = beside(folder)
    with explained_write_errors(folder):
        recover_folder(folder)
        _remove(old)
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


def _remove(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)
