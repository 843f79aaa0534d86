"""Files found by the name that a person sees: the one search for photographs, masks and depth images.

Camera files name photographs as they lay on another computer: with other slashes, letters' case, accents and
suffixes. No such path is opened. Its parts are compared with the names that the capture's folders list, so
that no path leads out of them. Standard library only: Blender's side searches masks with it.
"""

from __future__ import annotations

import hashlib
import os
import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from itertools import chain, product
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from ..run.errors import FiptError
from .suffixes import HEIF_SUFFIXES, IMAGE_SUFFIXES, LINEAR_SUFFIXES, SUFFIXES

# What ends a name without being a part of it: "frame.0001" has no such suffix.
NAME_SUFFIXES = frozenset(
    (*SUFFIXES, ".jp2", ".avif", ".bmp", ".tga", ".gif", ".psd", ".dpx", ".ppm", ".pgm")
)
PHOTOGRAPHS_FIRST = (".exr",)  # cameras are often solved on tone-mapped copies: a.jpg may stand for a.exr
IDS_FIRST = (".exr", ".png")
DEPTHS_FIRST = (".png", ".exr")
MOST_FOLDERS = 5_000  # of a capture; larger ones are searched only where photographs are expected
MOST_PARTS = 8  # of a name, from its end
MOST_PART_BYTES = 120  # of one part of a view's name; file systems take 255 with suffix and number
# What images are that lie beside photographs, by a word of their name or of their folder's.
ROLES = {
    **dict.fromkeys(("depth", "depths", "depthmap", "depthmaps", "disparity"), "depth maps"),
    **dict.fromkeys(("confidence", "conf"), "confidence maps"),
    **dict.fromkeys(("normal", "normals", "normalmap", "normalmaps"), "normal maps"),
    **dict.fromkeys(("mask", "masks", "parts", "semantics"), "masks"),
    **dict.fromkeys(("contactsheet", "contactsheets", "thumbnail", "thumbnails", "thumbs"), "previews"),
}
_EDITED = re.compile(r"(?i)^(img_)e(\d+)$|^(.+)-edited$")  # what phones call edited copies: IMG_E0012
# What systems, network disks and their indexes put beside files: recycle bins, thumbnails, snapshots.
_OF_SYSTEMS = frozenset(
    (
        "@eadir",
        "#recycle",
        "@recycle",
        "$recycle.bin",
        "recycler",
        "recycled",
        "#snapshot",
        "@recently-snapshot",
    )
    + (
        "@__thumb",
        "__macosx",
        "lost+found",
        "system volume information",
        "found.000",
        "thumbs.db",
        "desktop.ini",
    )
)
# What programs put behind the name of a second copy: "a (1)", "a - Copy", "a (X's conflicted copy)".
_COPY = re.compile(
    r"(?i)^(.+?)(\s*\(\d+\)|[\s_-]+(copy|copie|kopie|copia)(\s*\(?\d+\)?)?|\s*\([^()]*conflict[^()]*\)"
    r"|[\s_.-]+(sync-)?conflict[\w-]*)$"
)
# What clients of clouds put behind the name of a file that they have not downloaded, and how to get it.
STUBS = {
    ".dvc": ("a DVC pointer", "Fetch the files themselves: dvc pull."),
    ".nextcloud": (
        "a placeholder of Nextcloud",
        "Make the folder always available locally (its context menu).",
    ),
    ".owncloud": (
        "a placeholder of ownCloud",
        "Make the folder always available locally (its context menu).",
    ),
    ".icloud": ("a placeholder of iCloud", "Download the files (Download Now in Finder)."),
    ".part": ("a download that was not finished", "Download the file again."),
    ".crdownload": ("a download that was not finished", "Download the file again."),
}
# How files begin that only stand for others, what they are, and how to get the others.
STAND_INS = (
    (rb"version https://git-lfs", "a Git LFS pointer", "Fetch the files themselves: git lfs pull."),
    (rb"[./]*/?annex/objects/", "a git-annex pointer", "Fetch the files themselves: git annex get."),
    (rb"\x00\x05\x16\x07", "a companion of macOS (AppleDouble)", "Copy the file without ._ in its name."),
    (rb"bplist00", "a placeholder of iCloud", "Download the files (Download Now in Finder)."),
    (rb"(?i)\s*<(!doctype )?html", "a web page", "Download the file itself."),
    (
        rb"[\w.~ -]*(/[\w.~() -]+)+\n?\Z",
        "a link that was copied as a text",
        "Copy the file that it names, or check out with links (git config core.symlinks true).",
    ),
)


