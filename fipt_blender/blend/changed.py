# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporary values of attributes of Blender's data."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy


@contextmanager
def changed(target: object, values: Mapping[str, Any]) -> Iterator[None]:
    """Set attributes of an object for the length of the block, and restore them."""
    kept = {name: getattr(target, name) for name in values}
    try:
        for name, value in values.items():
            setattr(target, name, value)
        yield
    finally:
        for name, value in kept.items():
            setattr(target, name, value)


@contextmanager
def unset(target: bpy.types.bpy_struct, keep: Collection[str] = ()) -> Iterator[None]:
    """Give all properties that an add-on has defined their defaults for the length of the block.

    Args:
        target: a property group.
        keep: names of properties that stay as they are.
    """
    names = [
        each.identifier
        for each in target.bl_rna.properties
        if not each.is_readonly and target.is_property_set(each.identifier)
    ]
    kept = {name: getattr(target, name) for name in names if name not in keep}
    # What this Blender has no item for reads as "" and can't be set: a denoiser that it was built without.
    kept = {name: value for name, value in kept.items() if value != "" or not _is_choice(target, name)}
    try:
        for name in kept:
            target.property_unset(name)
        yield
    finally:
        for name, value in kept.items():
            setattr(target, name, value)


def _is_choice(target: bpy.types.bpy_struct, name: str) -> bool:
    """Whether a property is an enumeration."""
    return target.bl_rna.properties[name].type == "ENUM"


@contextmanager
def all_changed(targets: Iterable[object], values: Mapping[str, Any]) -> Iterator[None]:
    """`changed` for several objects."""
    with ExitStack() as stack:
        for target in targets:
            stack.enter_context(changed(target, values))
        yield
