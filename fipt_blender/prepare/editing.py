# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Correcting the groups that `read` has found: split one, merge two. Standard library only."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import PurePath

from ..core.run.errors import FiptError
from .preparation import Group


def split_group(groups: Sequence[Group], index: int, at: int) -> list[Group]:
    """The groups with one of them cut into its first `at` photographs and the others.

    The first part keeps its name; the second takes that of its first photograph.

    Raises:
        FiptError: ``group-not-split`` where a part would be empty.
    """
    group = groups[index]
    if not 0 < at < len(group.photographs):
        raise FiptError(
            "group-not-split",
            f"The group '{group.name}' can't be split before its first photograph.",
            "Select the photograph that begins the second group.",
        )
    name = free_name(PurePath(group.photographs[at]).stem, [other.name for other in groups])
    first = replace(group, photographs=group.photographs[:at])
    second = replace(group, name=name, photographs=group.photographs[at:])
    return [*groups[:index], first, second, *groups[index + 1 :]]


def merge_groups(groups: Sequence[Group], index: int) -> list[Group]:
    """The groups with one of them and the next one as one group, which has the name of the first.

    Raises:
        FiptError: ``group-not-merged`` for the last group.
    """
    if not 0 <= index < len(groups) - 1:
        raise FiptError(
            "group-not-merged", "There is no group after this one.", "Select the first of the two groups."
        )
    first, second = groups[index], groups[index + 1]
    merged = replace(
        first, photographs=(*first.photographs, *second.photographs), used=first.used or second.used
    )
    return [*groups[:index], merged, *groups[index + 2 :]]


def free_name(name: str, taken: Iterable[str]) -> str:
    """The name, or with the first number from 2 that makes it differ from the taken ones in any case."""
    used = {other.casefold() for other in taken}
    if name.casefold() not in used:
        return name
    number = 2
    while f"{name}-{number}".casefold() in used:
        number += 1
    return f"{name}-{number}"
