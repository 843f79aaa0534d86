"""Completes a picture of a surface from the parts of it that are known: patch-based, from coarse to fine.

Each patch of the hole is matched to the known patch that is most alike (PatchMatch: Barnes et al. 2009), and
the matched patches vote for the values of the hole (Wexler et al. 2007). Offsets by which the known cells
repeat are tried first, so that tiles and planks go on.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

PATCH = 7  # cells of a patch's side, odd
HALF = PATCH // 2
ROUNDS = (5, 2)  # of matching and voting on coarser levels and on the finest one; more change little
_RANDOM_TRIES = 5  # random matches that are tried in each round, within halved distances
_LEAST_SIDE = 24  # cells: the coarsest level has no smaller side
_TRUST = (
    1.3  # by which a cell counts less than its neighbour that is nearer to the known ones (Wexler et al.)
)
_PERIODS = 12  # offsets by which the known cells repeat that are tried as matches (He and Sun 2012)
_LEAST_OVERLAP = 0.15  # share of the known cells that an offset must map on known ones
_STEPS = [
    (step * y, step * x) for step in (1, 4) for y, x in ((0, 1), (0, -1), (1, 0), (-1, 0))
]  # to neighbours

_Level = tuple[np.ndarray, np.ndarray, np.ndarray]  # values (H, W, C), known and hole (H, W) bool


def complete(
    values: np.ndarray, known: np.ndarray, hole: np.ndarray, features: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Fill a hole with what lies around it.

    Args:
        values: (H, W, C) f32, 0 or more; finite where known.
        known: (H, W) bool, cells whose values are taken; some cell is known.
        hole: (H, W) bool, cells to fill, none of them known; other cells are no part of the surface.
        features: the first so many of the values decide which patches are alike.

    Returns:
        The values, and (H, W) int64 index of the cell that each cell of the hole was taken from.
    """
    nearest = _nearest(known)
    start = np.where(known[..., None], values, values.reshape(-1, values.shape[-1])[nearest])
    levels: list[_Level] = [(start.astype(np.float32), known, hole)]
    while min(levels[-1][1].shape) >= 2 * _LEAST_SIDE and _depths(levels[-1][2]).max() > HALF:
        levels.append(_halved(*levels[-1]))
    random = np.random.default_rng(0)
    match: np.ndarray | None = None
    for colors, sure, missing in reversed(levels):
        if _sources(sure).any():  # else the nearest cells stay
            rounds = ROUNDS[sure.shape == known.shape]
            match = _match(colors, sure, missing, match, features, rounds, random)
    if match is not None and match.shape[:2] == hole.shape:
        nearest = np.where(hole, match @ [hole.shape[1], 1], nearest)
    return np.where(hole[..., None], levels[0][0], values), nearest


def grown(mask: np.ndarray, cells: int = 1) -> np.ndarray:
    """A mask (H, W) with the cells beside it."""
    for _ in range(cells):
        padded = np.pad(mask, 1)
        beside = padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
        mask = mask | beside
    return mask


def _depths(hole: np.ndarray) -> np.ndarray:
    """(H, W) cells from the border of a hole (H, W), 1 at it and 0 outside; some cell lies outside."""
    depths = np.zeros(hole.shape, int)
    while hole.any():
        depths += hole
        hole = ~grown(~hole)
    return depths


def _halved(values: np.ndarray, known: np.ndarray, hole: np.ndarray) -> _Level:
    """A level of half the resolution: means of the known cells; a cell of which any is a hole is one."""
    height, width = known.shape[0] // 2, known.shape[1] // 2
    shape = (height, 2, width, 2)
    values, known, hole = (each[: 2 * height, : 2 * width] for each in (values, known, hole))
    weight = np.where(known, 1.0, 1e-6)[..., None]
    total = (values * weight).reshape(*shape, -1).sum(axis=(1, 3))
    mean = total / weight.reshape(*shape, 1).sum(axis=(1, 3))
    holes = hole.reshape(shape).any(axis=(1, 3))
    return mean.astype(np.float32), (known.reshape(shape).sum(axis=(1, 3)) > 1) & ~holes, holes


def _nearest(known: np.ndarray) -> np.ndarray:
    """(H, W) index of a known cell near each cell, by growing; some cell is known."""
    index = np.where(known, np.arange(known.size).reshape(known.shape), -1)
    while (index < 0).any():
        padded = np.pad(index, 1, constant_values=-1)
        for near in (padded[2:, 1:-1], padded[:-2, 1:-1], padded[1:-1, 2:], padded[1:-1, :-2]):
            index = np.where(index < 0, near, index)
    return index


def _sources(known: np.ndarray) -> np.ndarray:
    """(H, W) bool: centres of patches that are known throughout."""
    padded = np.pad(known, HALF)
    return np.asarray(sliding_window_view(padded, (PATCH, PATCH)).all(axis=(-1, -2)))


