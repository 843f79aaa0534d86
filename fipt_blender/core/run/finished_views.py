# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which views an unfinished stage has finished, so that a resumed run works on the others only."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from .documents import optional_document
from .runfolder import write_json

# Between notes: each waits until the results are on the disk.
NOTE_SECONDS = 5.0


class FinishedViews:
    """A stage's finished views, noted in a file; a note of another stage or of other input is deleted.

    Args:
        path: the file.
        key: key of the stage (`stage_keys`), on which the views' results depend.

    Attributes:
        flush: writes the results to the disk; called before each note.
        views: indices of the finished views; some may not be noted yet.
        rays: primary rays traced for them.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """

    def __init__(self, path: Path, key: str) -> None:
        self._path, self._key = path, key
        self.flush: Callable[[], None] = lambda: None
        self.views: set[int] = set()
        self.rays = 0
        self._noted = time.monotonic()
        if not path.exists():
            return
        note = optional_document(path, dict) or {}  # a damaged one: only time is lost
        if note.get("key") == key:
            self.views, self.rays = set(note["views"]), note["rays"]
        else:
            self.forget()

    def forget(self) -> None:
        """No view is finished: their results are missing or are about to be overwritten."""
        self._path.unlink(missing_ok=True)
        self.views, self.rays = set(), 0

    def add(self, view: int, rays: int) -> None:
        """A view is finished: its results are in memory or on the disk."""
        self.views.add(view)
        self.rays += rays
        if time.monotonic() - self._noted >= NOTE_SECONDS:
            self.flush()
            write_json(self._path, {"key": self._key, "views": sorted(self.views), "rays": self.rays})
            self._noted = time.monotonic()
