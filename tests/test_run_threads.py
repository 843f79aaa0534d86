# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Work in threads: the order of the results, few items at a time, errors."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from fipt_blender.core.run.threads import MOST_THREADS, in_threads


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
