"""Cases of tests with several independent choices."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Any


def pairs(*choices: Collection[Any]) -> list[tuple[Any, ...]]:
    """Few combinations in which each value of a choice meets each value of every other choice."""

    def met(case: tuple[int, ...]) -> set[tuple[tuple[int, int], ...]]:
        return set(itertools.combinations(enumerate(case), 2))

    every = list(itertools.product(*(range(len(values)) for values in choices)))
    left, chosen = set().union(*map(met, every)), []
    while left:
        chosen.append(max(every, key=lambda case: len(met(case) & left)))
        left -= met(chosen[-1])
    return [tuple(list(values)[i] for values, i in zip(choices, case, strict=True)) for case in chosen]
