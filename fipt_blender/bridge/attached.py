# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An engine that another process has started, found by the lock of its run folder. Standard library only."""

from __future__ import annotations

import os
import re
import signal
import sys

from ..core.run.lock import Holder, holder
from ..core.run.runfolder import RunFolder
from .process import Engine, end_windows_tree

_COMMAND = re.compile("[a-z][a-z-]*")  # it names a file


class AttachedEngine(Engine):
    """An engine that another process has started and that is working in a run folder.

    Args:
        run: the run folder.
        engine: from `find_engine`.

    Raises:
        OSError: its messages can't be read.
    """

    def __init__(self, run: RunFolder, engine: Holder) -> None:
        super().__init__(run.messages(engine.command[0]), run.log)
        self._run, self._holder = run, engine

    @property
    def pid(self) -> int:
        """The engine's process id."""
        return self._holder.pid

    @property
    def elsewhere(self) -> str:
        return "" if self._holder.is_here or not self._alive() else self._holder.place

    def cancel(self) -> None:
        """End the engine and all that it started; an engine that is elsewhere continues, unwatched."""
        if self.elsewhere:
            self.leave()
        else:
            super().cancel()

    def _alive(self) -> bool:
        return holder(self._run) == self._holder

    def _signal(self, terminate: bool) -> None:
        # Its id may belong to another process by now, or on this machine.
        if not self._alive() or not self._holder.is_here:
            return
        pid = self._holder.pid
        try:
            if sys.platform == "win32":
                end_windows_tree(pid)
                return
            number = signal.SIGTERM if terminate else signal.SIGKILL
            if os.getpgid(pid) == pid:
                os.killpg(pid, number)
            else:  # started by hand, in the process group of a shell
                os.kill(pid, number)
        except (ProcessLookupError, PermissionError):
            pass


def find_engine(run: RunFolder) -> Holder | None:
    """The engine that is working in a run folder and writes messages there, whoever started it, or None."""
    engine = holder(run)
    if engine is None or not engine.command or not _COMMAND.fullmatch(engine.command[0]):
        return None
    return engine if run.messages(engine.command[0]).exists() else None
