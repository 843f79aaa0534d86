# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One engine a run folder: a lock that the system frees with the process, whatever ends it.

Standard library only: the engine holds it, Blender asks who does.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO

from .errors import FiptError
from .runfolder import RunFolder, explained_write_errors

_PATIENCE_SECONDS = 1.0  # whoever asks for the holder has the lock for a moment


@dataclass(frozen=True)
class Holder:
    """The engine that works in a run folder: its process id and the arguments of its command."""

    pid: int
    command: tuple[str, ...]


@contextmanager
def hold(run: RunFolder, command: Sequence[str]) -> Iterator[None]:
    """Keep other engines out of a run folder while the block runs.

    Args:
        run: an existing folder; where there is none nothing is locked.
        command: what the engine does, for `holder`.

    Raises:
        FiptError: ``run-busy`` where another engine holds it; ``disk-full`` or ``run-unwritable``.
    """
    if not run.root.is_dir():
        yield
        return
    with explained_write_errors(run.engine_lock):
        file = open(run.engine_lock, "ab+")
    with file:
        deadline = time.monotonic() + _PATIENCE_SECONDS
        while not _lock(file, shared=False):
            if time.monotonic() > deadline:
                raise FiptError(
                    "run-busy",
                    f"An engine works in {run.root} already.",
                    "Wait for its end, or stop it where it was started.",
                )
            time.sleep(0.05)
        with explained_write_errors(run.engine_lock):
            file.seek(0)
            file.truncate()
            file.write(json.dumps({"pid": os.getpid(), "command": list(command)}).encode())
            file.flush()
        yield


def holder(run: RunFolder) -> Holder | None:
    """The engine that works in a run folder now, or None."""
    try:
        file = open(run.engine_lock, "rb")
    except OSError:
        return None
    with file:
        if _lock(file, shared=True):
            return None  # closing the file frees it
        try:
            data = json.loads(file.read())
            return Holder(int(data["pid"]), tuple(map(str, data["command"])))
        except (OSError, ValueError, KeyError, TypeError):  # it is being written just now
            return None


if sys.platform == "win32":
    import msvcrt

    _LOCKED_BYTE = 1 << 30  # locked bytes can't be read there, so one behind the text

    def _lock(file: IO[bytes], shared: bool) -> bool:
        position = file.tell()
        try:
            file.seek(_LOCKED_BYTE)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            file.seek(position)
        return True
else:
    import fcntl

    def _lock(file: IO[bytes], shared: bool) -> bool:
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a network drive without locks: better unguarded than not at all
            pass
        return True
