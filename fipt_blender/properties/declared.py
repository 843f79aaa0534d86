"""Blender's properties from options that `core.run.declared` describes, and their values back."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import bpy

from ..core.run.declared import Choices, Declared, declared


def enum_items(choices: Choices) -> list[tuple[Any, ...]]:
    """Choices as Blender takes them: identifier, label, tooltip, icon, number."""
    defaults = ("", "", "", "NONE")
    padded = ((*choice, *defaults[len(choice) :])[:4] for choice in choices)
    return [(*choice, number) for number, choice in enumerate(padded)]


def property_of(item: Declared, **more: Any) -> object:
    """Blender's property of an option; `more` are arguments besides those that follow from it."""
    option = item.option
    shown: dict[str, Any] = {
        "name": option.label or item.name.replace("_", " ").title(),
        "description": option.text[:1].upper() + option.text[1:],
    }
    if "get" not in more:
        shown["default"] = item.default
    if option.choices:
        make, shown["items"] = bpy.props.EnumProperty, enum_items(option.choices)
    elif item.kind is bool:
        make = bpy.props.BoolProperty
    elif item.kind in (int, float):
        make = bpy.props.IntProperty if item.kind is int else bpy.props.FloatProperty
        low = 0 if option.zero else option.low
        shown["min"] = item.kind(low if low is not None else 1 if item.kind is int else 1e-6)
        shown["max"] = item.kind(option.high)
    elif item.kind is tuple:
        make, shown["size"] = bpy.props.FloatVectorProperty, len(item.default)
    else:
        make, shown["default"] = bpy.props.StringProperty, item.default or ""
    return make(**{**shown, **option.shown, **more})


def properties_of(
    kind: Callable[..., Any], names: Collection[str] | None = None, **more: Any
) -> dict[str, object]:
    """Blender's properties of the options of a dataclass or a function, all or some, by their names."""
    return {
        name: property_of(item, **more) for name, item in _in_panel(kind) if names is None or name in names
    }


def values_of(group: Any, kind: Callable[..., Any]) -> dict[str, Any]:
    """The values of those options of a dataclass or a function that a group or an operator has."""
    return {
        name: _value(getattr(group, name), item) for name, item in _in_panel(kind) if hasattr(group, name)
    }


def fill(group: Any, kind: Callable[..., Any], values: Mapping[str, Any]) -> None:
    """Set those options of a dataclass that a group has."""
    for name, item in _in_panel(kind):
        if hasattr(group, name):
            value = values[name]
            if item.kind is Path:
                value = "" if value is None else str(value.absolute())
            setattr(group, name, math.radians(value) if _is_angle(item) else value)


def _in_panel(kind: Callable[..., Any]) -> list[tuple[str, Declared]]:
    return [(name, item) for name, item in declared(kind).items() if item.option.panel]


def _value(value: Any, item: Declared) -> Any:
    if item.kind is Path:
        return Path(bpy.path.abspath(value)).absolute() if value else None
    if item.kind is tuple:
        return tuple(value)
    return math.degrees(value) if _is_angle(item) else item.kind(value)


def _is_angle(item: Declared) -> bool:
    """Whether Blender has radians where the option is in degrees."""
    return bool(item.option.shown.get("subtype") == "ANGLE")
