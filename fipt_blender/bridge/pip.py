"""pip as a child process: progress from its output, and explanations of its failures.

pip's own configuration determines the sources of packages. Standard library only.
"""

from __future__ import annotations

import configparser
import os
import re
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from ..core.run.errors import FiptError
from .interpreter import answer, engine_environment

_OPTIONS = ("--no-input", "--disable-pip-version-check", "--progress-bar")
_RAW_SINCE = (24, 1)  # the first version of pip that prints its progress for programs
# Share of an installation's time for getting the packages: over an average network, and from a folder.
_DOWNLOAD_SHARE, _FOLDER_SHARE = 0.7, 0.05
_NETWORK_SIGNS = (
    *("NewConnectionError", "ConnectTimeout", "ReadTimeout", "name resolution", "getaddrinfo"),
    *("ProxyError", "SSLError", "CERTIFICATE_VERIFY_FAILED", "Network is unreachable", "Connection refused"),
)


def pip_settings() -> dict[str, str]:
    """The user's settings of pip for installing, by their names, as pip reads them: files, then variables."""
    home, roaming = Path(os.path.expanduser("~")), Path(os.environ.get("APPDATA", "~"))
    files = [
        *(Path("/etc/pip.conf"), Path(os.environ.get("PROGRAMDATA", "/etc"), "pip", "pip.ini")),
        *(home / ".pip" / "pip.conf", home / "Library" / "Application Support" / "pip" / "pip.conf"),
        Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config", "pip", "pip.conf"),
        *(roaming / "pip" / "pip.ini", Path(os.environ.get("PIP_CONFIG_FILE", os.devnull))),
    ]
    parser = configparser.ConfigParser(interpolation=None)
    with suppress(configparser.Error, UnicodeError):
        parser.read(files)
    values = {
        key: text for name in ("global", "install") if name in parser for key, text in parser[name].items()
    }
    names = ("find-links", "index-url", "extra-index-url")
    return values | {
        key: text for key in names if (text := os.environ.get(f"PIP_{key.upper().replace('-', '_')}"))
    }


class Teller(Protocol):
    """Receives the progress of set-up: the preferences, through messages, or a terminal."""

    def stage(self, name: str, text: str) -> None:
        """Begin the next stage."""

    def detail(self, text: str) -> None:
        """Describe what the current stage is doing."""

    def progress(self, stage_fraction: float) -> None:
        """Report which share of the current stage is done (0 to 1)."""

    def warning(self, key: str, /, **values: object) -> None:
        """Report a problem that does not stop set-up."""

    def log(self, line: str) -> None:
        """Write a line of pip's output to the log."""


_NEXT_LINE = "named in the next line"


class PipProgress:
    """Turns pip's output into texts and one fraction.

    Args:
        expected_gb: expected size of the downloads; 0 if packages come from a folder.
        tell: gets the progress.
        span: share of the stage before and after this run of pip.

    Attributes:
        errors: pip's error lines.
        mismatch: the package whose hash is not the one of the lock; "" for none.
        offline: whether pip's output indicates a problem of the network.
    """

    def __init__(self, expected_gb: float, tell: Teller, span: tuple[float, float] = (0.0, 1.0)) -> None:
        self.errors: list[str] = []
        self.mismatch = ""
        self.offline = False
        self.tell = tell
        self._expected = expected_gb * 1e9
        self._share = _DOWNLOAD_SHARE if expected_gb else _FOLDER_SHARE
        self._finished = 0.0
        self._size = 0.0
        self._span = span

    def line(self, line: str) -> None:
        """Process one line of pip's output."""
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
            self.tell.detail(f"Installing {text.count(',') + 1} packages")
            self._tell(self._share)
        elif self.mismatch == _NEXT_LINE:
            self.mismatch = text.partition(" from ")[0]
        elif "DO NOT MATCH THE HASHES" in text:
            self.mismatch = _NEXT_LINE
        elif text.startswith("ERROR:"):
            self.errors.append(text.removeprefix("ERROR:").strip())
        self.offline = self.offline or any(sign in text for sign in _NETWORK_SIGNS)

    def _progress(self, current: float) -> None:
        done = (self._finished + current) / max(self._expected, self._finished + self._size, 1.0)
        self._tell(self._share * min(done, 1.0))

    def _tell(self, fraction: float) -> None:
        low, high = self._span
        self.tell.progress(low + (high - low) * fraction)


