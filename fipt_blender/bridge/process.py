# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An engine command as a process of its own: started or found, watched, cancelled, its death explained.

It writes its messages to a file that is read here, not to a pipe: so it can outlive Blender, and another
Blender can watch it. Standard library only; no threads and no timers: who wants to know calls `poll`.
"""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.job.lock import Holder, holder
from ..core.job.messages import parse_message, says_out_of_memory
from ..core.job.runfolder import RunFolder, explained_write_errors

Message = dict[str, Any]

_POLL_SECONDS = 0.05
_TERMINATE_SECONDS = 1.0
_NICENESS = 10
_TAIL_BYTES = 4096
_FULL_DISK_BYTES = 1 << 20
_OUT_OF_MEMORY_REMEDY = "Use a smaller preset, fewer or smaller views, or close other programs; then resume."


class Engine:
    """An engine command that runs, and the file of its messages.

    Args:
        messages: file to which the engine's stdout goes.
        log: file to which everything that is no message is appended.

    Attributes:
        done: the engine's `done` message once it came.
        error: the `error` message that ended it, its own or one that explains its death.
        cancelled: whether it was told to end.
    """

    def __init__(self, messages: Path, log: Path) -> None:
        self.log = log
        self.done: Message | None = None
        self.error: Message | None = None
        self.cancelled = False
        self._finished = False
        self._deadline = 0.0
        self._last_stray = ""
        self._pending = b""
        self._messages = messages
        self._stream = open(messages, "rb")

    @property
    def running(self) -> bool:
        """Whether `poll` may still return something."""
        return not self._finished

    @property
    def returncode(self) -> int | None:
        """The process's exit status, negative for a signal; None while it runs or where nobody tells."""
        return None

    def poll(self) -> list[Message]:
        """The messages that came since the last call, oldest first; never waits.

        When the engine has died without a `done` or `error` message, the last message is an `error` that
        explains it. After `request_cancel` it is what kills an engine that does not listen.
        """
        if self._finished:
            return []
        ended = not self._alive()  # asked before reading: what it wrote is then all there
        messages = self._read()
        if ended:
            messages += self._finish()
        elif self.cancelled and time.monotonic() > self._deadline:
            self._signal(terminate=False)
        return [] if self.cancelled else messages

    def run_blocking(self, on_message: Callable[[Message], None]) -> bool:
        """Wait for the end, handing over each message; True when the command succeeded.

        An exception in between, Ctrl-C among them, cancels the engine first.
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

    def request_cancel(self) -> None:
        """Tell the engine and everything it started to end; `poll` sees to it, within two seconds."""
        if not self._finished and not self.cancelled:
            self.cancelled = True
            self._deadline = time.monotonic() + _TERMINATE_SECONDS
            self._signal(terminate=True)

    def cancel(self) -> None:
        """End the engine and everything it started; returns within two seconds."""
        self.request_cancel()
        # A process that is stuck in the kernel is left to the kill that takes effect when it returns.
        give_up = self._deadline + 0.5
        while not self._finished and time.monotonic() < give_up:
            self.poll()
            if not self._finished:
                time.sleep(0.02)
        self._close()

    def leave(self) -> None:
        """Watch it no more; it goes on."""
        self._close()

    def _alive(self) -> bool:
        raise NotImplementedError

    def _signal(self, terminate: bool) -> None:
        """End the process and what it started, asking (True) or by force."""
        raise NotImplementedError

    def _read(self) -> list[Message]:
        messages = []
        *lines, self._pending = (self._pending + self._stream.read()).split(b"\n")
        for line in lines:
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

    def _finish(self) -> list[Message]:
        if self._pending:
            self._keep_stray(self._pending)
        self._signal(terminate=False)  # whatever it left running
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

    def _keep_stray(self, line: bytes) -> None:
        text = line.decode("utf-8", "replace").strip()
        if text:
            self._last_stray = text

    def _last_line(self) -> str:
        """The last thing that was printed besides messages."""
        lines = [self._last_stray, *_tail(self.log)]
        return next((line for line in reversed(lines) if line and not line.startswith("--- ")), "")[:300]

    def _log(self, text: str) -> None:
        try:
            with open(self.log, "a", encoding="utf-8", errors="replace") as file:
                file.write(f"{text}\n")
        except OSError:  # a full disk must not hide the engine's own message about it
            pass


class EngineProcess(Engine):
    """An engine command that this process starts.

    Args:
        command: the interpreter and its arguments.
        log: file to which everything that is no message is appended.
        environment: the child's whole environment; None keeps the caller's.
        messages: file for the messages, begun anew; None takes a temporary one.

    Raises:
        OSError: the interpreter can't be started.
        FiptError: ``disk-full`` or ``run-unwritable``.
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
                messages.write_bytes(b"")
        super().__init__(messages, log)
        try:
            self._process = self._start(command, messages, environment)
        except BaseException:
            self._close()
            raise
        if sys.platform != "win32":
            # From here and not in the child: preexec_fn is unsafe in a process with threads, as Blender is.
            try:
                os.setpriority(os.PRIO_PGRP, self._process.pid, _NICENESS)
            except OSError:  # it may have ended already
                pass

    @property
    def pid(self) -> int:
        """The child's process id, which is its process group's too (POSIX)."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.returncode

    def _start(
        self, command: Sequence[str], messages: Path, environment: Mapping[str, str] | None
    ) -> subprocess.Popen[bytes]:
        flags = 0
        if sys.platform == "win32":
            flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.BELOW_NORMAL_PRIORITY_CLASS
            flags |= subprocess.CREATE_NO_WINDOW  # a console would open, and closing it would end the engine
        self._log(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')} {' '.join(command)}")
        try:
            log = open(self.log, "ab")
        except OSError:
            log = open(os.devnull, "ab")
        with log, open(messages, "ab") as stdout:
            return subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=log,
                env=None if environment is None else dict(environment),
                start_new_session=True,  # ignored on Windows
                creationflags=flags,
            )

    def _alive(self) -> bool:
        return self._process.poll() is None

    def _signal(self, terminate: bool) -> None:
        try:
            if sys.platform == "win32":
                self._process.kill()
            else:
                os.killpg(self._process.pid, signal.SIGTERM if terminate else signal.SIGKILL)
        except (ProcessLookupError, PermissionError):  # macOS says EPERM for a group of zombies
            pass

    def _keep_stray(self, line: bytes) -> None:
        super()._keep_stray(line)
        self._log(line.decode("utf-8", "replace"))

    def _close(self) -> None:
        super()._close()
        if self._temporary is not None:
            self._temporary.unlink(missing_ok=True)


class AttachedEngine(Engine):
    """An engine that another process started and that still works in a run folder.

    Args:
        run: the run folder.
        found: the engine, from `find_engine`.

    Raises:
        OSError: its messages can't be read.
    """

    def __init__(self, run: RunFolder, found: Holder) -> None:
        super().__init__(run.messages(found.command[0]), run.log)
        self._run, self._found = run, found

    @property
    def pid(self) -> int:
        """The engine's process id."""
        return self._found.pid

    def _alive(self) -> bool:
        return holder(self._run) == self._found

    def _signal(self, terminate: bool) -> None:
        if not self._alive():  # the id may be another process's now
            return
        pid = self._found.pid
        try:
            if sys.platform == "win32":
                os.kill(pid, signal.SIGTERM)
                return
            number = signal.SIGTERM if terminate else signal.SIGKILL
            if os.getpgid(pid) == pid:
                os.killpg(pid, number)
            else:  # started by hand, in somebody else's group
                os.kill(pid, number)
        except (ProcessLookupError, PermissionError):
            pass