def is_hidden(name: str) -> bool:
    """Whether a file or folder is no part of a capture by its name: hidden, ``._NAME``, or a recycle bin."""
    return name.startswith(".") or name.lower() in _OF_SYSTEMS


def copied_from(stem: str) -> str:
    """The stem of the file that a second copy was made of by its name; the stem itself for any other."""
    found = _COPY.match(stem)
    return found[1] if found else stem


def visible(folder: Path) -> list[Path]:
    """What lies in a folder, by name, without what is hidden; all readers list folders by this."""
    return sorted(path for path in folder.iterdir() if not is_hidden(path.name))


def stand_in(path: Path) -> FiptError | None:
    """The error for a file that only stands for another one, by its content; None for any other.

    It has the code ``file-stand-in``.
    """
    try:
        with path.open("rb") as file:
            start = file.read(512)
    except OSError:
        return None
    for begins, what, remedy in STAND_INS:
        if re.match(begins, start):
            return FiptError("file-stand-in", path=path, what=what, remedy=remedy)
    return None


def role(path: str) -> str:
    """What an image beside photographs is by its path, one of `ROLES`; "" for a photograph."""
    names = path.replace("\\", "/").lower().split("/")[-2:]
    words = [word for name in names for word in re.split(r"[^a-z]+", name)]
    return next((ROLES[word] for word in words if word in ROLES), "")


def original_of(stem: str) -> str:
    """The stem of the photograph that an edited copy was made of; "" for what is none by its name."""
    found = _EDITED.match(stem)
    return "" if found is None else found[3] or found[1] + found[2]


def key(name: str) -> str:
    """What names have in common that a person takes for the same: composed accents, lower case."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name.strip()).casefold())


def name_parts(name: str) -> tuple[str, ...]:
    """Folders and file name of a path as any system writes it, without what leads out of a folder."""
    parts: list[str] = []
    for part in name.replace("\\", "/").split("/"):
        if part == "..":
            del parts[-1:]
        elif (part := part.strip()) not in ("", ".") and not part.endswith(":") and "\0" not in part:
            parts.append(part)
    return tuple(parts[-MOST_PARTS:])


def is_plain(name: str) -> bool:
    """Whether a name is a path below a folder, neither absolute nor leading upwards."""
    path = PureWindowsPath(name)
    return not path.anchor and ".." not in path.parts


def suffix_of(name: str) -> str:
    """An image's suffix in lower case, "" of other names."""
    suffix = os.path.splitext(name)[1].lower()
    return suffix if suffix in NAME_SUFFIXES else ""


def stem_of(name: str) -> str:
    """A name without an image's suffix."""
    return name[: len(name) - len(suffix_of(name))]


def view_name(path: str) -> str:
    """A view's name from a file path: without suffix, relative, with composed accents.

    Files are named after views, so what no file system takes (control characters, halves of surrogate pairs,
    very long parts) is replaced.
    """
    text = path.encode("utf-8", errors="replace").decode("utf-8").replace("\\", "/")
    text = "".join(letter if letter.isprintable() else "_" for letter in unicodedata.normalize("NFC", text))
    parts = [part for part in PurePosixPath(stem_of(text)).parts if part not in ("..", ".")]
    kept = [part for part in parts if not part.endswith((":", "/"))]
    return "/".join(_shortened(part) for part in kept[-MOST_PARTS:]) or "view"


def _shortened(part: str) -> str:
    """A part of a name that also fits into a file name with a suffix; other long parts stay different."""
    data = part.encode("utf-8")
    if len(data) <= MOST_PART_BYTES:
        return part
    digest = hashlib.sha256(data).hexdigest()[:8]
    return f"{data[: MOST_PART_BYTES - 9].decode('utf-8', errors='ignore')}~{digest}"


