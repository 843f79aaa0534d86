"""Messages from the engine to Blender: one JSON object per line on the engine's stdout.

Standard library only: both processes import it. docs/run_folder.md lists the types and their fields.
"""

from __future__ import annotations

import errno
import io
import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from .errors import FiptError, Problem, as_message, problem
from .kinds import as_json

# Share of a plan whose time counts as known before anything is done, where seconds are expected; and without
# these the share from which on the time that is left is told.
PRIOR, LEAST_DONE = 0.2, 0.05
# Share of a stage at which its own rate and that of the whole plan count alike.
OWN_RATE = 0.1

TYPES = ("stage", "progress", "note", "warning", "error", "done")  # of messages

Progress = Callable[[float], None]  # is called with the share of a work that is done, 0 to 1


def unwatched(share: float) -> None:
    """Progress that nobody asks for."""


def within(progress: Progress, begin: float, end: float) -> Progress:
    """Progress of a piece of the work, which takes it from the share `begin` to `end`."""
    return lambda share: progress(begin + (end - begin) * share)


def parse_message(line: str) -> dict[str, Any] | None:
    """The message in one line of the engine's stdout, or None if the line is not a message."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) and message.get("type") in TYPES else None


def says_out_of_memory(text: str) -> bool:
    """Whether the text of an error means that main memory or GPU memory ran out."""
    signs = ("out of memory", "out_of_memory", "not enough memory", "bad_alloc", "can't allocate memory")
    return any(sign in text.lower() for sign in signs)


def claim_stdout() -> IO[str]:
    """Reserve the process's stdout for messages and redirect everything else that is printed to stderr.

    Native libraries write to file descriptor 1, therefore the descriptor itself is redirected.

    Returns:
        The stream for messages.
    """
    sys.stdout.flush()
    # Unbuffered: a write that failed on a full disk must not be repeated when the process ends.
    stream = io.TextIOWrapper(io.FileIO(os.dup(1), "w"), encoding="utf-8", write_through=True)
    os.dup2(2, 1)
    return stream


class Reporter:
    """Writes messages. Stages have weights, so that one fraction covers the whole command.

    Args:
        stream: for the lines; None writes nothing (library use and tests).

    Attributes:
        warnings: code, text and remedy of each warning so far.
        lost: whether the last message could not be written because the disk was full.
    """

    def __init__(self, stream: IO[str] | None = None) -> None:
        self.warnings: list[dict[str, str]] = []
        self.lost = False
        self._stream = stream
        self._weights: list[float] = [1.0]
        self._stage = 0
        self._started = self._stage_started = time.monotonic()
        self._done_before = self._skipped = 0.0
        self._expected: float | None = None
        self._last_progress = 0.0

    def _write(self, message: Mapping[str, Any]) -> None:
        if self._stream is None:
            return
        try:
            # A message that did not fit may have been written in part.
            self._stream.write(("\n" if self.lost else "") + json.dumps(message, default=as_json) + "\n")
            self._stream.flush()
            self.lost = False
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            self.lost = True

    def plan(self, weights: Sequence[float], seconds: float | None = None) -> None:
        """Set the expected time of each of the following stages, in any unit.

        An earlier plan, of which not all stages have begun, is continued: these divide what it has left.

        Args:
            weights: of the stages.
            seconds: expected of all together, if known.
        """
        begin = self._done_before + sum(self._weights[: self._stage + 1])
        if begin > 1.0 - 1e-6:
            begin, self._skipped, self._started, self._expected = 0.0, 0.0, time.monotonic(), None
        self._expected = self._expected if seconds is None else seconds
        total = sum(weights) or 1.0
        self._weights = [(1.0 - begin) * weight / total for weight in weights]
        self._stage, self._done_before = -1, begin

    def stage(self, name: str, text: str) -> None:
        """Begin the next planned stage."""
        self._stage = min(self._stage + 1, len(self._weights) - 1)
        self._stage_started = time.monotonic()
        self._write(
            {"type": "stage", "name": name, "index": self._stage, "count": len(self._weights), "text": text}
        )
        self.progress(0.0, force=True)

    def skip(self, count: int = 1) -> None:
        """Count stages as done that a resumed run already has; the remaining time does not include them."""
        for _ in range(count):
            self._stage = min(self._stage + 1, len(self._weights) - 1)
            self._skipped += self._weights[self._stage]

    def progress(
        self, stage_fraction: float, force: bool = False, pictures: Sequence[str] | None = None
    ) -> None:
        """Report which share of the current stage is done (0 to 1); at most four lines per second.

        Args:
            stage_fraction: share of the current stage that is done.
            force: write even if the last line was written less than a quarter of a second ago.
            pictures: paths, relative to the run folder, of new pictures of the estimate so far.
        """
        now = time.monotonic()
        if not force and now - self._last_progress < 0.25:
            return
        self._last_progress = now
        stage, share = max(self._stage, 0), min(max(stage_fraction, 0.0), 1.0)
        before = self._done_before + sum(self._weights[:stage])
        fraction = before + self._weights[stage] * share
        remaining = self._remaining(now, self._weights[stage], share, fraction)
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

    def _remaining(self, now: float, weight: float, share: float, fraction: float) -> float | None:
        """Seconds left, of the stage by its own rate, of others by all that is done; None while unknown.

        Args:
            now: as of `time.monotonic`.
            weight: of the stage. share: of it that is done.
            fraction: of the plan that is done.
        """
        done, elapsed = fraction - self._skipped, now - self._stage_started
        if self._expected is None and done <= LEAST_DONE:
            return None
        prior = 0.0 if self._expected is None else PRIOR
        rate = (prior * (self._expected or 0.0) + now - self._started) / (prior + done)
        later = rate * (1.0 - fraction - weight * (1.0 - share))
        if share <= 0.0:
            return later + max(weight * rate - elapsed, 0.0)
        trust = share / (share + OWN_RATE)
        return later + (1.0 - share) * (elapsed / share) ** trust * (weight * rate) ** (1.0 - trust)

    def note(self, text: str) -> None:
        """Report a fact that is no problem, such as the expected cost."""
        self._write({"type": "note", "text": text})

    def warning(self, key: str, /, **values: object) -> None:
        """Report a problem of problems.toml that does not stop the command."""
        self.warn(problem(key, **values))

    def warn(self, said: Problem | FiptError) -> None:
        """Report a problem that does not stop the command."""
        self.warnings.append({"code": said.code, "text": said.text, "remedy": said.remedy})
        self._write({"type": "warning", **self.warnings[-1]})

    def error(self, said: Problem | FiptError) -> None:
        """Report the problem that stopped the command."""
        self._write(as_message("error", said))

    def done(self, files: Sequence[str], data: Mapping[str, Any] | None = None) -> None:
        """Report the end of the command, with the files it wrote and data, JSON or dataclasses."""
        self._write({"type": "done", "files": list(files), "data": dict(data or {})})


def peak_memory_gb() -> float:
    """Peak resident memory of this process in GB (1e9 bytes); 0 on Windows.

    On Linux that of its own memory: `getrusage` also counts what the process that started it, Blender, had in
    memory then.
    """
    try:
        text = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return int(text.partition("VmHWM:")[2].split()[0]) * 1024.0 / 1e9
    except (OSError, IndexError, ValueError):  # not Linux
        pass
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1.0 if sys.platform == "darwin" else 1024.0) / 1e9
