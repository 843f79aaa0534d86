# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that others have written: read within limits; JSON checked against a shape before anyone uses it.

A file may be cut off, edited by hand, written by another program or hostile. Every fault becomes one error
that names the file and the place in it. Standard library only.

A shape is a type or one of this module's classes: ``str``, ``bool``, ``int``, ``float`` (whole numbers pass),
``dict`` and ``list`` (any content), `Choice`, `Maybe`, `Number`, `Numbers`, `FileName`, `Items`, `Entries`,
`Fields`.
"""

from __future__ import annotations

import codecs
import math
import stat
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import FiptError
from .kinds import HeadError, ShapeError, T, as_kind
from .kinds import head as head

MOST_BYTES = 256_000_000  # of a JSON document
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


@dataclass(frozen=True)
class Number:
    """A finite number within bounds, both included; whole numbers only where `whole`."""

    low: float = -math.inf
    high: float = math.inf
    whole: bool = False


@dataclass(frozen=True)
class Numbers:
    """A nested list of finite numbers: lengths from the outside to the inside, None for any.

    ``Numbers(4, 4)`` is a matrix, ``Numbers(None, 3)`` a list of points; none is larger than `most`, nor its
    negative.
    """

    lengths: tuple[int | None, ...]
    most: float

    def __init__(self, *lengths: int | None, most: float = sys.float_info.max) -> None:
        object.__setattr__(self, "lengths", lengths)
        object.__setattr__(self, "most", most)


@dataclass(frozen=True)
class Choice:
    """One of these values."""

    values: tuple[Any, ...]

    def __init__(self, *values: Any) -> None:
        object.__setattr__(self, "values", values)


@dataclass(frozen=True)
class FileName:
    """A text that names a file within a folder, on every system."""


@dataclass(frozen=True)
class Maybe:
    """The shape, or null."""

    shape: Any


@dataclass(frozen=True)
class Items:
    """A list whose items all have one shape."""

    shape: Any
    least: int = 0


@dataclass(frozen=True)
class Entries:
    """An object with any names whose values all have one shape."""

    shape: Any


@dataclass(frozen=True)
class Fields:
    """An object with these fields; others are let pass.

    Attributes:
        needed: shape by name of fields that must be there.
        optional: of fields that may be missing.
    """

    needed: Mapping[str, Any] = field(default_factory=dict)
    optional: Mapping[str, Any] = field(default_factory=dict)


def parse_document(text: str, strict: bool = True) -> Any:
    """A JSON value of a text.

    Args:
        text: of the document.
        strict: refuse NaN, infinities, and numbers beyond 64 bits or a float's range anywhere. Files of other
            programs may hold them in fields that nobody reads: there such a number is read as NaN, which no
            shape and no conversion to a whole number accepts, and a larger whole number as a float.

    Raises:
        ValueError: what is wrong with it; nesting without end included.
    """
    import json

    try:
        if not strict:
            return json.loads(text, parse_constant=_nan, parse_int=_any_whole, parse_float=_any_number)
        return json.loads(text, parse_constant=_refuse_constant, parse_int=_whole, parse_float=_finite)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def load_document(path: Path, shape: Any = dict, strict: bool = True) -> Any:
    """Read a JSON file and check its shape.

    Args:
        path: of the file.
        shape: what it must hold; see the module.
        strict: see `parse_document`.

    Raises:
        OSError: the system's.
        ValueError: what is wrong with the content.
    """
    data = parse_document(decoded(read_limited(path, MOST_BYTES)), strict)
    if not isinstance(shape, (Fields, Items, Entries)):
        return as_kind(data, shape)
    check_shape(data, shape)
    return data


def read_document(
    path: Path, kind: type[T], remedy: str = "Write it again.", other: str = "file-damaged"
) -> T:
    """A JSON file as what it should be, with errors for the user.

    Args:
        path: of the file.
        kind: see `kinds`.
        remedy: what the user can do where the file is damaged.
        other: code of the error for another document, or another version of its format.

    Raises:
        FiptError: ``file-missing``, ``file-damaged`` or `other`.
    """
    try:
        result: T = load_document(path, kind)
        return result
    except FileNotFoundError:
        raise FiptError("file-missing", f"{path} does not exist.", "Run the step that writes it.") from None
    except (OSError, ValueError) as error:
        code = other if isinstance(error, HeadError) else "file-damaged"
        raise FiptError(code, f"{path} can't be read ({error}).", remedy) from None


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


def read_json(path: Path, shape: Any = dict, remedy: str = "Write it again.") -> Any:
    """The same, with an error for the user.

    Args:
        path, shape: see `load_document`.
        remedy: what the user can do where the file is damaged.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    try:
        return load_document(path, shape)
    except FileNotFoundError:
        raise FiptError("file-missing", f"{path} does not exist.", "Run the step that writes it.") from None
    except (OSError, ValueError) as error:
        raise FiptError("file-damaged", f"{path} can't be read ({error}).", remedy) from None


