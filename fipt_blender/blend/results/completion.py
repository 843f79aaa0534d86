# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Completes a picture of a surface from the parts of it that are known: patch-based, from coarse to fine.

Each patch of the hole is matched to the known patch that is most alike (PatchMatch: Barnes et al. 2009), and
the matched patches vote for the values of the hole (Wexler et al. 2007). Offsets by which the known cells
repeat are tried first, so that tiles and planks go on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

PATCH = 7  # cells of a patch's side, odd: planks and weaves of 5 mm cells repeat within some patches
ROUNDS = 5  # of matching and voting on each level; more change little
_RANDOM_TRIES = 5  # random matches that are tried in each round, within halved distances
_LEAST_SIDE = 24  # cells: the coarsest level has no smaller side
_TRUST = (
    1.3  # by which a cell counts less than its neighbour that is nearer to the known ones (Wexler et al.)
)
_PERIODS = 24  # offsets by which the known cells repeat that are tried as matches (He and Sun 2012)
_LEAST_OVERLAP = 0.15  # share of the known cells that an offset must map on known ones
_MOST_CELLS = 20_000_000  # values that are compared at a time, 80 MB


@dataclass
class _Level:
    """One level of the pyramid: values (H, W, C), known and hole (H, W) bool."""

    values: np.ndarray
    known: np.ndarray
    hole: np.ndarray


