# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Explaining why an engine ended without a message of its own. Standard library only."""

from __future__ import annotations

import errno
import os
import shutil
import signal
from pathlib import Path
from typing import Any

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
    if number == 9 or says_out_of_memory(last_line):
        killed = "The engine was killed by the system (SIGKILL), most likely because memory ran out."
        return _error(
            "out-of-memory",
            killed if number == 9 else "The engine ran out of memory.",
            "Use a smaller preset or fewer or smaller views, or close other programs; then resume.",
        )
    if code == errno.ENOSPC or (file is not None and _is_full(file)):
        return _error(
            "disk-full",
            "The disk is full; the engine could not write its files.",
            "Free some space and resume the run; finished stages are kept.",
        )
    try:
        how = f"was ended by the signal {signal.Signals(number).name}"
    except ValueError:
        how = "ended" if returncode is None else f"ended with exit status {returncode}"
    last = f"; the last line that it printed is: {last_line}" if last_line else ""
    return _error(
        "engine-crashed",
        f"The engine {how} without an error message{last}",
        "Resume the run; finished stages are kept. If it happens again, see log.txt in the run folder.",
    )


def _error(code: str, text: str, remedy: str) -> dict[str, Any]:
    return {"type": "error", "code": code, "text": text, "remedy": remedy}


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
