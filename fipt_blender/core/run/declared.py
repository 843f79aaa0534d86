"""Options that are declared once: `name: Annotated[type, Option("Help text", low=1)] = default`, or the text.

A frozen dataclass of such fields, or a function with such parameters, is all that the command line, the side
panel (`properties/declared.py`), presets and the documentation are made from. A type is bool, int, float,
str, Path, a tuple of numbers, or one of these or None. Standard library only: both processes import it.
"""

from __future__ import annotations

import inspect
import math
import typing
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import FiptError

if TYPE_CHECKING:
    import argparse

# Largest value of any number: counts and seeds must fit into the integers of all libraries.
MOST = 2**31 - 1
_MOST_LETTERS = 4096  # of a text
_METAVARS = {int: "N", float: "N", str: "TEXT", tuple: "X,Y,Z", Path: "PATH"}
Choices = tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Option:
    """What is declared of an option besides its type and its default.

    Attributes:
        text: help text and tooltip, without a full stop at its end.
        label: in the panel; "" for one made from the name.
        low, high: of a number, which otherwise is above zero and at most `MOST`.
        zero: whether a number may be 0, too.
        choices: of a text: identifier and, for the panel, label, tooltip and icon.
        keyed: whether results depend on it.
        panel: whether the panel has it, or the command line alone.
        shown: further arguments of Blender's property.
    """

    text: str
    label: str = ""
    low: float | None = None
    high: float = MOST
    zero: bool = False
    choices: Choices = ()
    keyed: bool = True
    panel: bool = True
    shown: Mapping[str, Any] = field(default_factory=dict)

    @property
    def identifiers(self) -> tuple[str, ...]:
        """Those of the choices."""
        return tuple(choice[0] for choice in self.choices)


@dataclass(frozen=True)
class Declared:
    """An option with its name, type (without None) and default."""

    name: str
    kind: type
    option: Option
    default: Any

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return f"--{self.name.replace('_', '-')}"

    def converted(self, value: Any) -> Any:
        """A value or a text in the option's type.

        Raises:
            ValueError: what the option takes.
        """
        if self.kind is bool:
            truths = {"true": True, "1": True, "false": False, "0": False}
            if str(value).lower() not in truths:
                raise ValueError("true or false")
            return truths[str(value).lower()]
        if value is None or value == "":
            return self.default if self.default is None else self._text(value)
        if self.kind is Path:
            return Path(value)
        if self.kind is str:
            return self._text(value)
        if self.kind is tuple:
            return self._numbers(value)
        return self._number(value)

    def _text(self, value: Any) -> str:
        identifiers = self.option.identifiers
        if not isinstance(value, str) or (identifiers and value not in identifiers):
            raise ValueError(f"one of: {', '.join(identifiers)}" if identifiers else "a text")
        if len(value) > _MOST_LETTERS or not (value.isprintable()):
            raise ValueError(f"a text of at most {_MOST_LETTERS} letters")
        return value

    def _numbers(self, value: Any) -> tuple[float, ...]:
        try:
            numbers = tuple(map(float, value.split(",") if isinstance(value, str) else value))
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != len(self.default) or not all(map(math.isfinite, numbers)):
            raise ValueError(f"{len(self.default)} numbers, separated by commas")
        return numbers

    def _number(self, value: Any) -> Any:
        low, high, zero = self.option.low, self.option.high, self.option.zero
        whole = self.kind is int and isinstance(value, float) and value.is_integer()
        try:
            number = self.kind(str(int(value) if whole else value))
        except ValueError:
            number = math.nan
        if not ((number > 0 if low is None else number >= low) and number <= high):  # NaN is neither
            if number != 0 or not zero:
                kind = "a whole number" if self.kind is int else "a number"
                least = "above zero" if low is None else f"of at least {low:g}"
                raise ValueError(f"{'0, or ' if zero else ''}{kind} {least}, at most {high:.15g}")
        return number


@cache
def declared(subject: Callable[..., Any]) -> dict[str, Declared]:
    """The options of a dataclass or a function by their names, in order: what is `Annotated`."""
    hints = typing.get_type_hints(subject, include_extras=True)
    found = {}
    for name, parameter in inspect.signature(subject).parameters.items():
        hint = hints.get(name)
        if typing.get_origin(hint) is not typing.Annotated:
            continue
        kind, text, *_ = typing.get_args(hint)
        if None.__class__ in typing.get_args(kind):  # X | None
            kind = typing.get_args(kind)[0]
        option = text if isinstance(text, Option) else Option(text)
        found[name] = Declared(name, typing.get_origin(kind) or kind, option, parameter.default)
    return found


def converted(kind: Callable[..., Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changed values of options, in their types.

    Args:
        kind: see `declared`.
        changes: name to value; texts are converted.

    Raises:
        FiptError: ``setting-unknown`` or ``setting-invalid``.
    """
    known, values = declared(kind), {}
    for name, value in changes.items():
        if name not in known:
            raise FiptError("setting-unknown.converted", name=name, known=", ".join(known))
        try:
            values[name] = known[name].converted(value)
        except ValueError as error:
            raise FiptError(
                "setting-invalid.converted", value=str(value)[:80], name=name, error=error
            ) from None
    return values


def add_options(
    parser: argparse.ArgumentParser, kind: Callable[..., Any], without: Collection[str] = ()
) -> None:
    """Arguments for all options of a dataclass but those `without`; see `options_of`."""
    for item in declared(kind).values():
        if item.name in without:
            continue
        text = item.option.text.replace("%", "%%")
        if item.kind is bool:
            parser.add_argument(item.flag, action="store_true", default=item.default, help=text)
            continue
        if item.default not in (None, ""):
            shown = ",".join(map(str, item.default)) if item.kind is tuple else item.default
            text = f"{text} (default: {shown})"
        metavar = None if item.option.choices else _METAVARS[item.kind]
        choices = item.option.identifiers or None
        parser.add_argument(item.flag, metavar=metavar, choices=choices, default=item.default, help=text)


def options_of(arguments: argparse.Namespace, kind: Callable[..., Any]) -> dict[str, Any]:
    """The options of a dataclass that parsed arguments set.

    Raises:
        FiptError: ``setting-invalid``.
    """
    return converted(kind, {name: getattr(arguments, name) for name in declared(kind) if name in arguments})


def arguments_of(options: Any, kind: Callable[..., Any]) -> list[str]:
    """The words that give a command the options of a dataclass which differ from their defaults.

    Each is one word: a separate "-y" would be taken for an option.
    """
    words = []
    for item in declared(kind).values():
        value = getattr(options, item.name)
        if value != item.default:
            value = value.absolute() if isinstance(value, Path) else value
            value = ",".join(map(str, value)) if isinstance(value, tuple) else value
            words.append(item.flag if value is True else f"{item.flag}={value}")
    return words
