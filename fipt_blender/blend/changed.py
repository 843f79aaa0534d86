"""Temporary values of attributes of Blender's data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any


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