def check_shape(value: Any, shape: Any, place: str = "") -> None:
    """Check a JSON value against a shape.

    Args:
        value: of a parsed document.
        shape: see the module.
        place: how to reach the value from the document's root, e.g. ``views[3].fx``.

    Raises:
        ShapeError: names the place, what is needed and what is there.
    """
    problem = _problem(value, shape, place)
    if problem is not None:
        where, needed, found = problem
        raise ShapeError(f"{where or 'the document'} should be {needed}, not {_described(found)}")


def _problem(value: Any, shape: Any, place: str) -> tuple[str, str, Any] | None:
    """(place, what is needed, what is there) of the first fault, None without one."""
    if isinstance(shape, Maybe):
        return None if value is None else _problem(value, shape.shape, place)
    if isinstance(shape, Fields):
        return _field_problem(value, shape, place)
    if isinstance(shape, Items):
        if not isinstance(value, list):
            return place, "a list", value
        if len(value) < shape.least:
            return place, f"a list of {shape.least} or more", value
        problems = (_problem(item, shape.shape, f"{place}[{i}]") for i, item in enumerate(value))
        return next((problem for problem in problems if problem is not None), None)
    if isinstance(shape, Entries):
        if not isinstance(value, dict):
            return place, "an object", value
        return _field_problem(value, Fields(dict.fromkeys(value, shape.shape)), place)
    if isinstance(shape, FileName):
        return None if _is_file_name(value) else (place, "a file name", value)
    if isinstance(shape, Numbers):
        fits = _are_numbers(value, shape.lengths, shape.most)
        return None if fits else (place, _numbers_text(shape), value)
    if isinstance(shape, Choice):
        fits = any(
            value is choice or (type(value) is type(choice) and value == choice) for choice in shape.values
        )
        return None if fits else (place, f"one of {', '.join(map(repr, shape.values))}", value)
    if isinstance(shape, Number):
        kinds = (int,) if shape.whole else (int, float)
        if isinstance(value, kinds) and not isinstance(value, bool) and shape.low <= value <= shape.high:
            return None
        return place, _number_text(shape), value
    if shape in (int, float):
        return _problem(value, Number(whole=shape is int), place)
    return None if isinstance(value, shape) else (place, _TYPE_TEXTS[shape], value)


def _field_problem(value: Any, shape: Fields, place: str) -> tuple[str, str, Any] | None:
    if not isinstance(value, dict):
        return place, "an object", value
    for names, is_needed in ((shape.needed, True), (shape.optional, False)):
        for name, inner in names.items():
            where = f"{place}.{name}" if place else name
            if name in value:
                problem = _problem(value[name], inner, where)
                if problem is not None:
                    return problem
            elif is_needed:
                return where, "there", _MISSING
    return None


def _are_numbers(value: Any, lengths: tuple[int | None, ...], most: float) -> bool:
    if not lengths:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and -most <= value <= most
    fits = isinstance(value, list) and lengths[0] in (None, len(value))
    return fits and all(_are_numbers(item, lengths[1:], most) for item in value)


def _is_file_name(value: Any) -> bool:
    """Whether a value names a file in a folder: no path, nothing that a system reserves, and not too long."""
    if not isinstance(value, str) or not value.isprintable() or value.strip(" .") != value or not value:
        return False
    # File systems allow 255, with suffixes.
    return len(value.encode()) <= 200 and not set(value) & set('/\\:*?"<>|')


def _numbers_text(shape: Numbers) -> str:
    sizes = " x ".join("N" if length is None else str(length) for length in shape.lengths)
    limit = f" up to {shape.most:g}" if shape.most < sys.float_info.max else ""
    return f"a list of {sizes} finite numbers{limit}"


def _number_text(shape: Number) -> str:
    text = "a whole number" if shape.whole else "a number"
    if shape.low > -math.inf and shape.high < math.inf:
        return f"{text} from {shape.low:g} to {shape.high:g}"
    if shape.low > -math.inf:
        return f"{text} of at least {shape.low:g}"
    return text if shape.high == math.inf else f"{text} of at most {shape.high:g}"


def _described(value: Any) -> str:
    if value is _MISSING:
        return "missing"
    if value is None:
        return "null"
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _nan(_: str) -> float:
    return math.nan


def _any_whole(text: str) -> float:
    """A whole number; beyond 64 bits a float, and NaN beyond a float's range."""
    return int(text) if len(text) <= 19 else _any_number(text)


def _any_number(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else math.nan


def _refuse_constant(text: str) -> float:
    raise ValueError(f"it holds {text}, which is no number of JSON")


def _whole(text: str) -> int:
    # The length first: converting a million digits would take minutes.
    if len(text) > 20 or abs(int(text)) > 2**63 - 1:  # every id, size and count that we read fits
        raise ValueError(f"the number {text[:20]}{'...' if len(text) > 20 else ''} is too large")
    return int(text)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:20]} is too large")
    return value


_MISSING = object()
_TYPE_TEXTS = {str: "a text", bool: "true or false", dict: "an object", list: "a list"}
