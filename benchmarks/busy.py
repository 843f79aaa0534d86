#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run a command several times while other processes take all cores; it must pass each time.

    python3 benchmarks/busy.py 3 python3 dev.py test

Ends with the number of times that it failed. Standard library only.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time


def main(times: int, command: list[str]) -> int:
    """Run the command; returns how often it failed."""
    spin = [sys.executable, "-c", "while True: pass"]
    others = [subprocess.Popen(spin) for _ in range(os.cpu_count() or 1)]
    failed = 0
    try:
        for number in range(times):
            began = time.monotonic()
            status = subprocess.call(command)
            failed += status != 0
            print(f"{number + 1} of {times}: status {status}, {time.monotonic() - began:.0f} s", flush=True)
    finally:
        for other in others:
            other.kill()
    return failed


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2:]))