def complete(
    values: np.ndarray, known: np.ndarray, hole: np.ndarray, features: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Fill a hole with what lies around it.

    Args:
        values: (H, W, C) f32, 0 or more; finite where known.
        known: (H, W) bool, cells whose values are taken.
        hole: (H, W) bool, cells to fill; the others are no part of the surface, unless they are known.
        features: the first so many of the values decide which patches are alike.

    Returns:
        The values, and (H, W) int64 index of the cell that each cell of the hole was taken from; of others
        their own. Without a known cell nothing changes.
    """
    hole = hole & ~known
    own = np.arange(known.size).reshape(known.shape)
    if not hole.any() or not known.any():
        return values.copy(), own
    levels = [_Level(np.where(known[..., None], values, 0.0).astype(np.float32), known, hole)]
    while min(levels[-1].known.shape) >= 2 * _LEAST_SIDE and _depths(levels[-1].hole).max() > PATCH // 2:
        levels.append(_halved(levels[-1]))
    random = np.random.default_rng(0)
    match = None
    for level in reversed(levels):
        _start(level)
        if not _sources(level.known).any():
            match = None  # too little is known here: the mean of what is near stays
            continue
        match = _match(level, match, features, random)
    finest = levels[0]
    source = own.copy()
    if match is not None:
        source[finest.hole] = own[match[finest.hole, 0], match[finest.hole, 1]]
    else:
        nearest = _nearest(finest.known)
        source[finest.hole] = nearest[finest.hole]
    return np.where(hole[..., None], finest.values, values), source


def _depths(hole: np.ndarray) -> np.ndarray:
    """(H, W) cells from the border of a hole (H, W), 1 at it and 0 outside; some cell lies outside."""
    depths = np.zeros(hole.shape, int)
    while hole.any():
        depths += hole
        hole = shrunk(hole)
    return depths


def grown(mask: np.ndarray, cells: int = 1) -> np.ndarray:
    """A mask (H, W) with the cells beside it."""
    for _ in range(cells):
        padded = np.pad(mask, 1)
        mask = np.logical_or.reduce(
            [mask, padded[2:, 1:-1], padded[:-2, 1:-1], padded[1:-1, 2:], padded[1:-1, :-2]]
        )
    return mask


def shrunk(mask: np.ndarray) -> np.ndarray:
    """A mask (H, W) without its outermost cells; those at the picture's border stay."""
    return ~grown(~mask)


def _halved(level: _Level) -> _Level:
    """Means of two by two cells; of known ones where there is one."""
    height, width = level.known.shape
    pad = ((0, height % 2), (0, width % 2))
    known = np.pad(level.known, pad)
    values = np.pad(level.values * level.known[..., None], (*pad, (0, 0)))
    shape = (known.shape[0] // 2, 2, known.shape[1] // 2, 2)
    count = known.reshape(shape).sum(axis=(1, 3))
    total = values.reshape(*shape, -1).sum(axis=(1, 3))
    hole = np.pad(level.hole, pad).reshape(shape).any(axis=(1, 3))
    return _Level(total / np.maximum(count, 1)[..., None], (count > 1) & ~hole, hole)


def _nearest(known: np.ndarray) -> np.ndarray:
    """(H, W) index of a known cell near each cell, by growing; some cell is known."""
    index = np.where(known, np.arange(known.size).reshape(known.shape), -1)
    while (index < 0).any():
        padded = np.pad(index, 1, constant_values=-1)
        for near in (padded[2:, 1:-1], padded[:-2, 1:-1], padded[1:-1, 2:], padded[1:-1, :-2]):
            index = np.where(index < 0, near, index)
    return index


def _start(level: _Level) -> None:
    """Give a hole the values of the nearest known cells, where a coarser level has given it none."""
    if not level.values[level.hole].any():
        flat = level.values.reshape(-1, level.values.shape[-1])
        level.values[level.hole] = flat[_nearest(level.known)[level.hole]]


def _sources(known: np.ndarray) -> np.ndarray:
    """(H, W) bool: centres of patches that are known throughout."""
    half = PATCH // 2
    result = np.zeros_like(known)
    if min(known.shape) >= PATCH:
        windows = sliding_window_view(known, (PATCH, PATCH))
        result[half:-half, half:-half] = windows.all(axis=(-1, -2))
    return result


def _match(
    level: _Level, coarser: np.ndarray | None, features: int, random: np.random.Generator
) -> np.ndarray:
    """Match and vote; (H, W, 2) row and column of the match of each patch. The level's values change."""
    half = PATCH // 2
    shape = level.known.shape
    usable = _sources(level.known)
    choices = np.argwhere(usable)
    inside = np.zeros(shape, bool)
    inside[half:-half, half:-half] = True
    rows, columns = np.nonzero(grown(level.hole, half) & inside)
    if not len(rows):  # the hole lies at the picture's border alone
        return choices[np.zeros(shape, int)]
    match = np.zeros((*shape, 2), np.int64)
    match[rows, columns] = choices[random.integers(len(choices), size=len(rows))]
    if coarser is not None:
        guess = 2 * coarser[rows // 2, columns // 2] + np.stack([rows % 2, columns % 2], axis=1)
        fits = (guess < shape).all(axis=1)
        fits[fits] &= usable[guess[fits, 0], guess[fits, 1]]
        match[rows[fits], columns[fits]] = guess[fits]
        _vote(level, match, rows, columns, np.ones(len(rows)))
    trust = np.where(level.known | level.hole, _TRUST ** -_depths(level.hole).astype(float), 0.0)
    trust = trust.astype(np.float32)
    reach = max(shape)
    periods = _periods(level, features)
    centers = np.stack([rows, columns], axis=1)
    everywhere = np.ones(len(rows), bool)
    for _ in range(ROUNDS):
        compare = _Likeness(level, trust, features, rows, columns)
        present = match[rows, columns]
        error = compare(present)
        steps = [(step * y, step * x) for step in (1, 4) for y, x in ((0, 1), (0, -1), (1, 0), (-1, 0))]
        for dy, dx in steps:  # what the neighbour has found, moved as far as it lies from here
            near = (
                np.clip(rows - dy, half, shape[0] - 1 - half),
                np.clip(columns - dx, half, shape[1] - 1 - half),
            )
            known_match = match[near] + [dy, dx]
            _take(known_match, match[near].any(axis=1), usable, compare, present, error)
            match[rows, columns] = present
        for period in periods:
            _take(centers + period, everywhere, usable, compare, present, error)
        for attempt in range(_RANDOM_TRIES):
            span = max(reach >> (attempt + 1), 1)
            moved = present + random.integers(-span, span + 1, size=present.shape)
            _take(moved, everywhere, usable, compare, present, error)
        match[rows, columns] = present
        scale = max(float(np.quantile(error, 0.75)), 1e-12)
        _vote(level, match, rows, columns, trust[rows, columns] * (np.exp(-error / scale) + 1e-6))
    return _at_border(match, half)


def _periods(level: _Level, features: int) -> np.ndarray:
    """(N, 2) offsets by which the known cells repeat best, in rows and columns: least differences."""
    shape = [2 * side for side in level.known.shape]
    known = np.fft.rfft2(level.known.astype(float), shape)
    overlap = np.fft.irfft2(np.abs(known) ** 2, shape)
    total = np.zeros(shape)
    for channel in range(features):
        root = np.where(level.known, np.sqrt(np.maximum(level.values[..., channel], 0.0)), 0.0)
        first, second = np.fft.rfft2(root, shape), np.fft.rfft2(root**2, shape)
        total += np.fft.irfft2(2.0 * (second * known.conj()).real - 2.0 * np.abs(first) ** 2, shape)
    enough = overlap > _LEAST_OVERLAP * level.known.sum()
    mean = np.where(enough, total / np.maximum(overlap, 1.0), np.inf)
    neighbours = [np.roll(mean, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    lowest = np.argwhere(np.isfinite(mean) & (mean <= np.minimum.reduce(neighbours)))
    lowest = lowest[np.argsort(mean[tuple(lowest.T)], kind="stable")]
    offsets = (lowest + level.known.shape) % shape - level.known.shape
    return offsets[np.abs(offsets).max(axis=1) >= PATCH // 2][:_PERIODS]


def _take(
    candidate: np.ndarray,
    valid: np.ndarray,
    usable: np.ndarray,
    compare: _Likeness,
    present: np.ndarray,
    error: np.ndarray,
) -> None:
    """Take candidates (N, 2) that are more alike than the present matches (N, 2), which change."""
    valid = valid & (candidate >= 0).all(axis=1) & (candidate < usable.shape).all(axis=1)
    valid[valid] &= usable[candidate[valid, 0], candidate[valid, 1]]
    chosen = np.flatnonzero(valid)
    found = compare(candidate[chosen], chosen)
    better = found < error[chosen]
    error[chosen[better]] = found[better]
    present[chosen[better]] = candidate[chosen[better]]


class _Likeness:
    """Squared differences of patches, of the roots of values, which are nearer to what is seen."""

    def __init__(
        self, level: _Level, weight: np.ndarray, features: int, rows: np.ndarray, columns: np.ndarray
    ) -> None:
        half = PATCH // 2
        roots = np.sqrt(np.maximum(level.values[..., :features], 0.0))
        self._windows = sliding_window_view(roots, (PATCH, PATCH, roots.shape[2]))[:, :, 0]
        weights = sliding_window_view(weight, (PATCH, PATCH))
        self._half, self._rows, self._columns = half, rows - half, columns - half
        own = weights[self._rows, self._columns]
        self._weights = own / own.sum(axis=(1, 2), keepdims=True)

    def __call__(self, match: np.ndarray, chosen: np.ndarray | None = None) -> np.ndarray:
        """(N,) of the matches (N, 2) of the chosen patches, all by default."""
        chosen = np.arange(len(self._rows)) if chosen is None else chosen
        result = np.empty(len(chosen), np.float32)
        chunk = max(_MOST_CELLS // (PATCH * PATCH * self._windows.shape[-1]), 1)
        for start in range(0, len(chosen), chunk):
            rows = chosen[start : start + chunk]
            place = match[start : start + chunk] - self._half
            difference = self._windows[self._rows[rows], self._columns[rows]]
            difference = difference - self._windows[place[:, 0], place[:, 1]]
            result[start : start + chunk] = np.einsum(
                "nijc,nijc,nij->n", difference, difference, self._weights[rows], optimize=False
            )
        return result


def _vote(
    level: _Level, match: np.ndarray, rows: np.ndarray, columns: np.ndarray, weight: np.ndarray
) -> None:
    """The hole's values become the weighted means of what the matches of all patches over them say."""
    half = PATCH // 2
    total = np.zeros_like(level.values, np.float64)
    share = np.zeros(level.known.shape)
    source = match[rows, columns]
    for dy in range(-half, half + 1):
        for dx in range(-half, half + 1):
            total[rows + dy, columns + dx] += (
                weight[:, None] * level.values[source[:, 0] + dy, source[:, 1] + dx]
            )
            share[rows + dy, columns + dx] += weight
    chosen = level.hole & (share > 0.0)
    level.values[chosen] = total[chosen] / share[chosen][:, None]


def _at_border(match: np.ndarray, half: int) -> np.ndarray:
    """Matches with those at the picture's border, which no patch has as its centre: of the next patch."""
    height, width = match.shape[:2]
    rows = np.clip(np.arange(height), half, height - 1 - half)[:, None]
    columns = np.clip(np.arange(width), half, width - 1 - half)[None]
    return match[rows, columns]
