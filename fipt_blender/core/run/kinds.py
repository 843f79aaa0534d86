# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON values as frozen dataclasses, checked while they are read. Standard library only.

A kind is a type: ``str``, ``bool``, ``int``, ``float`` (whole numbers pass), ``Any``, ``X | None`` (null),
``tuple[X, ...]`` (a list), ``tuple[float, float, float]`` (numbers of this count; nested ones are matrices),
``dict`` and ``list`` (any content), ``Mapping[str, X]`` or ``dict[str, X]`` (an object with any names), or a
dataclass (an object with these names; others are let pass; fields with a default may be missing).
``Annotated[X, ...]`` adds `Choice`, `Number`, `Least`, `FileName` or `Key`. A dataclass with the class
attribute ``document`` is a whole document of ours and begins with its `head`.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, TypeVar

from .shapes import MOST_SIDE

T = TypeVar("T")
Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]
_MISSING = object()
_TYPE_TEXTS = {str: "a text", bool: "true or false", dict: "an object", list: "a list"}


class ShapeError(ValueError):
    """What is wrong with a value, and where."""


class HeadError(ShapeError):
    """The document is another one, or of another version; `field` of its head: ``format`` or ``version``."""

    def __init__(self, text: str, field: str) -> None:
        super().__init__(text)
        self.field = field


@dataclass(frozen=True)
class Number:
    """Bounds of a number, both included."""

    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True, init=False)
class Choice:
    """The values that a text may have."""

    values: tuple[str, ...]

    def __init__(self, *values: str) -> None:
        object.__setattr__(self, "values", values)


@dataclass(frozen=True)
class Least:
    """So many items that a list has at least."""

    count: int


@dataclass(frozen=True)
class FileName:
    """Of a text that names a file within a folder, on every system."""


@dataclass(frozen=True)
class Key:
    """The name that a field has in the document."""

    name: str


Share = Annotated[float, Number(0.0, 1.0)]
NotNegative = Annotated[float, Number(0.0)]
Count = Annotated[int, Number(0)]
Pixels = Annotated[int, Number(1, MOST_SIDE)]  # along an edge of an image


def head(name: str) -> dict[str, str | int]:
    """How a document of ours begins: with its format and the format's version."""
    return {"format": f"fipt-{name}", "version": 1}


def as_matrix(rows: Iterable[Iterable[float]]) -> Matrix:
    """Four rows, of an array or of lists, as a document holds them."""
    result: Any = tuple(tuple(map(float, row)) for row in rows)
    return result


def as_json(value: Any) -> dict[str, Any]:
    """The fields of a dataclass, for `json`, without those that have their defaults.

    Raises:
        TypeError: for anything else.
    """
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        raise TypeError(f"{type(value).__name__} is no JSON")
    document = getattr(value, "document", None)
    values = ((key, getattr(value, name), default) for name, key, _, default in _fields(type(value)))
    own = {key: content for key, content, default in values if default is _MISSING or content != default}
    return own if document is None else {**head(document), **own}


def as_kind(value: Any, kind: type[T]) -> T:
    """A JSON value as what it should be.

    Args:
        value: of a parsed document.
        kind: see the module.

    Raises:
        ShapeError: names the place, what is needed and what is there; `HeadError` for another document.
    """
    document = getattr(kind, "document", None)
    if document is not None and isinstance(value, dict):
        for name, needed in head(document).items():
            given = value.get(name, _MISSING)
            if type(given) is not type(needed) or given != needed:
                raise HeadError(f"{name} should be {needed!r}, not {_described(given)}", name)
    try:
        result: T = _read(value, kind)
        return result
    except _Fault as fault:
        raise ShapeError(fault.text) from None


class _Fault(Exception):
    """What a value should be; the place is added from the inside to the outside."""

    def __init__(self, needed: str, value: Any, *place: str) -> None:
        self.needed, self.value, self.place = needed, value, list(place)

    @property
    def text(self) -> str:
        place = "".join(reversed(self.place)).removeprefix(".")
        return f"{place or 'the document'} should be {self.needed}, not {_described(self.value)}"


def _read(value: Any, kind: Any, place: str = "") -> Any:
    """The value as what it should be; raises `_Fault`, with its place below that of the caller."""
    try:
        form, inner, detail = _form(kind)
        if form == "any" or (form == "optional" and value is None):
            return value
        if form == "numbers":
            return _numbers(value, *detail)
        if form == "optional":
            return _read(value, inner)
        if form == "limited":
            return _limited(_read(value, inner), detail)
        if not isinstance(value, detail):
            raise _Fault(_TYPE_TEXTS[detail], value)
        if form == "items":
            return tuple([_read(item, inner, f"[{index}]") for index, item in enumerate(value)])
        if form == "entries":
            return {name: _read(item, inner, f".{name}") for name, item in value.items()}
        return _filled(value, kind) if form == "fields" else value
    except _Fault as fault:
        fault.place.append(place)
        raise


