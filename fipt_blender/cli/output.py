"""What the command line prints, and how it shares stdout and signals with Blender."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ..bridge.process import Message


class Display:
    """Shows messages: as one updated line on a terminal, as a line every few seconds elsewhere, as JSON."""

    def __init__(self, stream: IO[str], as_json: bool, quiet: bool) -> None:
        self._stream = stream
        self._json = as_json
        self._quiet = quiet
        self._terminal = stream.isatty() and not as_json
        self._text = ""
        self._last = -1e9
        self._line_open = False

    def show(self, message: Message) -> None:
        """Show one message."""
        kind = message["type"]
        if self._json:
            self._stream.write(json.dumps(message) + "\n")
            self._stream.flush()
        if kind in ("warning", "error"):
            self.end_line()
            print(f"{kind}: {message['text']} {message['remedy']}", file=sys.stderr, flush=True)
        if self._json or self._quiet:
            return
        if kind == "note":
            self.end_line()
            self._stream.write(f"{message['text']}\n")
            self._stream.flush()
        elif kind == "stage":
            self._text = message["text"]
            self._last = -1e9
        elif kind == "progress":
            self._progress(message)
        elif kind == "done":
            self.end_line()
            self._files(message["files"])

    def end_line(self) -> None:
        """End the updated line, so that other output starts on a new one."""
        if self._line_open:
            self._stream.write("\n")
            self._stream.flush()
            self._line_open = False

    def _progress(self, message: Message) -> None:
        now = time.monotonic()
        if now - self._last < (0.2 if self._terminal else 5.0):
            return
        self._last = now
        line = f"{100 * message['fraction']:3.0f} %  {self._text}"
        if message.get("remaining_seconds") is not None:
            line += f", {format_seconds(message['remaining_seconds'])} left"
        if self._terminal:
            width = _terminal_width(self._stream)
            self._stream.write(f"\r{line[: width - 1]}\x1b[K")
            self._line_open = True
        else:
            self._stream.write(line + "\n")
        self._stream.flush()

    def _files(self, files: Sequence[str]) -> None:
        for name in reversed(files):  # what to look at first is nearest to the prompt
            try:
                size = format_size(os.path.getsize(name))
            except OSError:
                size = "?"
            self._stream.write(f"{size:>9}  {name}\n")
        self._stream.flush()


def format_seconds(seconds: float) -> str:
    """A duration in one or two units: "45 s", "3 min 20 s", "1 h 5 min"."""
    rounded = int(seconds + 0.5)
    if rounded < 60:
        return f"{rounded} s"
    if rounded < 3600:
        return f"{rounded // 60} min {rounded % 60} s"
    return f"{rounded // 3600} h {rounded % 3600 // 60} min"


def format_size(size: int) -> str:
    """A file size in B, kB, MB or GB (powers of 1000)."""
    value = float(size)
    for unit in ("B", "kB", "MB", "GB"):
        if value < 1000 or unit == "GB":
            break
        value /= 1000
    return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"


def _terminal_width(stream: IO[str]) -> int:
    try:
        return os.get_terminal_size(stream.fileno()).columns or 80
    except OSError:
        return 80


@contextmanager
def private_stdout(log: Path) -> Iterator[IO[str]]:
    """A stream to stdout for the display alone; Blender's own output goes to the log meanwhile.

    Blender prints in C, so the file descriptor itself is redirected, and restored at the end.
    """
    sys.stdout.flush()
    try:
        saved = os.dup(1)
        with open(log, "ab") as file:
            os.dup2(file.fileno(), 1)
    except OSError:  # no console (Windows), or a full disk: share stdout
        yield sys.stdout
        return
    stream = os.fdopen(saved, "w", encoding="utf-8", errors="replace", buffering=1)
    try:
        yield stream
    finally:
        sys.stdout.flush()
        if sys.platform != "win32":
            ctypes.CDLL(None).fflush(None)  # flushes the output of Blender's C code
        stream.flush()
        os.dup2(saved, 1)
        stream.close()


@contextmanager
def interrupts() -> Iterator[Callable[[bool], None]]:
    """Turn Ctrl-C and SIGTERM into KeyboardInterrupt, also where Blender has installed its own handler.

    Yields a switch: off, the signals end the process at once. That is for renders, during which Python
    handles no signals; no engine runs then, and all finished work is on the disk.
    """
    numbers = (signal.SIGINT, signal.SIGTERM)

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    def switch(on: bool) -> None:
        for number in numbers:
            signal.signal(number, interrupt if on else signal.SIG_DFL)

    handlers = [signal.getsignal(number) for number in numbers]
    switch(True)
    try:
        yield switch
    finally:
        for number, handler in zip(numbers, handlers, strict=True):
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
