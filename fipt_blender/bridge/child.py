# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Short child processes of set-up, whose output becomes part of messages. Standard library only."""

from __future__ import annotations

import subprocess
from pathlib import Path

from .interpreter import engine_environment


def output_end(result: subprocess.CompletedProcess[str]) -> str:
    """The end of the output of a failed child process."""
    text = (result.stderr.strip() or result.stdout.strip())[-600:]
    return text or f"{' '.join(result.args)} ended with status {result.returncode}"


def answer(python: Path, code: str) -> str | None:
    """The output of a line of code in a Python, stripped; None if the Python or the code fails."""
    if not python.is_file():
        return None
    result = run_quietly([str(python), "-I", "-c", code])
    return result.stdout.strip() if result.returncode == 0 else None


def run_quietly(command: list[str], python: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command and keep its output; a command that can't be started has status 127.

    Args:
        command: to run.
        python: the engine's interpreter if the command needs the libraries of its environment.
    """
    try:
        return subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            env=engine_environment(python),
            check=False,
        )
    except OSError as error:
        return subprocess.CompletedProcess(command, 127, "", str(error))