class Found(NamedTuple):
    """A file, and the end of the name that led to it."""

    path: Path
    end: tuple[str, ...]


class Names:
    """Paths that are searched by their ends.

    Args:
        paths: with slashes.
    """

    def __init__(self, paths: Iterable[str]) -> None:
        self._by_key: dict[str, list[str]] = {}
        for path in paths:
            last = path.rpartition("/")[2]
            for each in {key(last), key(stem_of(last))}:
                self._by_key.setdefault(each, []).append(path)

    def ending(self, parts: Sequence[str], first: Sequence[str] = PHOTOGRAPHS_FIRST) -> list[tuple]:
        """The paths that end with these parts, with their ranks: the lowest one fits best.

        A name fits without its suffix, or with another one behind it (``a.jpg.png``).

        Args:
            parts: of a name, the file's last.
            first: suffixes that are preferred to that of the name itself.
        """
        *folders, last = parts
        keys = key(last), key(stem_of(last))
        paths = dict.fromkeys(path for each in keys for path in self._by_key.get(each, ()))
        if not paths:
            return []
        wanted = [key(folder) for folder in folders]
        spelled = unicodedata.normalize("NFC", stem_of("/".join(parts)))
        found = []
        for path in paths:
            own = path.split("/")[-len(parts) :]
            if [key(folder) for folder in own[:-1]] != wanted:
                continue
            other = unicodedata.normalize("NFC", stem_of("/".join(own))) != spelled
            found.append(((_rank(own[-1], last, first), other), path))
        return found

    def find(self, name: str) -> str | None:
        """The path that ends like a name, as far as possible; None without one."""
        parts = name_parts(name)
        for tail in (parts[start:] for start in range(len(parts))):
            ranked = self.ending(tail)
            best = [path for rank, path in ranked if rank == min(ranked)[0]]
            if len(best) > 1:
                raise ambiguous(name, best)
            if best:
                return best[0]
        return None


def _rank(name: str, wanted: str, first: Sequence[str]) -> int:
    """How well a file's suffix fits a name: preferred, the name's own, HDR, other photographs, the rest."""
    suffix = suffix_of(name)
    if suffix in first:
        return first.index(suffix)
    if key(name) == key(wanted):
        return len(first)
    if suffix in LINEAR_SUFFIXES:
        return len(first) + 1
    return len(first) + (2 if suffix in IMAGE_SUFFIXES and suffix not in HEIF_SUFFIXES else 3)


