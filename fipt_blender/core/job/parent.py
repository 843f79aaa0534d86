# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Ending with the process that started the engine, for runs that nobody could watch again.

Standard library only: both processes import it.
"""

from __future__ import annotations

import os
import sys
import threading
import time

PARENT_VARIABLE = "FIPT_PARENT"  # process id of who started the engine, if it is to end with him


def end_with_parent() -> None:
    """Let a thread end this process within a second when the parent that the environment names has ended.

    Without such a name, and on Windows, which does not tell, the process goes on by itself.
    """
    parent = os.environ.get(PARENT_VARIABLE, "")
    if not parent.isdecimal() or sys.platform == "win32":
        return

    def watch() -> None:
        while os.getppid() == int(parent):
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