def _match(
    values: np.ndarray,
    known: np.ndarray,
    hole: np.ndarray,
    coarser: np.ndarray | None,
    features: int,
    rounds: int,
    random: np.random.Generator,
) -> np.ndarray:
    """Match and vote on a level, whose values change; (H, W, 2) row and column of each patch's match."""
    shape = np.array(known.shape)
    usable = _sources(known)
    choices = np.argwhere(usable)
    inside = np.zeros(known.shape, bool)
    inside[HALF:-HALF, HALF:-HALF] = True
    centers = np.argwhere(grown(hole, HALF) & inside)
    rows, columns = centers.T
    present = choices[random.integers(len(choices), size=len(rows))]
    trust = np.where(known | hole, _TRUST ** -_depths(hole).astype(float), 0.0)
    weights = sliding_window_view(trust, (PATCH, PATCH))[rows - HALF, columns - HALF]
    weights = (weights / weights.sum(axis=(1, 2), keepdims=True)).astype(np.float32)

    def take(candidate: np.ndarray) -> None:
        """Take the candidates (N, 2) that are more alike than the present matches."""
        rows_of = np.clip(candidate, 0, shape - 1)
        chosen = np.flatnonzero((rows_of == candidate).all(axis=1) & usable[tuple(rows_of.T)])
        found = likeness(candidate[chosen], chosen)
        better = found < error[chosen]
        error[chosen[better]], present[chosen[better]] = found[better], candidate[chosen[better]]

    def likeness(match: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        place = match - HALF
        difference = own[chosen] - windows[place[:, 0], place[:, 1]]
        return np.einsum("nijc,nijc,nij->n", difference, difference, weights[chosen])

    match = np.zeros((*known.shape, 2), np.int64)
    if coarser is not None:
        limit = np.array(coarser.shape[:2]) - 1
        guess = 2 * coarser[tuple(np.minimum(centers // 2, limit).T)] + centers % 2
        fits = (guess < shape).all(axis=1)
        fits[fits] &= usable[tuple(guess[fits].T)]
        present[fits] = guess[fits]
        _vote(values, hole, centers, present, np.ones(len(rows)))
    periods = _periods(np.sqrt(values[..., :features]), known)
    for number in range(rounds):
        roots = np.sqrt(np.maximum(values[..., :features], 0.0))  # nearer to what is seen than radiances
        windows = sliding_window_view(roots, (PATCH, PATCH, features))[:, :, 0]
        own = windows[rows - HALF, columns - HALF]
        error = likeness(present, np.arange(len(rows)))
        match[rows, columns] = present
        for step in _STEPS:  # what the neighbour has found, moved as far as it lies from here
            near = match[tuple(np.clip(centers - step, 0, shape - 1).T)]
            take(np.where(near.any(axis=1, keepdims=True), near + step, -1))
        for period in periods if number == 0 else ():
            take(centers + period)
        for attempt in range(1, _RANDOM_TRIES + 1):
            span = max(int(shape.max()) >> attempt, 1)
            take(present + random.integers(-span, span + 1, size=present.shape))
        scale = max(float(np.quantile(error, 0.75)), 1e-12)
        _vote(values, hole, centers, present, trust[rows, columns] * (np.exp(-error / scale) + 1e-6))
    match[rows, columns] = present
    border = [np.clip(np.arange(side), HALF, side - 1 - HALF) for side in known.shape]
    return match[np.ix_(*border)]  # cells at the border, which no patch has as its centre, as the next one


def _periods(roots: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(N, 2) offsets by which known cells (H, W) repeat best, in rows and columns."""
    shape = [2 * side for side in known.shape]
    mask = np.fft.rfft2(known.astype(float), shape)
    overlap = np.fft.irfft2(np.abs(mask) ** 2, shape)
    total = np.zeros(shape)
    for channel in np.moveaxis(np.where(known[..., None], roots, 0.0), -1, 0):
        first, second = np.fft.rfft2(channel, shape), np.fft.rfft2(channel**2, shape)
        total += np.fft.irfft2(2.0 * (second * mask.conj()).real - 2.0 * np.abs(first) ** 2, shape)
    mean = np.where(overlap > _LEAST_OVERLAP * known.sum(), total / np.maximum(overlap, 1.0), np.inf)
    neighbours = [np.roll(mean, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    lowest = np.argwhere(np.isfinite(mean) & (mean <= np.minimum.reduce(neighbours)))
    lowest = lowest[np.argsort(mean[tuple(lowest.T)], kind="stable")]
    offsets = (lowest + known.shape) % shape - known.shape
    return offsets[np.abs(offsets).max(axis=1) >= HALF][:_PERIODS]


def _vote(
    values: np.ndarray, hole: np.ndarray, centers: np.ndarray, match: np.ndarray, weight: np.ndarray
) -> None:
    """The hole's values become the weighted means of what the matches of all patches over them say."""
    total, share = np.zeros(values.shape), np.zeros(hole.shape)
    for offset in np.ndindex(PATCH, PATCH):
        place, source = (tuple((each + offset - HALF).T) for each in (centers, match))
        total[place] += weight[:, None] * values[source]
        share[place] += weight
    chosen = hole & (share > 0.0)
    values[chosen] = total[chosen] / share[chosen][:, None]