@cache
def _form(kind: Any) -> tuple[str, Any, Any]:
    """How a kind is read, the kind of what is inside, and the JSON type, limits or numbers that it needs."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    numbers = _numbers_of(kind)
    if numbers is not None:
        return "numbers", None, numbers
    if kind is Any:
        return "any", None, None
    if kind in _TYPE_TEXTS:
        return "plain", None, kind
    if origin is Annotated:
        return "limited", arguments[0], [each for each in arguments[1:] if not isinstance(each, Key)]
    if origin in (typing.Union, types.UnionType):
        (inner,) = (each for each in arguments if each is not types.NoneType)
        return "optional", inner, None
    if origin is tuple and arguments[1:] == (...,):
        return "items", arguments[0], list
    if origin in (dict, Mapping):
        return "entries", arguments[1], dict
    if dataclasses.is_dataclass(kind):
        return "fields", None, dict
    raise TypeError(f"{kind} is no kind of a JSON value")


def _numbers_of(kind: Any) -> tuple[tuple[int | None, ...], bool, Number] | None:
    """Lengths of nested lists from the outside to the inside, None for any; whether whole; the bounds."""
    if kind in (int, float):
        return (), kind is int, Number()
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated and (limits := [each for each in inner[1:] if isinstance(each, Number)]):
        numbers = _numbers_of(inner[0])
        return None if numbers is None else (*numbers[:2], limits[0])
    if origin is not tuple or len(set(inner) - {...}) != 1:
        return None
    numbers = _numbers_of(inner[0])
    return None if numbers is None else ((None if ... in inner else len(inner), *numbers[0]), *numbers[1:])


def _numbers(value: Any, lengths: tuple[int | None, ...], whole: bool, limit: Number) -> Any:
    """A number, or nested tuples of numbers; infinities and NaN are none."""

    def convert(value: Any, depth: int) -> Any:
        if depth < len(lengths):
            if not isinstance(value, list) or lengths[depth] not in (None, len(value)):
                raise TypeError
            return tuple([convert(item, depth + 1) for item in value])
        is_number = isinstance(value, int if whole else (int, float)) and not isinstance(value, bool)
        if not is_number or not limit.low <= value <= limit.high or abs(value) == math.inf:
            raise TypeError
        return value if whole else float(value)

    try:
        return convert(value, 0)
    except TypeError:
        sizes = " x ".join("N" if length is None else str(length) for length in lengths)
        text = "a whole number" if whole else "a number"
        text = f"a list of {sizes} {'whole' if whole else 'finite'} numbers" if lengths else text
        if limit.low > -math.inf and limit.high < math.inf:
            text += f" from {limit.low:g} to {limit.high:g}"
        elif limit.low > -math.inf:
            text += f" of at least {limit.low:g}"
        raise _Fault(text, value) from None


def _limited(value: Any, limits: Iterable[Any]) -> Any:
    for limit in limits:
        if isinstance(limit, Choice) and value not in limit.values:
            raise _Fault(f"one of {', '.join(map(repr, limit.values))}", value)
        if isinstance(limit, Least) and len(value) < limit.count:
            raise _Fault(f"a list of {limit.count} or more", list(value))
        if isinstance(limit, FileName) and not _is_file_name(value):
            raise _Fault("a file name", value)
    return value


def _filled(value: dict[str, Any], kind: Any) -> Any:
    values = {}
    for name, key, inner, default in _fields(kind):
        if key in value:
            values[name] = _read(value[key], inner, f".{key}")
        elif default is _MISSING:
            raise _Fault("there", _MISSING, f".{key}")
    return kind(**values)


@cache
def _fields(kind: Any) -> list[tuple[str, str, Any, Any]]:
    """Name, name in the document, kind and default of each field of a dataclass."""
    hints = typing.get_type_hints(kind, include_extras=True)
    result = []
    for item in dataclasses.fields(kind):
        hint, default = hints[item.name], item.default
        keys = [each.name for each in getattr(hint, "__metadata__", ()) if isinstance(each, Key)]
        if item.default_factory is not dataclasses.MISSING:
            default = item.default_factory()
        result.append((item.name, (*keys, item.name)[0], hint, default))
    missing = dataclasses.MISSING
    return [(*entry, _MISSING if default is missing else default) for *entry, default in result]


def _is_file_name(value: str) -> bool:
    """Whether a text names a file in a folder: no path, nothing that a system reserves, and not too long."""
    if not value.isprintable() or value.strip(" .") != value or not value:
        return False
    # File systems allow 255, with suffixes.
    return len(value.encode()) <= 200 and not set(value) & set('/\\:*?"<>|')


def _described(value: Any) -> str:
    if value is _MISSING:
        return "missing"
    if value is None:
        return "null"
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