def find_engine(run: RunFolder) -> Holder | None:
    """The engine that works in a run folder, whoever started it, or None."""
    found = holder(run)
    return found if found is not None and found.command and run.messages(found.command[0]).exists() else None


def explain_death(returncode: int | None, last_line: str = "", file: Path | None = None) -> Message:
    """The `error` message for an engine that ended without one of its own.

    Args:
        returncode: as of `subprocess`: negative for a signal; 128 + signal from a shell; None if unknown.
        last_line: the last thing that the engine printed.
        file: a file on the disk on which it worked.
    """
    code = returncode or 0
    number = -code if code < 0 else code - 128 if 128 < code < 160 else 0
    if number == 9 or says_out_of_memory(last_line):
        text = "The engine was killed by the system (SIGKILL), most likely because memory ran out."
        return {
            "type": "error",
            "code": "out-of-memory",
            "text": text if number == 9 else "The engine ran out of memory.",
            "remedy": _OUT_OF_MEMORY_REMEDY,
        }
    if code == errno.ENOSPC or (file is not None and _is_full(file)):
        return {
            "type": "error",
            "code": "disk-full",
            "text": "The disk is full; the engine could not write its files.",
            "remedy": "Free some space and resume the run: finished stages are kept.",
        }
    try:
        how = f"was ended by the signal {signal.Signals(number).name}"
    except ValueError:
        how = "ended" if returncode is None else f"ended with exit status {returncode}"
    said = f"; its last line was: {last_line}" if last_line else ""
    return {
        "type": "error",
        "code": "engine-crashed",
        "text": f"The engine {how} without a message of its own{said}",
        "remedy": "Resume the run: finished stages are kept. If it happens again, log.txt in the run folder"
        " tells more.",
    }


def _is_full(path: Path) -> bool:
    try:
        return shutil.disk_usage(path.parent).free < _FULL_DISK_BYTES
    except OSError:
        return False


def _tail(log: Path) -> list[str]:
    """The log's last lines."""
    try:
        with open(log, "rb") as file:
            file.seek(max(os.fstat(file.fileno()).st_size - _TAIL_BYTES, 0))
            return [line.strip() for line in file.read().decode("utf-8", "replace").splitlines()]
    except OSError:
        return []
