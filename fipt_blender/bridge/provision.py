"""Fetching shared libraries that no Python package contains into an environment's own folder.

Packages are unpacked, never installed: this needs no root access and changes nothing in the system. Standard
library only.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

# Packages with the libraries that bpy and Dr.Jit link to on Linux, and the packages that those need.
DEBIAN_LIBRARIES = (
    *("libx11-6", "libxrender1", "libxfixes3", "libxi6", "libxkbcommon0", "libsm6", "libice6", "libgl1"),
    *("libegl1", "libglx0", "libglvnd0", "libxcb1", "libxau6", "libxdmcp6", "libxext6", "libuuid1"),
    *("libxxf86vm1", "libbsd0", "libmd0", "libatomic1"),
)


def wheel_libraries(wheel: Path, folder: Path, names: Sequence[str]) -> list[Path]:
    """Copy the shared libraries whose names start with one of `names` out of a wheel.

    Returns:
        The files written into `folder`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with zipfile.ZipFile(wheel) as archive:
        for member in archive.namelist():
            name = member.rpartition("/")[2]
            if ".so" not in name or not name.startswith(tuple(names)):
                continue
            data = archive.read(member)
            if data[:4] == b"\x7fELF":  # not a linker script of the same name
                (folder / name).write_bytes(data)
                written.append(folder / name)
    return written


class DebianPackages:
    """Packages of Debian or a derivative without root access: private lists, private cache, unpacked files.

    A context manager; the lists are fetched once.

    Attributes:
        available: whether this is such a system.
    """

    def __enter__(self) -> DebianPackages:
        self._temporary = tempfile.TemporaryDirectory(prefix="fipt-apt-")
        self._root = Path(self._temporary.name)
        self.available = all(shutil.which(tool) for tool in ("apt-get", "dpkg-deb", "dpkg-query"))
        if self.available:
            for name in ("lists/partial", "cache/archives/partial", "packages"):
                (self._root / name).mkdir(parents=True)
            self._apt("update")  # a source may fail, as long as the packages are found
        return self

    def __exit__(self, *exception: object) -> None:
        self._temporary.cleanup()

    def _apt(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        options = {
            "Dir::State::Lists": self._root / "lists",
            "Dir::Cache": self._root / "cache",
            "APT::Sandbox::User": "root",
            "APT::Update::Post-Invoke": "",
            "Debug::NoLocking": "true",
        }
        command = ["apt-get", "-q", *(f"-o{key}={value}" for key, value in options.items()), *arguments]
        return subprocess.run(
            command,
            cwd=self._root / "packages",
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )

    def missing(self, names: Sequence[str]) -> list[str]:
        """Those of the packages that are not installed."""
        command = ["dpkg-query", "-W", "-f", "${Package} ${db:Status-Status}\\n", *names]
        output = subprocess.run(command, capture_output=True, text=True, check=False).stdout
        installed = {line.split()[0] for line in output.splitlines() if line.endswith(" installed")}
        return [name for name in names if name not in installed]

    def unpack(self, names: Sequence[str]) -> Path | None:
        """Download packages and unpack them into a temporary folder, which is deleted with this object.

        Packages that the release does not have are skipped. Returns None if no package was downloaded.
        """
        downloads = self._root / "packages"
        for name in names:
            self._apt("download", name)
        root = Path(tempfile.mkdtemp(dir=self._root))
        archives = sorted(downloads.glob("*.deb"))
        for archive in archives:
            subprocess.run(["dpkg-deb", "-x", str(archive), str(root)], check=True)
            archive.unlink()
        return root if archives else None


def copy_libraries(root: Path, folder: Path) -> list[Path]:
    """Copy all shared libraries below `root` into `folder`, without subfolders, under all of their names.

    Returns:
        The files written into `folder`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for path in sorted(root.rglob("*.so*")):
        source = path
        if path.is_symlink():
            target = path.readlink()
            # absolute links refer to the unpacked tree, not to the system
            source = root / target.relative_to("/") if target.is_absolute() else path.parent / target
        copy = folder / path.name
        if not source.is_file() or copy.exists():
            continue
        shutil.copyfile(source, copy)
        written.append(copy)
    return written
