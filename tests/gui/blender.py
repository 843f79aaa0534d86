# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A real Blender in a window on a separate screen (Xvfb); it answers questions through the agent."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

_AGENT = Path(__file__).with_name("agent.py")
_START_SECONDS = 120.0
_LEAVE_SECONDS = 30.0


class Lost(AssertionError):
    """An expected button, window or condition did not appear."""


class Blender:
    """Blender with its screen; both end with the `with` block.

    Args:
        blender: the executable.
        shots: folder of the pictures and of blender.log.
        extension: a zip to install before the start; the user's folders are empty and of this window alone.
        inside: Python files whose functions `ask` and `wait` may call as `file.function`.
        environment: variables added to Blender's.
        size: of the screen and the window, pixels.
        arguments: further ones for Blender.
    """

    def __init__(
        self,
        blender: str,
        shots: Path,
        *,
        extension: Path | None = None,
        inside: Iterable[Path] = (),
        environment: dict[str, str] | None = None,
        size: tuple[int, int] = (1600, 900),
        arguments: Iterable[str] = (),
    ) -> None:
        self.shots = shots
        self._blender, self._extension = blender, extension
        self._inside = [str(Path(file).resolve()) for file in inside]
        self._environment, self._arguments = environment or {}, list(arguments)
        self.width, self.height = size
        self._folder = tempfile.TemporaryDirectory(prefix="fipt-gui-")
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Blender:
        self.shots.mkdir(parents=True, exist_ok=True)
        self._log = (self.shots / "blender.log").open("wb")
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        if error and error[0] is not None and self._process is not None:
            with contextlib.suppress(Lost):
                self.ask("picture", str(self.shots.resolve() / "failed.png"))
        if self._process is not None and self._process.poll() is None:
            try:
                self.ask("leave")
                self._process.wait(_LEAVE_SECONDS)
            except (OSError, Lost, subprocess.TimeoutExpired):
                os.killpg(self._process.pid, signal.SIGTERM)  # the screen as well
                self._process.wait()
        self._log.close()
        self._folder.cleanup()

    def ask(self, call: str, *arguments: Any, ticks: int = 0) -> Any:
        """The answer of a function inside Blender: one of the agent's, or `file.function`.

        Args:
            ticks: rounds of Blender's main loop to let pass before.

        Raises:
            Lost: the function raised, or Blender has ended.
        """
        question = {"call": call, "arguments": arguments, "ticks": ticks}
        try:
            self._stream.write(json.dumps(question) + "\n")
            self._stream.flush()
            line = self._stream.readline()
        except OSError as error:
            raise Lost(f"Blender does not answer {call}: {error}") from None
        if not line:
            raise Lost(f"Blender ended while answering {call}; see {self.shots / 'blender.log'}")
        answer = json.loads(line)
        if "error" in answer:
            raise Lost(answer["error"])
        return answer["result"]

    def wait(
        self,
        call: str,
        *arguments: Any,
        seconds: float = 20.0,
        until: Callable[[Any], bool] = bool,
        every: float = 0.05,
    ) -> Any:
        """Ask until the answer is true (or satisfies `until`); returns the answer.

        Raises:
            Lost: it did not come true in time.
        """
        end = time.monotonic() + seconds
        while True:
            answer = self.ask(call, *arguments)
            if until(answer):
                return answer
            if time.monotonic() > end:
                raise Lost(f"{call}{arguments} was {answer!r} after {seconds:g} seconds")
            time.sleep(every)

    def _start(self) -> None:
        folder = Path(self._folder.name)
        address = str(folder / "socket")
        variables = {
            **os.environ,
            "BLENDER_USER_RESOURCES": str(folder / "blender"),
            "FIPT_GUI_SOCKET": address,
            "FIPT_GUI_INSIDE": os.pathsep.join(self._inside),
            **self._environment,
        }
        variables.pop("WAYLAND_DISPLAY", None)
        if self._extension is not None:
            install = ["--command", "extension", "install-file", "-r", "user_default", "-e"]
            result = subprocess.run(
                [self._blender, *install, str(self._extension)],
                env=variables,
                stdout=self._log,
                stderr=subprocess.STDOUT,
                check=False,
            )
            if result.returncode:
                raise Lost(f"the extension can't be installed; see {self.shots / 'blender.log'}")
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(address)
        listener.listen(1)
        listener.settimeout(1.0)
        screen = ["xvfb-run", "-a", "-s", f"-screen 0 {self.width}x{self.height}x24 +extension GLX"]
        window = ["--window-geometry", "0", "0", str(self.width), str(self.height), "--enable-event-simulate"]
        self._process = subprocess.Popen(
            [*screen, self._blender, *window, *self._arguments, "--python", str(_AGENT)],
            env=variables,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        end = time.monotonic() + _START_SECONDS
        while True:
            try:
                connection, _ = listener.accept()
                break
            except TimeoutError:
                if self._process.poll() is not None or time.monotonic() > end:
                    raise Lost(f"Blender did not start; see {self.shots / 'blender.log'}") from None
        listener.close()
        self._stream = connection.makefile("rw", encoding="utf-8")
        self.ask("redraws", ticks=5)
