# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory that the engine reports is its own, not that of the Blender that has started it."""

from __future__ import annotations

import subprocess
import sys

import pytest

_CODE = "from fipt_blender.core.run.messages import peak_memory_gb; print(peak_memory_gb())"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system counts otherwise")
def test_the_memory_of_the_process_that_starts_the_engine_is_not_counted():
    block = bytearray(400_000_000)
    block[::4096] = b"x" * len(block[::4096])
    result = subprocess.run([sys.executable, "-c", _CODE], capture_output=True, text=True, check=True)
    assert 0.0 < float(result.stdout) < 0.2
