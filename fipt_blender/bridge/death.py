"""Explaining why an engine ended without a message of its own. Standard library only."""

from __future__ import annotations

import errno
import os
import shutil
import signal
from pathlib import Path
from typing import Any

from ..core.run.errors import as_message, problem
from ..core.run.messages import says_out_of_memory


def explain_death(returncode: int | None, last_line: str = "", file: Path | None = None) -> dict[str, Any]:
    """The `error` message for an engine that ended without one of its own.

    Args:
        returncode: as from `subprocess`: negative for a signal; 128 + signal from a shell; None if unknown.
        last_line: the last line that the engine printed.
        file: a file on the disk to which the engine wrote.
    """
    code = returncode or 0
    number = -code if code < 0 else code - 128 if 128 < code < 160 else 0
    if number == 9:
        return as_message("error", problem("out-of-memory.killed"))
    if says_out_of_memory(last_line):
        return as_message("error", problem("out-of-memory"))
    if code == errno.ENOSPC or (file is not None and _is_full(file)):
        return as_message("error", problem("disk-full.explain-death"))
    try:
        how = f"was ended by the signal {signal.Signals(number).name}"
    except ValueError:
        how = "ended" if returncode is None else f"ended with exit status {returncode}"
    last = f"; the last line that it printed is: {last_line}" if last_line else ""
    return as_message("error", problem("engine-crashed", how=how, last=last))


def _is_full(path: Path) -> bool:
    try:
        return shutil.disk_usage(path.parent).free < 1 << 20
    except OSError:
        return False


def last_lines(log: Path) -> list[str]:
    """The last lines of a log; none if it can't be read."""
    try:
        with open(log, "rb") as file:
            file.seek(max(os.fstat(file.fileno()).st_size - 4096, 0))
            return [line.strip() for line in file.read().decode("utf-8", "replace").splitlines()]
    except OSError:
        return []
