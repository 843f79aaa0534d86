"""The program that is this Blender; the end of a process when its parent ends.

Standard library only.
"""

from __future__ import annotations

import os
import sys
import threading
import time

# The Blender that reads meshes, or a Python that has it as a module; of the engine's environment.
BLENDER_VARIABLE = "FIPT_BLENDER"


PARENT_VARIABLE = "FIPT_PARENT"  # process id of the parent, if the engine is to end with it


def end_with_parent() -> None:
    """Start a thread that ends this process within a second of the end of its parent.

    Nothing is done unless the environment names the parent (`PARENT_VARIABLE`).
    """
    parent = os.environ.get(PARENT_VARIABLE, "")
    if not parent.isdecimal():
        return

    def watch() -> None:
        if sys.platform == "win32":  # where the parent's id stays after its end
            import _winapi

            handle = _winapi.OpenProcess(_winapi.SYNCHRONIZE, False, int(parent))
            _winapi.WaitForSingleObject(handle, _winapi.INFINITE)
        while os.getppid() == int(parent) and sys.platform != "win32":
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def running_blender() -> str:
    """The program that is this Blender: its executable, or the Python that may have it as a module."""
    blender = getattr(sys.modules.get("bpy"), "app", None)
    return os.environ.get(BLENDER_VARIABLE) or getattr(blender, "binary_path", "") or sys.executable
