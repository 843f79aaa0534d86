# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that each view needs for itself, apart from who does it: this process, or a cluster's (`cluster`).

Results depend on the work and the view alone, never on who did it, how often or in which order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Item_contra = TypeVar("Item_contra", contravariant=True)
Result_co = TypeVar("Result_co", covariant=True)


class ViewWork(Protocol[Item_contra, Result_co]):
    """What all views of a stage share: a dataclass of numpy arrays and numbers, so that it can travel."""

    def prepare(self) -> Callable[[Item_contra], Result_co]:
        """The function of one view; here what belongs to this process is made (kernels, ray queries)."""


class Workers(Protocol):
    """Who does work on views."""

    def map(self, work: ViewWork[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result]]:
        """The index and the result of each item, in any order.

        Items are taken when there is somebody to work on them, so that a few of them are in memory at most.
        """


class LocalWorkers:
    """This process, one view after the other."""

    def map(self, work: ViewWork[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result]]:
        """See :class:`Workers`."""
        do = work.prepare()
        for index, item in enumerate(items):
            yield index, do(item)
