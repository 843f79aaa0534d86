"""Work that is done for each view independently, by this process or by a cluster (`core/device/cluster.py`).

Results depend only on the work and the view, not on which process does it, how often or in which order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from .threads import in_threads

Item = TypeVar("Item")
Result = TypeVar("Result")
Between = TypeVar("Between")
Item_contra = TypeVar("Item_contra", contravariant=True)
Result_co = TypeVar("Result_co", covariant=True)


class ViewWork(Protocol[Item_contra, Result_co]):
    """What all views of a stage share: a dataclass of numpy arrays and numbers, which can be sent."""

    def prepare(self) -> Callable[[Item_contra], Result_co]:
        """The function of one view; called in the process that does the work (kernels, ray queries)."""


@dataclass(frozen=True)
class TwoSteps(Generic[Item, Between, Result]):
    """A function of one view in two steps, of which the second may run while other views are at the first.

    Attributes:
        first: always called in one thread, one view at a time, as Dr.Jit needs it.
        second: called in another thread.
    """

    first: Callable[[Item], Between]
    second: Callable[[Between], Result]

    def __call__(self, item: Item) -> Result:
        """Both steps, one after the other."""
        return self.second(self.first(item))


class Workers(Protocol):
    """Does the work of all views."""

    def map(self, work: ViewWork[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result]]:
        """Yield the index and the result of each item, in any order.

        An item is read when a worker is free, so that only a few items are in memory at a time.
        """


class LocalWorkers:
    """Does the work in this process, one view after another."""

    def map(self, work: ViewWork[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result]]:
        """See :class:`Workers`."""
        do = work.prepare()
        if isinstance(do, TwoSteps):
            yield from enumerate(in_threads(do.second, map(do.first, items), most=1))
        else:
            yield from enumerate(map(do, items))
