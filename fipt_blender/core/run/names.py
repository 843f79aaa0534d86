"""Names that are not taken yet. Standard library only."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection


def free_name(name: str, taken: Collection[str], joint: str = " ", key: Callable[[str], str] = str) -> str:
    """The name, followed by 2, 3, ... where it is taken.

    Args:
        name: the name.
        taken: names by `key`.
        joint: before the number.
        key: `str.casefold` of files, since some systems do not distinguish capitals.
    """
    numbered = itertools.chain([name], (f"{name}{joint}{number}" for number in itertools.count(2)))
    return next(each for each in numbered if key(each) not in taken)
