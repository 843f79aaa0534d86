# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Anonymous memory of a process, i.e. what it really needs.

Resident memory also includes pages of mapped files, which grow with a capture but which the system reclaims
when memory becomes scarce.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_STATUS = Path("/proc/self/status")
_EVERY_SECONDS = 0.02


def own_gb() -> float:
    """Anonymous resident memory of this process in GB; 0 if the system does not report it."""
    if _STATUS.exists():
        for line in _STATUS.read_text().splitlines():
            if line.startswith("RssAnon:"):
                return int(line.split()[1]) * 1024 / 1e9
    return 0.0


@contextmanager
def watched() -> Iterator[Callable[[], float]]:
    """Watch the anonymous memory of this process; yields a function that returns the peak so far in GB.

    The system keeps no such peak, so it is looked at fifty times a second.
    """
    peak, ended = own_gb(), threading.Event()

    def look() -> float:
        nonlocal peak
        peak = max(peak, own_gb())
        return peak

    def watch() -> None:
        while not ended.wait(_EVERY_SECONDS):
            look()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield look
    finally:
        ended.set()
        thread.join()
