# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Work in threads: the order of the results, few items at a time, errors."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import pytest

from fipt_blender.core.run.per_view import LocalWorkers, TwoSteps
from fipt_blender.core.run.threads import MOST_THREADS, in_threads
from samples.child_processes import PATIENCE_SECONDS


@pytest.mark.parametrize("cores", [None, 1, 2, 500])
def test_results_are_in_the_order_of_the_items(monkeypatch: pytest.MonkeyPatch, cores: int | None) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert list(in_threads(lambda item: item * item, range(50))) == [item * item for item in range(50)]
    assert list(in_threads(str, [])) == []


@pytest.mark.parametrize("cores", [1, 2, 500])
def test_only_a_few_items_are_read_ahead(monkeypatch: pytest.MonkeyPatch, cores: int) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    read: list[int] = []

    def items() -> Iterator[int]:
        for item in range(100):
            read.append(item)
            yield item

    results = in_threads(str, items())
    assert next(results) == "0"
    assert len(read) <= MOST_THREADS + 1


@pytest.mark.parametrize("cores", [1, 2])
def test_an_error_reaches_the_caller(monkeypatch: pytest.MonkeyPatch, cores: int) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    with pytest.raises(ZeroDivisionError):
        list(in_threads(lambda item: 1 / item, [1, 0, 2]))


def test_the_second_step_of_a_view_runs_beside_the_first_of_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    next_began = [threading.Event() for _ in range(4)]

    def first(item: int) -> int:
        next_began[item].set()
        return item

    def second(item: int) -> int:
        assert item == 3 or next_began[item + 1].wait(PATIENCE_SECONDS)
        return item * item

    class Work:
        def prepare(self) -> TwoSteps[int, int, int]:
            return TwoSteps(first, second)

    assert list(LocalWorkers().map(Work(), range(4))) == [(0, 0), (1, 1), (2, 4), (3, 9)]
