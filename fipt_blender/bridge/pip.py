# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""pip as a child process: its output as progress by bytes and packages, its failures in words.

pip's own configuration decides from where packages come. Standard library only.
"""

from __future__ import annotations

import queue
import re
import subprocess
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Protocol

from ..core.job.errors import FiptError
from .interpreter import engine_environment

_OPTIONS = ("--no-input", "--disable-pip-version-check", "--progress-bar")
_RAW_SINCE = (24, 1)  # from this version on pip tells its progress for programs to read
# Of the time of an installation: over a usual network, and from a folder.
_DOWNLOAD_SHARE, _FOLDER_SHARE = 0.7, 0.05
_WATCH_SECONDS = 1.0
_NETWORK_SIGNS = (
    *("NewConnectionError", "ConnectTimeout", "ReadTimeout", "name resolution", "getaddrinfo"),
    *("ProxyError", "SSLError", "CERTIFICATE_VERIFY_FAILED", "Network is unreachable", "Connection refused"),
)


class Teller(Protocol):
    """Who hears of the progress of set-up: the preferences, through messages, or a terminal."""

    def stage(self, name: str, text: str) -> None:
        """Begin the next stage."""

    def detail(self, text: str) -> None:
        """Say what the running stage does now."""

    def progress(self, stage_fraction: float) -> None:
        """Say how much of the running stage is done."""

    def warning(self, code: str, text: str, remedy: str) -> None:
        """Say what did not go as it should; set-up goes on."""

    def log(self, line: str) -> None:
        """Keep a line of pip's output."""


class PipProgress:
    """Turns pip's lines into texts and one fraction.

    Args:
        packages: the folder into which it installs.
        expected_gb: about how much will be downloaded; 0 where all comes from a folder.
        tell: who hears of it.
    """

    def __init__(self, packages: Path, expected_gb: float, tell: Teller) -> None:
        self.errors: list[str] = []
        self.offline = False
        self.tell = tell
        self._expected = expected_gb * 1e9
        self._share = _DOWNLOAD_SHARE if expected_gb else _FOLDER_SHARE
        self._finished = 0.0
        self._size = 0.0
        self._packages = packages
        self._count = self._before = 0

    def line(self, line: str) -> None:
        """Take one line of pip's output."""
        if match := re.match(r"Progress (\d+) of (\d+)", line):
            self._progress(float(match.group(1)))
            return
        text = line.strip()
        self.tell.log(text)
        if match := re.match(r"(Downloading|Using cached) (\S+)-\S+?\.(?:whl|tar\.gz) \((\S+ \w+)\)", text):
            name, _, version = match.group(2).partition("-")
            version = version.split("-")[0]
            self._finished += self._size
            self._size = _bytes(match.group(3))
            verb = "Downloading" if match.group(1) == "Downloading" else "Taking from pip's cache"
            self.tell.detail(f"{verb}: {name.rpartition('/')[2]} {version} ({match.group(3)})")
            self._progress(0.0)
        elif text.startswith("Installing collected packages:"):
            self._count = text.count(",") + 1
            self._before = len(list(self._packages.glob("*.dist-info")))
            self.tell.detail(f"Installing {self._count} packages")
            self.watch()
        elif text.startswith("ERROR:"):
            self.errors.append(text.removeprefix("ERROR:").strip())
        self.offline = self.offline or any(sign in text for sign in _NETWORK_SIGNS)

    def watch(self) -> None:
        """Look how many packages are installed, while pip itself is silent about it."""
        if self._count:
            done = len(list(self._packages.glob("*.dist-info"))) - self._before
            share = min(max(done / self._count, 0.0), 1.0)
            self.tell.progress(self._share + (1.0 - self._share) * share)

    def _progress(self, current: float) -> None:
        done = (self._finished + current) / max(self._expected, self._finished + self._size, 1.0)
        self.tell.progress(self._share * min(done, 1.0))


def progress_bar(version: str) -> str:
    """The kind of progress that a version of pip is asked for."""
    numbers = tuple(int(part) for part in re.findall(r"\d+", version)[:2])
    return "raw" if numbers >= _RAW_SINCE else "off"


def run_pip(python: Path, arguments: Sequence[str], progress: PipProgress, bar: str = "off") -> int:
    """Run pip to its end and return its exit status.

    Args:
        python: the environment's interpreter.
        arguments: of pip, e.g. ``["install", "numpy"]``.
        progress: takes its output.
        bar: see `progress_bar`.
    """
    pip = [str(python), "-I", "-X", "utf8", "-m", "pip"]
    command = [*pip, arguments[0], *(() if arguments[0] == "uninstall" else (*_OPTIONS, bar)), *arguments[1:]]
    progress.tell.log(f"--- pip {' '.join(arguments)}")
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=engine_environment(python),
        encoding="utf-8",
        errors="replace",
    ) as child:
        lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=_read, args=(child.stdout or (), lines), daemon=True).start()
        while True:
            try:
                line = lines.get(timeout=_WATCH_SECONDS)
            except queue.Empty:
                progress.watch()
                continue
            if line is None:
                break
            progress.line(line)
    return child.returncode


def _read(stream: Iterable[str], lines: queue.SimpleQueue[str | None]) -> None:
    for line in stream:
        lines.put(line)
    lines.put(None)


def pip_error(progress: PipProgress, wheels: Path | None) -> FiptError:
    """What pip's failure means for the user.

    Args:
        progress: that took its output.
        wheels: the folder that it installed from, None for the network.
    """
    said = next((text for text in progress.errors if "No matching" in text), "")
    said = said or (progress.errors[-1] if progress.errors else "pip gave no reason")
    if any("No space left" in text or "Errno 28" in text for text in progress.errors):
        return FiptError(
            "disk-full",
            "The disk is full; the engine's packages could not be installed.",
            "Free some space, or move the data folder to another disk, and set up again: downloads are kept.",
        )
    if wheels is not None:
        return FiptError(
            "wheels-missing",
            f"The folder of wheels {wheels} does not have all packages: {said}",
            "Fill it anew with the command that Copy Download Command gives, on a machine with network.",
        )
    if progress.offline:
        return FiptError(
            "network-missing",
            f"The engine's packages could not be downloaded: {said}",
            "Check the network, or the proxy (HTTPS_PROXY), or install from a folder of wheels; then set up"
            " again: what was downloaded is kept.",
        )
    return FiptError(
        "packages-failed",
        f"The engine's packages could not be installed: {said}",
        "The log tells more. If your studio has a package index of its own, see to its having them.",
    )


def _bytes(size: str) -> float:
    """A size as pip writes it: "530.2 MB"."""
    number, _, unit = size.partition(" ")
    try:
        return float(number) * {"kB": 1e3, "MB": 1e6, "GB": 1e9}.get(unit, 1.0)
    except ValueError:
        return 0.0