class Folders:
    """Folders as they were when they were first listed."""

    def __init__(self) -> None:
        self._listed: dict[Path, tuple[dict[str, list[str]], list[str], Names]] = {}
        self._below: dict[Path, tuple[list[str], Names]] = {}

    def find(
        self,
        name: str,
        places: Sequence[Path],
        inside: Path | None = None,
        first: Sequence[str] = PHOTOGRAPHS_FIRST,
        fits: Callable[[Path], bool] | None = None,
    ) -> Found | None:
        """The file of a name; None without one.

        Args:
            name: a path as any system writes it. Its longest end that fits decides.
            places: folders in which it is expected, the best first.
            inside: folder that is searched with all its subfolders, too.
            first: see `Names.ending`.
            fits: tells of a file whether it is the right one; asked where there are several.
        """
        parts = name_parts(name)
        for tail in (parts[start:] for start in range(len(parts))):
            found = [
                (*rank, order, folder / path)
                for order, place in enumerate(places)
                for folder in self._subfolders(place, tail[:-1])
                for rank, path in self._list(folder)[2].ending(tail[-1:], first)
            ]
            if not found and inside is not None:
                ending = self._walk(inside)[1].ending(tail, first)
                found = [(*rank, 0, inside / path) for rank, path in ending]
            best = [item for item in sorted(found) if item[:2] == min(found)[:2]]
            if len(best) > 1 and fits is not None:
                best = [item for item in best if fits(item[-1])] or best
            best = [item for item in best if item[2] == best[0][2]]
            if len(best) > 1:
                raise ambiguous(name, [item[-1] for item in best])
            if best:
                return Found(best[0][-1], tail)
        return None

    def ids(self, folder: Path, names: Sequence[str]) -> Path | None:
        """The id image in a folder that has one of a view's names, or None.

        Args:
            folder: searched with its subfolders, unless the first name tells in which one it is.
            names: the best first.
        """
        if not any(self._list(folder)[:2]):
            return None
        inside = None if "/" in names[0] else folder
        found = (self.find(name, [folder], inside, IDS_FIRST) for name in names)
        return next((each.path for each in found if each), None)

    def stub(self, name: str, folders: Iterable[Path]) -> FiptError | None:
        """The error for a file that lies in a folder, or on its path below it, as a stub; None without."""
        parts = name_parts(name)
        for folder, start in product(folders, range(len(parts))):
            for suffix, (what, remedy) in STUBS.items():
                path = folder.joinpath(*parts[start:])
                for each in (path.with_name(path.name + suffix), path.with_name(f".{path.name}{suffix}")):
                    if each.is_file():
                        return FiptError("file-stand-in", path=each, what=what, remedy=remedy)
        return None

    def images(self, folder: Path, below: bool = False) -> list[Path]:
        """The image files in a folder, or also in those below it, by name."""
        names = self._walk(folder)[0] if below else self._list(folder)[1]
        return sorted(folder / name for name in names if suffix_of(name))

    def files(self, folder: Path, suffix: str) -> list[Path]:
        """The files in a folder and those below it with a suffix."""
        return sorted(folder / name for name in self._walk(folder)[0] if name.lower().endswith(suffix))

    def _list(self, folder: Path) -> tuple[dict[str, list[str]], list[str], Names]:
        """Names of a folder's folders by key, and of its files; none where it does not exist."""
        if folder not in self._listed:
            folders: dict[str, list[str]] = {}
            files: list[str] = []
            try:
                with os.scandir(folder) as entries:
                    for entry in entries:
                        if is_hidden(entry.name):
                            continue
                        if entry.is_dir():
                            folders.setdefault(key(entry.name), []).append(entry.name)
                        elif entry.is_file():  # not a pipe, whose reading may never end
                            files.append(entry.name)
            except (FileNotFoundError, NotADirectoryError):
                pass
            self._listed[folder] = folders, files, Names(files)
        return self._listed[folder]

    def _subfolders(self, folder: Path, parts: Sequence[str]) -> list[Path]:
        """The folders at a path below a folder; several where only names of another case fit."""
        found = [folder]
        for part in parts:
            named = [each / name for each in found for name in self._list(each)[0].get(key(part), ())]
            found = [each for each in named if each.name == part] or named
        return found

    def _walk(self, root: Path) -> tuple[list[str], Names]:
        """Paths of all files below a folder, none of those of runs and hidden folders."""
        if root not in self._below:
            todo, seen, paths = [(root, "")], {os.path.realpath(root)}, []
            for folder, path in todo:  # grows
                try:
                    folders, files, _ = self._list(folder)
                except PermissionError:
                    if path:  # a subfolder where nothing is expected
                        continue
                    raise
                if path and "run.json" in files:
                    continue
                paths += [path + name for name in files]
                for name in sorted(chain.from_iterable(folders.values())):
                    real = os.path.realpath(folder / name)
                    if key(name) not in ROLES and real not in seen:
                        seen.add(real)
                        todo.append((folder / name, f"{path}{name}/"))
                if len(todo) > MOST_FOLDERS:
                    paths = []
                    break
            self._below[root] = paths, Names(paths)
        return self._below[root]


def ambiguous(name: str, paths: Sequence[object]) -> FiptError:
    """The error for a name that fits several files or views."""
    shown = ", ".join(map(str, paths[:5])) + (" and others" if len(paths) > 5 else "")
    return FiptError("file-ambiguous.ambiguous", name=name[:200], number_of_paths=len(paths), shown=shown)
