# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed vocabulary between engine and Blender: one JSON object a line on the child's stdout.

Standard library only: both processes import it. The table in docs/architecture.md says what each type
means for the user.
"""

from __future__ import annotations

import errno
import io
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from typing import IO, Any

MESSAGE_TYPES = ("stage", "progress", "warning", "error", "done")


def parse_message(line: str) -> dict[str, Any] | None:
    """Return the message in one line of the child's stdout, or None where the line is none."""
    if not line.startswith("{"):
        return None
    try:
        message = json.loads(line)
    except ValueError:
        return None
    if not isinstance(message, dict) or message.get("type") not in MESSAGE_TYPES:
        return None
    return message


def says_out_of_memory(text: str) -> bool:
    """Whether a library's words mean that memory, the processor's or the GPU's, ran out."""
    words = ("out of memory", "out_of_memory", "not enough memory", "bad_alloc", "can't allocate memory")
    return any(word in text.lower() for word in words)


def claim_stdout() -> IO[str]:
    """Take the process's stdout for messages alone and send every other print to stderr.

    Native libraries write to file descriptor 1, so the descriptor itself is moved.
    """
    sys.stdout.flush()
    # Unbuffered: what a full disk refused must not be tried again at the end.
    stream = io.TextIOWrapper(io.FileIO(os.dup(1), "w"), encoding="utf-8", write_through=True)
    os.dup2(2, 1)
    return stream


class Reporter:
    """Writes messages; stages carry weights so that one fraction covers the whole command.

    Args:
        stream: where the lines go; None keeps silent (library use and tests).

    Attributes:
        lost: whether the last message could not be written because the disk is full.
    """

    def __init__(self, stream: IO[str] | None = None) -> None:
        self.lost = False
        self._stream = stream
        self._weights: list[float] = [1.0]
        self._stage = 0
        self._started = time.monotonic()
        self._done_before_start = 0.0
        self._last_progress = 0.0

    def _write(self, message: Mapping[str, Any]) -> None:
        if self._stream is None:
            return
        try:
            # Of a message that did not fit, a part may be there.
            self._stream.write(("\n" if self.lost else "") + json.dumps(message) + "\n")
            self._stream.flush()
            self.lost = False
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            self.lost = True

    def plan(self, weights: Sequence[float]) -> None:
        """Set the expected share of time of each stage to come."""
        total = sum(weights) or 1.0
        self._weights = [weight / total for weight in weights]
        self._stage = -1
        self._started = time.monotonic()
        self._done_before_start = 0.0

    def stage(self, name: str, text: str) -> None:
        """Begin the next planned stage."""
        self._stage = min(self._stage + 1, len(self._weights) - 1)
        self._write(
            {"type": "stage", "name": name, "index": self._stage, "count": len(self._weights), "text": text}
        )
        self.progress(0.0, force=True)

    def skip(self, count: int = 1) -> None:
        """Count stages as done that a resumed run already has; they cost no time from now on."""
        for _ in range(count):
            self._stage = min(self._stage + 1, len(self._weights) - 1)
        self._done_before_start = sum(self._weights[: self._stage + 1])

    def progress(
        self, stage_fraction: float, force: bool = False, pictures: Sequence[str] | None = None
    ) -> None:
        """Report how much of the running stage is done (0 to 1); at most four lines a second.

        Args:
            force: whether to write now however short ago the last line was.
            pictures: paths inside the run folder of new pictures that show what was found so far.
        """
        now = time.monotonic()
        if not force and now - self._last_progress < 0.25:
            return
        self._last_progress = now
        stage = max(self._stage, 0)
        fraction = sum(self._weights[:stage]) + self._weights[stage] * min(max(stage_fraction, 0.0), 1.0)
        done = fraction - self._done_before_start
        elapsed = now - self._started
        remaining = elapsed * (1.0 - fraction) / done if done > 0.02 else None
        self._write(
            {
                "type": "progress",
                "fraction": round(fraction, 4),
                "stage_fraction": round(stage_fraction, 4),
                "remaining_seconds": None if remaining is None else round(remaining, 1),
                "memory_gb": round(peak_memory_gb(), 3),
                **({"files": list(pictures)} if pictures else {}),
            }
        )

    def warning(self, code: str, text: str, remedy: str) -> None:
        """Tell the user something that does not stop the job."""
        self._write({"type": "warning", "code": code, "text": text, "remedy": remedy})

    def error(self, code: str, text: str, remedy: str) -> None:
        """Tell the user why the job stopped."""
        self._write({"type": "error", "code": code, "text": text, "remedy": remedy})

    def done(self, files: Sequence[str], data: Mapping[str, Any] | None = None) -> None:
        """Name what the command made."""
        self._write({"type": "done", "files": list(files), "data": dict(data or {})})


def peak_memory_gb() -> float:
    """Peak resident memory of this process in GB (1e9 bytes); 0 where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1.0 if sys.platform == "darwin" else 1024.0) / 1e9
