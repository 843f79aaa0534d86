"""Files that others have written: read within limits; JSON as one of the `kinds` before anyone uses it.

A file may be cut off, edited by hand, written by another program or hostile. Every fault becomes one error
that names the file and the place in it. Standard library only.
"""

from __future__ import annotations

import codecs
import math
import stat
from pathlib import Path
from typing import Any

from .errors import FiptError
from .kinds import HeadError, T, as_kind

MOST_BYTES = 256_000_000  # of a JSON document
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def parse_document(text: str) -> Any:
    """A JSON value of a text.

    A number beyond a float's range, and NaN, are read as NaN, which no kind and no conversion to a whole
    number accepts; a whole number beyond 64 bits is a float.

    Args:
        text: of the document.

    Raises:
        ValueError: what is wrong with it; nesting without end included.
    """
    import json

    try:
        return json.loads(text, parse_constant=_number, parse_int=_whole, parse_float=_number)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def load_document(path: Path, kind: type[T]) -> T:
    """A JSON file as what it should be.

    Args:
        path: of the file.
        kind: see `kinds`.

    Raises:
        OSError: the system's.
        ValueError: what is wrong with the content.
    """
    return as_kind(parse_document(decoded(read_limited(path, MOST_BYTES))), kind)


def read_document(
    path: Path, kind: type[T], remedy: str = "Write it again.", other: str = "file-damaged"
) -> T:
    """The same, with errors for the user.

    Args:
        path: of the file.
        kind: see `kinds`.
        remedy: what the user can do where the file is damaged.
        other: code of the error for another document, or another version of its format.

    Raises:
        FiptError: ``file-missing``, ``file-damaged`` or `other`.
    """
    try:
        return load_document(path, kind)
    except FileNotFoundError:
        raise FiptError("file-missing.read-document", path=path) from None
    except (OSError, ValueError) as error:
        code = other if isinstance(error, HeadError) else "file-damaged"
        raise FiptError.of(code, f"{path} can't be read ({error}).", remedy) from None


def decoded(data: bytes, errors: str = "strict") -> str:
    """The text of a file: UTF-8, or UTF-16 by its byte-order mark; marks are no part of the text.

    Args:
        data: of the file.
        errors: see `bytes.decode`.

    Raises:
        ValueError: where it is no such text.
    """
    return data.decode("utf-16" if data.startswith(_UTF16_MARKS) else "utf-8-sig", errors)


def has_mark(path: Path) -> bool:
    """Whether a file begins with a byte-order mark."""
    with path.open("rb") as file:
        return file.read(3).startswith((*_UTF16_MARKS, codecs.BOM_UTF8))


def read_limited(path: Path, most: int) -> bytes:
    """The content of a file; all readers of whole files use this.

    Args:
        path: of the file.
        most: bytes that it may have.

    Raises:
        OSError: the system's.
        ValueError: for a larger file, and for a device or a pipe, whose reading may never end.
    """
    size = check_size(path, most)
    with path.open("rb") as file:
        data = file.read(size + 1)
    if len(data) > size:
        raise ValueError("it grows while it is read")
    return data


def check_size(path: Path, most: int) -> int:
    """The bytes of a regular file.

    Raises:
        OSError: the system's.
        ValueError: see `read_limited`.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("it is no regular file")
    if status.st_size > most:
        raise ValueError(f"it has {status.st_size / 1e9:.3g} GB, more than any such file should")
    return status.st_size


def optional_document(path: Path, kind: type[T]) -> T | None:
    """A JSON file as what it should be, None where it is missing or damaged; see `kinds`."""
    try:
        return load_document(path, kind)
    except (OSError, ValueError):
        return None


def _whole(text: str) -> float:
    # Converting a million digits would take minutes.
    return int(text) if len(text) <= 19 else _number(text)


def _number(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else math.nan
