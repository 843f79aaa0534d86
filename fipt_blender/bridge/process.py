"""An engine command as a child process: starting it, reading its messages, cancelling it.

The engine writes its messages to a file, not to a pipe: the panel shows them again when a file is opened.
Standard library only; no threads and no timers: callers use `poll`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..core.run.errors import FiptError
from ..core.run.lock import open_lockable, try_lock
from ..core.run.messages import parse_message
from ..core.run.runfolder import explained_write_errors
from .death import explain_death, last_lines

Message = dict[str, Any]

_TASKKILL_SECONDS = 1.0  # it takes a tenth of that; then the process alone is ended


def end_windows_tree(pid: int) -> None:
    """End a process of Windows and all that it started, which Windows itself would leave running."""
    command = Path(os.environ.get("SystemRoot", "C:/Windows"), "System32", "taskkill.exe")
    try:
        subprocess.run(
            [str(command), "/T", "/F", "/PID", str(pid)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            timeout=_TASKKILL_SECONDS,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        with suppress(OSError):  # it may have ended
            os.kill(pid, signal.SIGTERM)


class EngineProcess:
    """An engine command that this process starts.

    Args:
        command: the interpreter and its arguments.
        log: file to which everything that is not a message is appended.
        environment: the child's complete environment; None: that of this process.
        messages: file for the messages, which is overwritten; None: a temporary file. It stays locked until
            the engine and this object have ended, so that a second engine never writes over it.

    Attributes:
        done: the engine's message `done`, or None.
        error: the message `error` that ended it: its own or one that explains its death; or None.
        cancelled: whether it was asked to end.

    Raises:
        FiptError: ``engine-missing`` where the interpreter can't be started; ``run-busy`` where another
            engine writes its messages there; ``disk-full`` or ``run-unwritable``.
    """

    def __init__(
        self,
        command: Sequence[str],
        log: Path,
        environment: Mapping[str, str] | None = None,
        messages: Path | None = None,
    ) -> None:
        self._temporary = None
        if messages is None:
            handle, name = tempfile.mkstemp(prefix="fipt-", suffix=".jsonl")
            os.close(handle)
            messages = self._temporary = Path(name)
        else:
            with explained_write_errors(messages):
                messages.parent.mkdir(parents=True, exist_ok=True)
        self._stdout = open_lockable(messages)
        if not try_lock(self._stdout):
            self._stdout.close()
            raise FiptError("run-busy.init", messages=messages)
        with explained_write_errors(messages):
            self._stdout.truncate(0)
        self.log = log
        self.done: Message | None = None
        self.error: Message | None = None
        self.cancelled = False
        self._finished = False
        self._deadline = 0.0
        self._last_other = ""
        self._pending = b""
        self._messages = messages
        self._stream = open(messages, "rb")
        try:
            self._process = self._start(command, environment)
        except OSError as error:
            self._close()
            raise FiptError("engine-missing.init", command=command[0], strerror=error.strerror) from error
        if sys.platform != "win32":
            # Not by preexec_fn, which is unsafe in a process with threads such as Blender.
            try:
                niceness = max(10, os.getpriority(os.PRIO_PROCESS, 0))
                os.setpriority(os.PRIO_PGRP, self._process.pid, niceness)
            except OSError:  # the child may have ended already
                pass

    @property
    def running(self) -> bool:
        """Whether `poll` may still return something."""
        return not self._finished

    @property
    def pid(self) -> int:
        """The child's process id; on POSIX also that of its process group."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """The exit status, negative for a signal; None while the process runs."""
        return self._process.returncode

    def poll(self) -> list[Message]:
        """The new messages since the last call, oldest first; never waits.

        If the engine has died without a message `done` or `error`, the last message is an `error` that
        explains its death. After `request_cancel`, this method kills an engine that has not ended in time.
        """
        if self._finished:
            return []
        ended = not self._alive()  # asked before reading, so that all that it wrote is read
        messages = self._read()
        if ended:
            messages += self._finish()
        elif self.cancelled and time.monotonic() > self._deadline:
            self._signal(terminate=False)
        return [] if self.cancelled else messages

    def request_cancel(self) -> None:
        """Ask the engine and all that it started to end; `poll` makes sure of it within two seconds."""
        if not self._finished and not self.cancelled:
            self.cancelled = True
            self._deadline = time.monotonic() + 1.0
            self._signal(terminate=True)

    def cancel(self) -> None:
        """End the engine and all that it started; returns within two seconds."""
        self.request_cancel()
        # A process that hangs in a system call ends as soon as the call returns.
        give_up = self._deadline + 0.5
        while not self._finished and time.monotonic() < give_up:
            self.poll()
            if not self._finished:
                time.sleep(0.02)
        if not self._finished:  # on a busy machine `poll` may not have come to it
            self._signal(terminate=False)
        self._close()

    def _start(
        self, command: Sequence[str], environment: Mapping[str, str] | None
    ) -> subprocess.Popen[bytes]:
        flags = 0
        if sys.platform == "win32":
            flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.BELOW_NORMAL_PRIORITY_CLASS
            flags |= subprocess.CREATE_NO_WINDOW  # else a console opens, and closing it ends the engine
        self._log(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')} {' '.join(command)}")
        try:
            log = open(self.log, "ab")
        except OSError:
            log = open(os.devnull, "ab")
        with log:
            return subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=self._stdout,
                stderr=log,
                env=None if environment is None else dict(environment),
                start_new_session=True,  # ignored on Windows
                creationflags=flags,
            )

    def _alive(self) -> bool:
        return self._process.poll() is None

    def _signal(self, terminate: bool) -> None:
        """End the process and all that it started: ask it to (True) or kill it."""
        try:
            if sys.platform == "win32":
                if self._process.poll() is None:  # else its id may belong to another process
                    end_windows_tree(self._process.pid)
            else:
                os.killpg(self._process.pid, signal.SIGTERM if terminate else signal.SIGKILL)
        except (ProcessLookupError, PermissionError):  # macOS: EPERM for a group of zombies
            pass

    def _read(self) -> list[Message]:
        messages = []
        *lines, self._pending = (self._pending + self._stream.read()).split(b"\n")
        for line in lines:
            message = parse_message(line.decode("utf-8", "replace"))
            if message is None:
                self._keep_other(line)
                continue
            if message["type"] == "done":
                self.done = message
            elif message["type"] == "error":
                self.error = message
            messages.append(message)
        return messages

    def _finish(self) -> list[Message]:
        if self._pending:
            self._keep_other(self._pending)
        self._signal(terminate=False)  # processes that it has left running
        self._close()
        if self.cancelled:
            self._log("--- cancelled")
            self.error = None
            return []
        if self.error is None and (self.returncode or self.done is None):
            self.error = explain_death(self.returncode, self._last_line(), self._messages)
            return [self.error]
        return []

    def _close(self) -> None:
        self._finished = True
        self._stream.close()
        self._stdout.close()
        if self._temporary is not None:
            self._temporary.unlink(missing_ok=True)

    def _keep_other(self, line: bytes) -> None:
        text = line.decode("utf-8", "replace").strip()
        if text:
            self._last_other = text
        self._log(line.decode("utf-8", "replace"))

    def _last_line(self) -> str:
        """The last line that the engine printed besides messages."""
        lines = [self._last_other, *last_lines(self.log)]
        return next((line for line in reversed(lines) if line and not line.startswith("--- ")), "")[:300]

    def _log(self, text: str) -> None:
        try:
            with open(self.log, "a", encoding="utf-8", errors="replace") as file:
                file.write(f"{text}\n")
        except OSError:  # a full disk must not hide the engine's own error message
            pass
