"""JSON values as frozen dataclasses, checked by their annotations while they are read. Standard library only.

A kind is a type: ``str``, ``bool``, ``int``, ``float`` (whole numbers pass), ``Any``, a union such as
``X | None``, ``tuple[X, ...]`` or ``list[X]``, ``tuple[float, float, float]`` (numbers of this count; nested
ones are matrices), ``dict`` and ``list`` (any content), ``Mapping[str, X]`` (an object with any names), or a
dataclass (an object with these names; others are let pass; fields with a default may be missing).
``Annotated[X, ...]`` adds a `Number`, a `Check` or a `Key`. A dataclass with the class attribute ``document``
is a whole document of ours and begins with its `head`.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, TypeVar

from .shapes import MOST_SIDE

T = TypeVar("T")
Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]
Refer = Callable[[Any, Any], Any]  # what a reference of a document, and its kind, stand for
_MISSING = dataclasses.MISSING
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
    """Bounds of a number, or of all numbers of a list; both included."""

    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Check:
    """What a value must be besides its type, in words, and whether a value of any type is that."""

    needed: str
    fits: Callable[[Any], bool]


@dataclass(frozen=True)
class Key:
    """The name that a field has in the document."""

    name: str


def choice(*values: str) -> Check:
    """Of a text: the values that it may have."""
    return Check(f"one of {', '.join(map(repr, values))}", lambda value: value in values)


def _is_file_name(value: Any) -> bool:
    """Whether a text names a file in a folder: no path, nothing that a system reserves, and not too long."""
    if not isinstance(value, str) or not value.isprintable() or value.strip(" .") != value or not value:
        return False
    # File systems allow 255, with suffixes.
    return len(value.encode()) <= 200 and not set(value) & set('/\\:*?"<>|')


SOME = Check("a list of 1 or more", bool)  # of a list
FileName = Annotated[str, Check("a file name", _is_file_name)]  # within a folder, on every system
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


def as_kind(value: Any, kind: type[T], refer: Refer | None = None) -> T:
    """A JSON value as what it should be.

    Args:
        value: of a parsed document.
        kind: see the module.
        refer: of a document that the engine keeps for itself: what its references, objects of the one name
            ``"stored"``, stand for. Its numbers may be infinite or NaN.

    Raises:
        ShapeError: names the place, what is needed and what is there; `HeadError` for another document.
    """
    document = getattr(kind, "document", None)
    if document is not None and isinstance(value, dict):
        for name, needed in head(document).items():
            given = value.get(name, _MISSING)
            if type(given) is not type(needed) or given != needed:
                raise HeadError(f"{name} should be {needed!r}, not {_described(given)}", name)
    result: T = _read(value, kind, "", refer)
    return result


def _fault(place: str, needed: str, value: Any) -> ShapeError:
    place = place.removeprefix(".") or "the document"
    return ShapeError(f"{place} should be {needed}, not {_described(value)}")


def _read(value: Any, kind: Any, place: str, refer: Refer | None) -> Any:
    """The value as what it should be; `place`: where it is in the document."""
    if refer is not None and isinstance(value, dict) and value.keys() == {"stored"}:
        return refer(value["stored"], kind)
    origin, inner, numbers = _form(kind)
    if numbers is not None:
        return _numbers(value, place, *numbers, finite=refer is None)
    if kind is Any:
        return value
    if origin is Annotated:
        for check in inner[1:]:
            if isinstance(check, Check) and not check.fits(value):
                raise _fault(place, check.needed, value)
        return _read(value, inner[0], place, refer)
    if origin in (typing.Union, types.UnionType):
        if value is None and types.NoneType in inner:
            return None
        *others, last = (each for each in inner if each is not types.NoneType)
        for other in others:
            try:
                return _read(value, other, place, refer)
            except ShapeError:
                pass
        return _read(value, last, place, refer)
    needed: Any = dict if dataclasses.is_dataclass(kind) or origin in (dict, Mapping) else kind
    needed = list if origin in (tuple, list, Sequence) else needed
    if needed not in _TYPE_TEXTS or not isinstance(value, needed):
        raise _fault(place, _TYPE_TEXTS.get(needed, str(kind)), value)
    if dataclasses.is_dataclass(kind):
        return _filled(value, kind, place, refer)
    if inner and needed is list:
        items = [_read(item, inner[0], f"{place}[{index}]", refer) for index, item in enumerate(value)]
        return items if origin is list else tuple(items)
    if inner:
        return {name: _read(item, inner[1], f"{place}.{name}", refer) for name, item in value.items()}
    return value


@cache
def _form(kind: Any) -> tuple[Any, tuple[Any, ...], tuple[tuple[int | None, ...], bool, Number] | None]:
    """The origin and the arguments of a kind, and what `_numbers_of` says of it."""
    return typing.get_origin(kind), typing.get_args(kind), _numbers_of(kind)


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


def _numbers(
    value: Any, place: str, lengths: tuple[int | None, ...], whole: bool, limit: Number, finite: bool
) -> Any:
    """A number, or nested tuples of numbers; infinities and NaN are none where they must be `finite`."""

    def convert(value: Any, depth: int) -> Any:
        if depth < len(lengths):
            if not isinstance(value, list) or lengths[depth] not in (None, len(value)):
                raise TypeError
            return tuple([convert(item, depth + 1) for item in value])
        if not isinstance(value, int if whole else (int, float)) or isinstance(value, bool):
            raise TypeError
        if finite and (not limit.low <= value <= limit.high or abs(value) == math.inf):
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
        raise _fault(place, text, value) from None


def _filled(value: dict[str, Any], kind: Any, place: str, refer: Refer | None) -> Any:
    values = {}
    for name, key, inner, default in _fields(kind):
        if key in value:
            values[name] = _read(value[key], inner, f"{place}.{key}", refer)
        elif default is _MISSING:
            raise _fault(f"{place}.{key}", "there", _MISSING)
    return kind(**values)


@cache
def _fields(kind: Any) -> list[tuple[str, str, Any, Any]]:
    """Name, name in the document, kind and default of each field of a dataclass."""
    hints = typing.get_type_hints(kind, include_extras=True)
    result = []
    for item in dataclasses.fields(kind):
        hint, made = hints[item.name], item.default_factory
        keys = [each.name for each in getattr(hint, "__metadata__", ()) if isinstance(each, Key)]
        if item.init:
            default = item.default if made is _MISSING else made()
            result.append((item.name, (*keys, item.name)[0], hint, default))
    return result


def _described(value: Any) -> str:
    if value is _MISSING:
        return "missing"
    if value is None:
        return "null"
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
