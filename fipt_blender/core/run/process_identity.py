# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Identifies a process by machine, process id and time of start, since ids recur; ends a process when its
parent ends.

Standard library only.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import threading
import time
from pathlib import Path

# The Blender that reads meshes, or a Python that has it as a module; of the engine's environment.
BLENDER_VARIABLE = "FIPT_BLENDER"


def host_name() -> str:
    """The name of this machine."""
    return platform.node()


def process_start(pid: int) -> str:
    """When a process of this machine started, in a form that only serves comparison; "" if unknown."""
    if sys.platform == "win32":
        return _windows_start(pid)
    if sys.platform == "linux":
        try:
            boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
            # The name of the program, in brackets, may hold spaces.
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            return f"{boot} {fields[19]}"
        except (OSError, IndexError):
            return ""
    try:
        command = ["ps", "-o", "lstart=", "-p", str(pid)]
        result = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return result.stdout.strip()


if sys.platform == "win32":
    import ctypes
    from ctypes import wintypes

    _QUERY_LIMITED_INFORMATION = 0x1000

    def _windows_start(pid: int) -> str:
        kernel = ctypes.WinDLL("kernel32")
        kernel.OpenProcess.restype = wintypes.HANDLE
        handle = kernel.OpenProcess(_QUERY_LIMITED_INFORMATION, False, pid)
        if not handle:
            return ""
        times = [wintypes.FILETIME() for _ in range(4)]
        known = kernel.GetProcessTimes(wintypes.HANDLE(handle), *map(ctypes.byref, times))
        kernel.CloseHandle(wintypes.HANDLE(handle))
        return f"{times[0].dwHighDateTime} {times[0].dwLowDateTime}" if known else ""
else:

    def _windows_start(pid: int) -> str:
        raise NotImplementedError


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


def running_blender() -> str:
    """The program that is this Blender: its executable, or the Python that may have it as a module."""
    blender = getattr(sys.modules.get("bpy"), "app", None)
    return os.environ.get(BLENDER_VARIABLE) or getattr(blender, "binary_path", "") or sys.executable
