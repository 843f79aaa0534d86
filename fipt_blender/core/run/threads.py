"""Independent numpy work in a few threads of this process: numpy lets others run while it computes."""

from __future__ import annotations

import functools
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_THREADS = 8  # each has arrays of its own in memory


class cached_property(functools.cached_property[Result]):
    """`functools.cached_property` that is computed once, whichever threads ask for it.

    Since Python 3.12 that of functools has no lock, so that threads would write one file at the same time.
    """

    def __init__(self, function: Callable[[Any], Result]) -> None:
        super().__init__(function)
        self._lock = threading.RLock()

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        with self._lock:
            return super().__get__(instance, owner)


def in_threads(
    function: Callable[[Item], Result], items: Iterable[Item], most: int = MOST_THREADS
) -> Iterator[Result]:
    """Yield the results of independent calls in the order of the items, whatever the number of threads.

    An item is read when a thread is about to be free, so that only a few are in memory at a time.

    Args:
        most: threads besides this one, which reads the items.
    """
    cores = os.cpu_count() or 1
    count = min(cores, most)
    if cores == 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(count) as pool:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
