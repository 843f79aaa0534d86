# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One engine command as a child process: started, read without blocking, cancelled, its death explained.

Standard library only. No threads and no timers: a modal operator calls `poll` from its own timer, a
background run calls `run_blocking`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from ..core.job.messages import parse_message

Message = dict[str, Any]

_POLL_SECONDS = 0.05
_TERMINATE_SECONDS = 1.0
_NICENESS = 10
_READ_BYTES = 1 << 16
_OUT_OF_MEMORY_REMEDY = "Use a smaller preset, fewer or smaller views, or close other programs; then resume."


class EngineProcess:
    """A running engine command.

    Args:
        command: the interpreter and its arguments.
        log: file to which everything that is no message is appended.
        environment: the child's whole environment; None keeps the caller's.

    Attributes:
        done: the child's `done` message once it came.
        error: the `error` message that ended the child, its own or one that explains its death.

    Raises:
        OSError: the interpreter can't be started.
    """

    def __init__(
        self, command: Sequence[str], log: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        self.log = log
        self.done: Message | None = None
        self.error: Message | None = None
        self.cancelled = False
        self._finished = False
        self._last_stray = ""
        self._pending = {"stdout": b"", "stderr": b""}
        flags = 0
        if sys.platform == "win32":
            flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.BELOW_NORMAL_PRIORITY_CLASS
        self._process = subprocess.Popen(
            list(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            env=None if environment is None else dict(environment),
            start_new_session=True,  # ignored on Windows
            creationflags=flags,
        )
        if sys.platform != "win32":
            # From here and not in the child: preexec_fn is unsafe in a process with threads, as Blender is.
            try:
                os.setpriority(os.PRIO_PGRP, self._process.pid, _NICENESS)
            except OSError:  # it may have ended already
                pass
        for stream in (self._process.stdout, self._process.stderr):
            assert stream is not None
            _make_non_blocking(stream)
        self._log(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')} {' '.join(command)}\n".encode())

    @property
    def pid(self) -> int:
        """The child's process id, which is its process group's too (POSIX)."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """The child's exit status, negative for a signal; None while it runs."""
        return self._process.returncode

    @property
    def running(self) -> bool:
        """Whether `poll` may still return something."""
        return not self._finished

    def poll(self) -> list[Message]:
        """The messages that came since the last call, oldest first; never waits.

        When the child has died without a `done` or `error` message, the last message is an `error` with
        the code ``engine-crashed`` or ``out-of-memory``.
        """
        if self._finished:
            return []
        ended = self._process.poll() is not None  # asked before reading: what it wrote is then all there
        messages = self._read()
        if ended:
            messages += self._finish()
        return messages

    def run_blocking(self, on_message: Callable[[Message], None]) -> bool:
        """Wait for the end, handing over each message; True when the command succeeded.

        An exception in between, Ctrl-C among them, cancels the child first.
        """
        try:
            while self.running:
                for message in self.poll():
                    on_message(message)
                if self.running:
                    time.sleep(_POLL_SECONDS)
        except BaseException:
            self.cancel()
            raise
        return self.error is None and not self.cancelled

    def cancel(self) -> None:
        """End the child and everything it started; returns within two seconds."""
        if self._finished:
            return
        self.cancelled = True
        self._signal_group(terminate=True)
        deadline = time.monotonic() + _TERMINATE_SECONDS
        while self._process.poll() is None and time.monotonic() < deadline:
            self._read()  # a child that blocks on a full pipe could not end
            time.sleep(0.02)
        self._signal_group(terminate=False)
        try:
            self._process.wait(timeout=0.5)
        except subprocess.TimeoutExpired:
            pass  # stuck in the kernel; the kill takes effect when it returns from there
        self._read()
        self._log(b"--- cancelled\n")
        self._close()

    def _signal_group(self, terminate: bool) -> None:
        try:
            if sys.platform == "win32":
                self._process.kill()
            else:
                os.killpg(self._process.pid, signal.SIGTERM if terminate else signal.SIGKILL)
        except (ProcessLookupError, PermissionError):  # macOS says EPERM for a group of zombies
            pass

    def _read(self) -> list[Message]:
        messages = []
        for line in self._lines("stderr"):
            self._keep_stray(line)
        for line in self._lines("stdout"):
            message = parse_message(line.decode("utf-8", "replace"))
            if message is None:
                self._keep_stray(line)
                continue
            if message["type"] == "done":
                self.done = message
            elif message["type"] == "error":
                self.error = message
            messages.append(message)
        return messages

    def _lines(self, name: str) -> list[bytes]:
        """Whole lines that have arrived on one pipe; the rest waits for its end."""
        stream = getattr(self._process, name)
        data = self._pending[name]
        while True:
            try:
                chunk = stream.read(_READ_BYTES)
            except OSError:
                chunk = None
            if not chunk:  # None: nothing there now; b"": closed
                break
            data += chunk
        *lines, self._pending[name] = data.split(b"\n")
        return [line + b"\n" for line in lines]

    def _finish(self) -> list[Message]:
        for name in ("stdout", "stderr"):
            if self._pending[name]:
                self._keep_stray(self._pending[name] + b"\n")
        code = self._process.returncode
        synthetic = []
        if self.error is None and (code != 0 or self.done is None):
            self.error = explain_death(code, self._last_stray)
            synthetic.append(self.error)
        self._signal_group(terminate=False)  # whatever the child left running
        self._close()
        return synthetic

    def _close(self) -> None:
        self._finished = True
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _keep_stray(self, line: bytes) -> None:
        text = line.decode("utf-8", "replace").strip()
        if text:
            self._last_stray = text[:300]
        self._log(line)

    def _log(self, line: bytes) -> None:
        try:
            with open(self.log, "ab") as file:
                file.write(line)
        except OSError:  # a full disk must not hide the child's own message about it
            pass


def explain_death(returncode: int, last_line: str = "") -> Message:
    """The `error` message for a child that ended without one of its own.

    Args:
        returncode: as of `subprocess`: negative for a signal; 128 + signal from a shell.
        last_line: the last thing that the child printed.
    """
    number = -returncode if returncode < 0 else returncode - 128 if 128 < returncode < 160 else 0
    if number == 9:
        return {
            "type": "error",
            "code": "out-of-memory",
            "text": "The engine was killed by the system (SIGKILL), most likely because memory ran out.",
            "remedy": _OUT_OF_MEMORY_REMEDY,
        }
    try:
        how = f"was ended by the signal {signal.Signals(number).name}"
    except ValueError:
        how = f"ended with exit status {returncode}"
    said = f"; its last line was: {last_line}" if last_line else ""
    return {
        "type": "error",
        "code": "engine-crashed",
        "text": f"The engine {how} without a message of its own{said}",
        "remedy": "Resume the run: finished stages are kept. If it happens again, log.txt in the run folder"
        " tells more.",
    }


def _make_non_blocking(stream: IO[bytes]) -> None:
    if sys.platform == "win32" and sys.version_info < (3, 12):  # os.set_blocking knows no pipes there
        import ctypes
        import msvcrt

        no_wait = ctypes.c_ulong(1)  # PIPE_NOWAIT
        handle = msvcrt.get_osfhandle(stream.fileno())
        ctypes.windll.kernel32.SetNamedPipeHandleState(
            ctypes.c_void_p(handle), ctypes.byref(no_wait), None, None
        )
    else:
        os.set_blocking(stream.fileno(), False)
