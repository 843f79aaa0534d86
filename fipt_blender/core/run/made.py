"""Files that are made once: a run folder's made/NAME.json has the key of what they were made from.

The stages of an estimation have keys of their own (:mod:`.chain`). Standard library only.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .contents import Problem
from .documents import optional_document
from .messages import Reporter
from .method import digest, method_digest
from .runfolder import RunFolder, explained_write_errors, write_json


@dataclass(frozen=True)
class MadeNote:
    """made/NAME.json."""

    key: str
    warnings: tuple[Problem, ...] = ()


class Made:
    """Whether files of a run are still those that would be made now.

    Args:
        run: the run folder.
        name: of the files, e.g. "textures".
        facts: what they are made from besides the engine's code; JSON-serialisable, or by its text.
        outputs: files or folders that must exist.
    """

    def __init__(self, run: RunFolder, name: str, *facts: Any, outputs: Sequence[Path]) -> None:
        self._key = digest(method_digest(), *facts, default=str)
        self._path = run.made(name)
        self._outputs = outputs

    def kept(self) -> tuple[Problem, ...] | None:
        """What their making has warned of, if they are; else None."""
        note = optional_document(self._path, MadeNote)
        if note is None or note.key != self._key or not all(path.exists() for path in self._outputs):
            return None
        return note.warnings

    @contextmanager
    def making(self, warnings: Iterable[Mapping[str, str]] = ()) -> Iterator[None]:
        """The block makes them. No key stands for files that are half of one kind and half of another: the
        former key is removed first, and theirs is written in the end with the warnings that are there then.
        """
        with explained_write_errors(self._path):
            self._path.unlink(missing_ok=True)
        yield
        problems = (Problem(each["code"], each["text"], each["remedy"]) for each in warnings)
        write_json(self._path, MadeNote(self._key, tuple(problems)))

    def told_again(self, reporter: Reporter) -> bool:
        """Whether they are; the reporter then gets the warnings of their making again."""
        warnings = self.kept()
        for warning in warnings or ():
            reporter.warn(warning)
        return warnings is not None


def content_digest(*paths: Path) -> str:
    """Digest of the content of files, which may be missing."""
    content = hashlib.sha256()
    for path in paths:
        content.update(path.read_bytes() if path.exists() else b"missing")
    return content.hexdigest()


def folder_states(path: Path | None, exclude: Path) -> list[str]:
    """Name, size and time of change of all files below a folder: reading them takes too long.

    Args:
        path: folder, or a file in it (a camera file names images there); None or missing: no files.
        exclude: folder that is left out, because the files are made there.
    """
    if path is None or not path.exists():
        return []
    excluded, states = os.path.realpath(exclude), [str(path)]
    for parent, folders, names in os.walk(os.path.realpath(path if path.is_dir() else path.parent)):
        folders[:] = [name for name in folders if os.path.join(parent, name) != excluded]
        states += [file_state(Path(parent, name)) for name in names]
    return sorted(filter(None, states))


def file_state(file: Path | None) -> str:
    """Name, size and time of change of a file; None or missing: ""."""
    stamp = file_stamp(file)
    return stamp and f"{file}|{stamp}"


def file_stamp(file: Path | None) -> str:
    """Size and time of change of a file; None or missing: "", for a link's target may come and go."""
    try:
        status = None if file is None else file.stat()
    except (OSError, ValueError):  # also names that no file can have
        status = None
    return "" if status is None else f"{status.st_size}|{status.st_mtime_ns}"
