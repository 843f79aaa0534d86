"""Which views an unfinished stage has finished, so that a resumed run works on the others only."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .documents import optional_document
from .runfolder import write_json

# Between notes: each waits until the results are on the disk.
NOTE_SECONDS = 5.0


@dataclass(frozen=True)
class FinishedNote:
    """finished.json."""

    views: tuple[int, ...] = ()
    rays: int = 0


class FinishedViews:
    """A stage's finished views, noted in a file of its folder, which is removed where its key changes.

    Args:
        path: the file.

    Attributes:
        flush: writes the results to the disk; called before each note.
        views: indices of the finished views; some may not be noted yet.
        rays: primary rays traced for them.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.flush: Callable[[], None] = lambda: None
        note = optional_document(path, FinishedNote) or FinishedNote()  # a damaged one: only time is lost
        self.views, self.rays = set(note.views), note.rays
        self._noted = time.monotonic()

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
            write_json(self._path, FinishedNote(tuple(sorted(self.views)), self.rays))
            self._noted = time.monotonic()
