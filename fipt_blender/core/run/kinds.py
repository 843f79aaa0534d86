# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON values as frozen dataclasses, checked while they are read. Standard library only.

A kind is a type: ``str``, ``bool``, ``int``, ``float`` (whole numbers pass), ``Any``, ``X | None`` (null),
``tuple[X, ...]`` (a list), ``tuple[float, float, float]`` (of this length; nested ones are matrices),
``dict`` and ``list`` (any content), ``Mapping[str, X]`` or ``dict[str, X]`` (an object with any names), or a
dataclass (an object with these names; others are let pass; fields with a default may be missing).
``Annotated[X, ...]`` adds `Choice`, `Number`, `Least`, `FileName` or `Key`. A dataclass with the class
attribute ``document`` is a whole document of ours and begins with its `head`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

T = TypeVar("T")
Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]
_MISSING = object()


class ShapeError(ValueError):
    """What is wrong with a value, and where."""


class HeadError(ShapeError):
    """The document is another one, or of another version of its format.

    Attributes:
        field: of its head, ``format`` or ``version``.
    """

    def __init__(self, text: str, field: str) -> None:
        super().__init__(text)
        self.field = field


@dataclass(frozen=True)
class Number:
    """Bounds of a number, or of all numbers of a nested list; both included."""

    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Choice:
    """The values that a text or a number may have."""

    values: tuple[Any, ...]

    def __init__(self, *values: Any) -> None:
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


def head(name: str) -> dict[str, str | int]:
    """How a document of ours begins: with its format and the format's version."""
    return {"format": f"fipt-{name}", "version": 1}


def as_matrix(rows: Iterable[Iterable[float]]) -> Matrix:
    """Four rows, of an array or of lists, as a document holds them."""
    result: Any = tuple(tuple(map(float, row)) for row in rows)
    return result


class _Fault(Exception):
    """What a value should be; the place is added from the inside to the outside."""

    def __init__(self, needed: str, value: Any, *place: str) -> None:
        self.needed, self.value, self.place = needed, value, list(place)

    @property
    def text(self) -> str:
        place = "".join(reversed(self.place)).removeprefix(".")
        return f"{place or 'the document'} should be {self.needed}, not {_described(self.value)}"


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
        hashable: Any = kind
        result: T = _reader(hashable)(value)
        return result
    except _Fault as fault:
        raise ShapeError(fault.text) from None


def as_json(value: Any) -> Any:
    """The fields of a dataclass, for `json`; those that are as without the document's word are left out.

    Raises:
        TypeError: for anything else.
    """
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        raise TypeError(f"{type(value).__name__} is no JSON")
    document = getattr(value, "document", None)
    result: dict[str, Any] = {} if document is None else dict(head(document))
    for name, key, _, default in _entries(type(value)):
        content = getattr(value, name)
        if default is _MISSING or content != default:
            result[key] = content
    return result


Reader = Callable[[Any], Any]


