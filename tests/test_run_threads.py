# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Work in threads: the order of the results, few items at a time, errors."""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from fipt_blender.core.run.threads import MOST_THREADS, cached_property, in_threads


@pytest.mark.parametrize("cores", [None, 1, 2, 500])
def test_results_and_errors_come_in_the_order_of_the_items_and_few_are_read_ahead(
    monkeypatch: pytest.MonkeyPatch, cores: int | None
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert list(in_threads(lambda item: item * item, range(50))) == [item * item for item in range(50)]
    assert list(in_threads(str, [])) == []
    items = iter(range(100))
    assert next(in_threads(str, items)) == "0" and next(items) <= MOST_THREADS + 1
    with pytest.raises(ZeroDivisionError):
        list(in_threads(lambda item: 1 / item, [1, 0, 2]))


def test_a_property_is_computed_once_by_all_threads_together() -> None:
    class Thing:
        computed = 0

        @cached_property
        def number(self) -> int:
            self.computed += 1
            time.sleep(0.05)  # long enough for all threads to ask
            return 7

    thing, ready = Thing(), threading.Barrier(4)

    def ask(_: int) -> int:
        ready.wait()
        return thing.number

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(ask, range(4))) == [7] * 4
    assert thing.computed == 1
