# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Work on Blender's data in slices: generators that yield where a window may draw in between.

Between two slices the artist may undo, rename or load a file, so that they remember names alone.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

import bpy

from ..core.job.errors import FiptError

Result = TypeVar("Result")
Slices = Generator[None, None, Result]


def run_through(slices: Slices[Result]) -> Result:
    """Do all slices at once and return the generator's result."""
    while True:
        try:
            next(slices)
        except StopIteration as end:
            return end.value


def find_object(name: str) -> bpy.types.Object:
    """An object between two slices.

    Raises:
        FiptError: ``room-changed`` where it has gone, or is being edited.
    """
    item = bpy.data.objects.get(name)
    if item is None:
        raise FiptError(
            "room-changed",
            f"The object '{name}' was removed or renamed in the meantime.",
            "Undo that, and start again: what is finished is kept.",
        )
    if item.mode == "EDIT":
        raise FiptError(
            "room-edited", f"'{name}' is in edit mode.", "Leave edit mode, and start again: it goes on there."
        )
    return item