@functools.cache
def _reader(kind: Any) -> Reader:
    """What turns a JSON value into the kind, or raises `_Fault`."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return lambda value: value
    if kind in _TYPE_TEXTS:
        return _plain(kind)
    if origin is Annotated:
        return _limited(arguments[0], [each for each in arguments[1:] if not isinstance(each, Key)])
    if origin in (typing.Union, types.UnionType):
        (inner,) = (_reader(each) for each in arguments if each is not type(None))
        return lambda value: None if value is None else inner(value)
    if (numbers := _numbers_of(kind)) is not None:
        return _numbers(*numbers, Number())
    if origin is tuple and arguments[1:] == (...,):
        return _items(_reader(arguments[0]), 0)
    if origin is dict or origin is Mapping:
        return _object(_reader(arguments[1]))
    if dataclasses.is_dataclass(kind):
        return _fields(kind)
    raise TypeError(f"{kind} is no kind of a JSON value")


def _plain(kind: type) -> Reader:
    def read(value: Any) -> Any:
        if not isinstance(value, kind):
            raise _Fault(_TYPE_TEXTS[kind], value)
        return value

    return read


def _choice(values: tuple[Any, ...]) -> Reader:
    def read(value: Any) -> Any:
        if not any(type(value) is type(choice) and value == choice for choice in values):
            raise _Fault(f"one of {', '.join(map(repr, values))}", value)
        return value

    return read


def _limited(kind: Any, limits: list[Any]) -> Reader:
    """The reader of an annotated kind, of at most one limit."""
    if not limits:
        return _reader(kind)
    (limit,) = limits
    if isinstance(limit, Number):
        numbers = _numbers_of(kind)
        assert numbers is not None
        return _numbers(*numbers, limit)
    if isinstance(limit, Choice):
        return _choice(limit.values)
    if isinstance(limit, Least):
        return _items(_reader(typing.get_args(kind)[0]), limit.count)
    return _file_name


def _numbers_of(kind: Any) -> tuple[tuple[int | None, ...], bool] | None:
    """Lengths of nested lists from the outside to the inside, None for any, and whether numbers are whole."""
    if kind in (int, float):
        return (), kind is int
    inner = set(typing.get_args(kind))
    if typing.get_origin(kind) is not tuple or len(inner - {...}) != 1:
        return None
    numbers = _numbers_of(next(iter(inner - {...})))
    length = None if ... in inner else len(typing.get_args(kind))
    return None if numbers is None else ((length, *numbers[0]), numbers[1])


def _numbers(lengths: tuple[int | None, ...], whole: bool, limit: Number) -> Reader:
    low, high = limit.low, limit.high
    if not whole:  # the largest finite number is within the bounds, an infinity and NaN are not
        low, high = max(low, -_LARGEST), min(high, _LARGEST)

    def convert(value: Any, depth: int) -> Any:
        if depth < len(lengths):
            if not isinstance(value, list) or lengths[depth] not in (None, len(value)):
                raise TypeError
            return tuple([convert(item, depth + 1) for item in value])
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            raise TypeError
        if not low <= value <= high:
            raise TypeError
        return value if whole else float(value)

    def read(value: Any) -> Any:
        try:
            return convert(value, 0)
        except TypeError:
            raise _Fault(_numbers_text(lengths, whole, limit), value) from None

    return read


def _items(inner: Reader, least: int) -> Reader:
    def read(value: Any) -> Any:
        if not isinstance(value, list):
            raise _Fault("a list", value)
        if len(value) < least:
            raise _Fault(f"a list of {least} or more", value)
        return tuple([_under(f"[{index}]", inner, item) for index, item in enumerate(value)])

    return read


def _object(inner: Reader) -> Reader:
    def read(value: Any) -> Any:
        if not isinstance(value, dict):
            raise _Fault("an object", value)
        return {name: _under(f".{name}", inner, item) for name, item in value.items()}

    return read


def _fields(kind: Any) -> Reader:
    entries = [(name, key, _reader(hint), default) for name, key, hint, default in _entries(kind)]

    def read(value: Any) -> Any:
        if not isinstance(value, dict):
            raise _Fault("an object", value)
        values = {}
        for name, key, inner, default in entries:
            if key in value:
                values[name] = _under(f".{key}", inner, value[key])
            elif default is _MISSING:
                raise _Fault("there", _MISSING, f".{key}")
        return kind(**values)

    return read


@functools.cache
def _entries(kind: Any) -> list[tuple[str, str, Any, Any]]:
    """Name, name in the document, kind and default of each field of a dataclass."""
    hints = typing.get_type_hints(kind, include_extras=True)
    result = []
    for item in dataclasses.fields(kind):
        keys = [each.name for each in _metadata(hints[item.name]) if isinstance(each, Key)]
        default = item.default
        if item.default_factory is not dataclasses.MISSING:
            default = item.default_factory()
        missing = _MISSING if default is dataclasses.MISSING else default
        result.append((item.name, keys[0] if keys else item.name, hints[item.name], missing))
    return result


def _metadata(hint: Any) -> Iterable[Any]:
    return typing.get_args(hint)[1:] if typing.get_origin(hint) is Annotated else ()


def _under(place: str, inner: Reader, value: Any) -> Any:
    try:
        return inner(value)
    except _Fault as fault:
        fault.place.append(place)
        raise


def _file_name(value: Any) -> str:
    """A text that names a file in a folder: no path, nothing that a system reserves, and not too long."""
    fits = isinstance(value, str) and value.isprintable() and value.strip(" .") == value and value != ""
    # File systems allow 255, with suffixes.
    if not fits or len(value.encode()) > 200 or set(value) & set('/\\:*?"<>|'):
        raise _Fault("a file name", value)
    return str(value)


def _numbers_text(lengths: tuple[int | None, ...], whole: bool, limit: Number) -> str:
    sizes = " x ".join("N" if length is None else str(length) for length in lengths)
    text = "a whole number" if whole else "a number"
    if lengths:
        text = f"a list of {sizes} {'whole' if whole else 'finite'} numbers"
    if limit.low > -math.inf and limit.high < math.inf:
        return f"{text} from {limit.low:g} to {limit.high:g}"
    if limit.low > -math.inf:
        return f"{text} of at least {limit.low:g}"
    return text if limit.high == math.inf else f"{text} of at most {limit.high:g}"


def _described(value: Any) -> str:
    if value is _MISSING:
        return "missing"
    if value is None:
        return "null"
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


_LARGEST = float.fromhex("0x1.fffffffffffffp+1023")
_TYPE_TEXTS = {str: "a text", bool: "true or false", dict: "an object", list: "a list"}