class Pip:
    """pip of an environment, which installs wheels only.

    Args:
        python: the environment's interpreter.
        wheels: folder from which packages are installed; None: from the network.
        tell: gets the progress.
    """

    def __init__(self, python: Path, wheels: Path | None, tell: Teller) -> None:
        self._python, self._wheels, self._tell = python, wheels, tell
        version = re.findall(r"\d+", answer(python, "import pip; print(pip.__version__)") or "")
        self._bar = "raw" if tuple(map(int, version[:2])) >= _RAW_SINCE else "off"

    def run(self, *arguments: str, expected_gb: float = 0.0, span: tuple[float, float] = (0.0, 1.0)) -> None:
        """Run pip to its end.

        Args:
            arguments: e.g. ``"install", "numpy"``.
            expected_gb: expected size of the downloads from the network.
            span: share of the stage before and after it.

        Raises:
            FiptError: those of `pip_error`.
        """
        folder = ["--no-index", "--find-links", str(self._wheels)] if self._wheels else []
        command = [str(self._python), "-I", "-X", "utf8", "-m", "pip", arguments[0], *_OPTIONS, self._bar]
        command += ["--only-binary", ":all:", *folder, *arguments[1:]]
        progress = PipProgress(0.0 if self._wheels else expected_gb, self._tell, span)
        self._tell.log(f"--- pip {' '.join(arguments)}")
        with subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=engine_environment(self._python),
            encoding="utf-8",
            errors="replace",
        ) as child:
            for line in child.stdout or ():
                progress.line(line)
        if child.returncode:
            raise pip_error(progress, self._wheels)

    def run_locked(self, locked: Sequence[str], *arguments: str, **more: Any) -> None:
        """As `run`, for locked requirements, without what they need; pip refuses files with other hashes.

        Args:
            locked: lines of name, version, marker and hashes (`pins.read_pins`).
            arguments, more: see `run`.
        """
        with tempfile.TemporaryDirectory() as temporary:
            file = Path(temporary) / "engine.lock"
            file.write_text("\n".join(locked) + "\n", encoding="utf-8")
            self.run(*arguments, "--require-hashes", "--no-deps", "--requirement", str(file), **more)


def pip_error(progress: PipProgress, wheels: Path | None) -> FiptError:
    """The error that explains pip's failure to the user.

    Args:
        progress: that processed pip's output.
        wheels: the folder from which packages were installed; None: from the network.
    """
    reason = next((text for text in progress.errors if "No matching" in text), "")
    reason = reason or (progress.errors[-1] if progress.errors else "pip gave no reason")
    if any("No space left" in text or "Errno 28" in text for text in progress.errors):
        return FiptError("disk-full.pip-error")
    if progress.mismatch:
        return FiptError("package-hash.pip-error", mismatch=progress.mismatch)
    if wheels is not None:
        return FiptError("wheels-missing.pip-error", wheels=wheels, reason=reason)
    if progress.offline:
        return FiptError("network-missing", reason=reason)
    return FiptError("packages-failed", reason=reason)


def _bytes(size: str) -> float:
    """Bytes of a size as pip prints it, e.g. "530.2 MB"; 0 if it can't be read."""
    number, _, unit = size.partition(" ")
    try:
        return float(number) * {"kB": 1e3, "MB": 1e6, "GB": 1e9}.get(unit, 1.0)
    except ValueError:
        return 0.0
