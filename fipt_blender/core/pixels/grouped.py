"""Numbers of groups, and sums and medians of their values, all groups at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import numpy as np

MAX_KEYS = 1 << 62  # so that keys fit into 64 bits
MAX_PADDED = 4  # times the values, of rows as long as the largest group

# Keys (n,) int64, and a value (n, ...) for each.
Keyed = tuple[np.ndarray, np.ndarray]


def numbered(columns: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) int64 from 0, a number for each combination of the values of int columns (N,)."""
    number, count = np.zeros(len(columns[0]), np.int64), 1
    for column in columns:
        values = column.astype(np.int64) - int(column.min(initial=0))
        range_ = int(values.max(initial=0)) + 1
        if count * range_ >= MAX_KEYS:
            number, count = _ranks(number), len(number)
        if count * range_ >= MAX_KEYS:
            values, range_ = _ranks(values), len(number)
        number, count = number * range_ + values, count * range_
    return _ranks(number)


def _ranks(values: np.ndarray) -> np.ndarray:
    return np.unique(values, return_inverse=True)[1].astype(np.int64)


def pairs_of(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each pair of values of int columns (N,) from 0 once, ascending, and (N,) which pair each row has."""
    count = int(other.max(initial=0)) + 1
    pairs, pair = np.unique(one.astype(np.int64) * count + other, return_inverse=True)
    return pairs // count, pairs % count, pair


def rows_of_groups(group: np.ndarray, count: int) -> list[np.ndarray]:
    """The rows of each group from 0, ascending; group (N,) int, negative for none."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.searchsorted(group[order], np.arange(count + 1)))[1:-1]


def strongest(
    group: np.ndarray,
    label: np.ndarray,
    weight: np.ndarray,
    count: int,
    of_equals: Literal["low", "high"] = "low",
) -> np.ndarray:
    """(count,) int64 the label with the largest weight of each group; -1 for empty groups.

    Args:
        group, label, weight: (N,), labels of a group once each.
        count: number of groups.
        of_equals: which of the labels with equal weights.
    """
    found = np.full(count, -1, np.int64)
    order = np.lexsort((-label if of_equals == "low" else label, weight))  # the last assignment wins
    found[group[order]] = label[order]
    return found


def grouped_sums(values: np.ndarray, group: np.ndarray, count: int = 0) -> np.ndarray:
    """(G,) or (G, C) float64 sum of each group's values, column by column.

    Args:
        values: (N,) or (N, C) numbers.
        group: (N,) int from 0.
        count: least number of groups G.
    """
    sums = np.stack([np.bincount(group, column, count) for column in np.atleast_2d(values.T)], axis=1)
    return sums.reshape(-1, *values.shape[1:])


def grouped_means(values: np.ndarray, group: np.ndarray, count: int = 0) -> np.ndarray:
    """As :func:`grouped_sums` the mean of each group's values, NaN for empty groups."""
    sums, number = grouped_sums(values, group, count), np.bincount(group, minlength=count)
    number = number.reshape(-1, *[1] * (values.ndim - 1))
    return np.where(number > 0, sums / np.maximum(number, 1), np.nan)


def place_of(keys: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(N,) int64 index of each wanted key (N,) among ascending keys; -1 where it is not among them."""
    if not len(keys):
        return np.full(len(wanted), -1, np.int64)
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[place] == wanted, place, -1)


def summed_by_key(pieces: Iterable[Keyed]) -> Keyed:
    """Each key of all pieces once, ascending, and the sum of its values, float64; those are (n,)."""
    empty = np.zeros(0, np.int64), np.zeros(0)
    return _merged(pieces, lambda values, _, place: np.bincount(place, values), [empty])


def first_by_key(pieces: Iterable[Keyed]) -> Keyed:
    """Each key of all pieces, of which there is at least one, once, ascending, and its first value."""
    return _merged(pieces, lambda values, first, _: values[first], [])


def _merged(
    pieces: Iterable[Keyed],
    combine: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    held: list[Keyed],
) -> Keyed:
    """Each key once; `combine` makes their values of all values, the keys' first rows and the rows' keys."""

    def merge(some: Sequence[Keyed]) -> Keyed:
        keys, values = (np.concatenate(arrays) for arrays in zip(*some, strict=True))
        keys, first, place = np.unique(keys, return_index=True, return_inverse=True)
        return keys, combine(values, first, place)

    for piece in pieces:
        held.append(merge([piece]))
        # Merging costs a sort of all keys, so that it waits until the pending ones are as many.
        if sum(len(keys) for keys, _ in held[1:]) > len(held[0][0]):
            held = [merge(held)]
    return merge(held)


def grouped_median(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Median of each group's values, column by column, as ``numpy.median``; 0 for empty groups.

    Args:
        values: (N,) or (N, C) floats.
        group: (N,) int in 0..count - 1.
        count: number of groups G.

    Returns:
        (G,) or (G, C) of the values' type.
    """
    size = np.bincount(group, minlength=count)
    known = size > 0
    size = size[known]
    longest = int(size.max(initial=0))
    padded = longest * len(size) <= MAX_PADDED * len(group)
    first = np.arange(len(size)) * longest if padded else np.cumsum(size) - size
    order = np.argsort(group, kind="stable") if padded else None
    medians = np.zeros((count, *values.shape[1:]), values.dtype)
    for column, median in zip(np.atleast_2d(values.T), np.atleast_2d(medians.T), strict=True):
        if order is None:
            ordered = column[np.lexsort((column, group))]
        else:  # sorting many short rows is several times as fast
            rows = np.full((len(size), longest), np.nan, values.dtype)
            rows[np.arange(longest) < size[:, None]] = column[order]
            ordered = np.sort(rows, axis=1, kind="stable").reshape(-1)  # NaN to the end
        median[known] = (ordered[first + (size - 1) // 2] + ordered[first + size // 2]) / 2
    return medians


def grouped_weighted_median(
    values: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int
) -> np.ndarray:
    """(count,) the value of each group up to which half of its weight lies; 0 for groups without weight.

    Args:
        values, weight: (N,) numbers; the weights are summed in their own type.
        group: (N,) int in 0..count - 1.
        count: number of groups.
    """
    if not len(values):
        return np.zeros(count, values.dtype)
    order = np.lexsort((values, group))
    size = np.bincount(group, minlength=count)
    end = np.cumsum(size)
    cumulative = np.concatenate([np.zeros(1, weight.dtype), np.cumsum(weight[order], dtype=weight.dtype)])
    before = cumulative[end - size]
    total = cumulative[end] - before
    place = np.searchsorted(cumulative[1:], before + 0.5 * total)
    return np.where(total > 0, values[order][np.minimum(place, len(values) - 1)], values.dtype.type(0))
