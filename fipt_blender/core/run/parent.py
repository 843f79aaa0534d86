# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Ending the engine together with the process that started it, for runs in background.

Standard library only: both processes import it.
"""

from __future__ import annotations

import os
import sys
import threading
import time

PARENT_VARIABLE = "FIPT_PARENT"  # process id of the parent, if the engine is to end with it


def end_with_parent() -> None:
    """Start a thread that ends this process within a second of the end of its parent.

    Nothing is done unless the environment names the parent (`PARENT_VARIABLE`), or on Windows, where a
    process can't see that its parent has ended.
    """
    parent = os.environ.get(PARENT_VARIABLE, "")
    if not parent.isdecimal() or sys.platform == "win32":
        return

    def watch() -> None:
        while os.getppid() == int(parent):
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
