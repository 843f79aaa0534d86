"""A lock that allows one engine per run folder; the system releases it however the process ends.

Standard library only: the engine holds the lock, and Blender asks which engine holds it. A second kind, held
for moments only, guards changes of a file that several processes make.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import stat
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated

from .documents import parse_document
from .errors import FiptError
from .kinds import Number, as_json, as_kind
from .runfolder import RunFolder, explained_write_errors

# Flags with which a link is not followed, and opening a pipe does not wait for its other end.
_PLAIN_FILE = sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_CLOEXEC", "O_NONBLOCK", "O_BINARY"))


@dataclass(frozen=True)
class Holder:
    """The engine that works in a run folder.

    Attributes:
        pid: its process id, on its machine.
        command: its command with the arguments.
        host: name of its machine, "" if unknown.
    """

    pid: Annotated[int, Number(1, 2**31)]
    command: tuple[str, ...]
    host: str = ""

    @property
    def place(self) -> str:
        """Where it runs, for messages."""
        return f"on the machine '{self.host or 'unknown'}' as process {self.pid}"


@contextmanager
def hold(run: RunFolder, command: Sequence[str]) -> Iterator[None]:
    """Keep other engines out of a run folder while the block runs.

    Args:
        run: the folder; if it does not exist, nothing is locked.
        command: the engine's command with its arguments, which `holder` returns.

    Raises:
        FiptError: ``run-busy`` if another engine holds the lock; ``run-linked``; ``disk-full`` or
            ``run-unwritable``.
    """
    if not run.root.is_dir():
        yield
        return
    run.refuse_links()
    with open_lockable(run.engine_lock) as file:
        if not _wait_for(file):
            raise busy(run)
        with explained_write_errors(run.engine_lock):
            file.seek(0)
            file.truncate()
            engine = Holder(os.getpid(), tuple(command), platform.node())
            file.write(json.dumps(engine, default=as_json).encode())
            file.flush()
        yield


def _wait_for(file: IO[bytes]) -> bool:
    """Lock an open file, if need be after others; False if they hold the lock for long."""
    deadline = time.monotonic() + 1.0  # `holder` itself takes the lock for a moment
    while not try_lock(file):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def holder(run: RunFolder) -> Holder | None:
    """The engine that works in a run folder now, or None."""
    try:
        file = os.fdopen(os.open(run.engine_lock, os.O_RDONLY | _PLAIN_FILE), "rb")
    except OSError:
        return None
    with file:
        if _lock(file, shared=True):
            return None  # closing the file releases the lock
        try:
            return as_kind(parse_document(file.read(65_536).decode("utf-8")), Holder)
        except (OSError, ValueError):  # the file is just being written
            return None


def busy(run: RunFolder) -> FiptError:
    """The error ``run-busy``, which says where the engine runs that works in a run folder."""
    engine = holder(run)
    place = "" if engine is None else f" It runs {engine.place}."
    return FiptError("run-busy.busy", root=run.root, place=place)


def open_lockable(path: Path) -> IO[bytes]:
    """Open or create a file for locking and appending; links and other special files are not followed.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    with explained_write_errors(path):
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | _PLAIN_FILE, 0o666), "ab+")
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            file.close()
            raise OSError(errno.EINVAL, "it is not a regular file")
    return file


def try_lock(file: IO[bytes]) -> bool:
    """Lock an open file for this process and those that inherit it; False if others hold the lock.

    The system releases the lock when the file is closed or the processes end.
    """
    return _lock(file, shared=False)


if sys.platform == "win32":
    import msvcrt

    _LOCKED_BYTE = 1 << 30  # far behind the text, because Windows does not let locked bytes be read

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
        except OSError:  # a network drive without locks: working without a lock is better than not working
            pass
        return True
