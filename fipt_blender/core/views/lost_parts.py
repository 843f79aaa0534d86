# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces of parts that a scanner lost, from their masks in several views.

Scanners do not see glossy or dark things. Where the masks show a part in front of the scan, an upright prism
is the simplest shape that has its outlines: a table, a cabinet, a slab.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_closing, binary_fill_holes, binary_opening, label
from scipy.special import bdtrc  # scipy.stats takes half a second to import

from ..geometry.adjacency import NONE
from ..geometry.prism import prism
from ..robust import LEAST_VIEWS
from .masked_views import MISSES, MaskedView, grid_points

# A part is lost if most of its pixels meet other surfaces in more views than chance explains.
LEVEL = 0.05
# Least intersection over union of the pixels of a part and of its prism: they agree more than they disagree.
LEAST_OVERLAP = 0.5
# Cells of the first, coarse search, in cells of the second.
COARSE = 5
_MOST_POINTS = 4_000_000


# Vertices (V, 3), triangles (T, 3), corner normals (T, 3, 3), and plane (T,) or NONE of each triangle.
Surface = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def lost_parts(
    masked: Sequence[MaskedView], bounds: tuple[np.ndarray, np.ndarray], edge: float
) -> list[Surface]:
    """Prisms for the parts of part masks that a scan lost.

    Args:
        masked: what the training views show.
        bounds: lowest and highest corner of the scan, metres.
        edge: median edge of the scan, metres.

    Returns:
        for each its surface, whose triangles are on no planes.
    """
    found = (_prism(masked, part, bounds, edge) for part in _lost(masked))
    return [each for each in found if each is not None]


def _lost(masked: Sequence[MaskedView]) -> list[int]:
    """Ids of the parts that are lost, by a sign test over the views, and that are not the bright outside."""
    found, pixels, bright = (
        np.array([getattr(one, name) for one in masked]) for name in ("found", "pixels", "bright")
    )
    lost = []
    for part in np.flatnonzero(pixels.any(axis=0)):
        seen = pixels[:, part] > 0
        misses = int((2 * found[seen, part] < pixels[seen, part]).sum())
        if (
            part > 0
            and unlikely(misses, int(seen.sum()))
            and 2 * bright[:, part].sum() < pixels[:, part].sum()
        ):
            lost.append(int(part))
    return lost


def unlikely(count: int, views: int) -> bool:
    """Whether so many of the views or more are more than chance explains (sign test)."""
    return bool(bdtrc(count - 1, views, 0.5) < LEVEL)


def _prism(
    masked: Sequence[MaskedView], part: int, bounds: tuple[np.ndarray, np.ndarray], edge: float
) -> Surface | None:
    """The prism of a part, None where none has its outlines."""
    shown = [one.shown(part) for one in masked]
    sizes = [
        one.distance[(image > 0) & np.isfinite(one.distance)] / one.view.fx
        for one, image in zip(masked, shown, strict=True)
    ]
    every = np.concatenate(sizes)
    cell = max(edge, float(np.median(every)) if len(every) else 0.0)
    low, high = bounds
    for step in (COARSE * cell, cell):
        shape = np.maximum(np.ceil((high - low) / step).astype(int), 1)
        if np.prod(shape) > _MOST_POINTS:
            return None
        yes, no = _votes(masked, shown, grid_points(low, step, shape), edge)
        yes, no = yes.reshape(shape), no.reshape(shape)
        if step == cell:
            break
        body = largest_piece((yes >= LEAST_VIEWS) & (yes >= no))
        if body is None:
            return None
        places = np.argwhere(body)
        low, high = low + (places.min(axis=0) - 1) * step, low + (places.max(axis=0) + 2) * step
    found = _fitted(masked, shown, (yes, no), (low, cell), edge)
    if found is None:
        return None
    footprint, first, last = found
    mesh = prism(footprint, low + [0.0, 0.0, first * cell], cell, last - first + 1)
    return *mesh, np.full(len(mesh[1]), NONE)


def _votes(
    masked: Sequence[MaskedView], shown: Sequence[np.ndarray], points: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int, how many views show the part at each point (N, 3), and how many show another."""
    yes, no = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for one, image in zip(masked, shown, strict=True):
        rows, y, x = one.seen(points, tolerance)
        yes[rows] += image[y, x] > 0
        no[rows] += image[y, x] < 0
    return yes, no


def largest_piece(mask: np.ndarray) -> np.ndarray | None:
    """The largest connected piece, None of nothing."""
    pieces, count = label(mask)
    if not count:
        return None
    return np.asarray(pieces == 1 + np.argmax(np.bincount(pieces.reshape(-1))[1:]))


def _fitted(
    masked: Sequence[MaskedView],
    shown: Sequence[np.ndarray],
    votes: tuple[np.ndarray, np.ndarray],
    grid: tuple[np.ndarray, float],
    tolerance: float,
) -> tuple[np.ndarray, int, int] | None:
    """Footprint, lowest and highest layer of the prism that fits the masks best, None where none fits.

    The best layer grows up and down as long as it fits better.
    """
    low, cell = grid
    yes, no = votes

    def overlap(first: int, last: int) -> tuple[float, np.ndarray]:
        agree, differ = (counts[:, :, first : last + 1].sum(axis=2) for counts in (yes, no))
        layers = last - first + 1
        body = (agree >= LEAST_VIEWS * layers) & (differ <= MISSES * (agree + differ))
        piece = largest_piece(binary_opening(np.pad(body, 1))[1:-1, 1:-1])
        if piece is None:
            return 0.0, body
        footprint = np.asarray(binary_fill_holes(piece))
        column, row = np.nonzero(footprint)
        places = np.stack([np.tile(column, layers), np.tile(row, layers)], axis=1)
        height = np.repeat(np.arange(first, last + 1), len(column))[:, None]
        points = low + (np.concatenate([places, height], axis=1) + 0.5) * cell
        return _overlap(masked, shown, points, cell, tolerance), footprint

    layers = yes.shape[2]
    score, first, last = max((overlap(layer, layer)[0], layer, layer) for layer in range(layers))
    while True:
        pairs = [
            (first - down, last + up)
            for down, up in ((1, 0), (0, 1), (1, 1), (2, 0), (0, 2))
            if first >= down and last + up < layers
        ]
        better = max(((overlap(*pair)[0], *pair) for pair in pairs), default=(0.0, 0, 0))
        if better[0] <= score:
            break
        score, first, last = better
    return None if score < LEAST_OVERLAP else (overlap(first, last)[1], first, last)


def _overlap(
    masked: Sequence[MaskedView],
    shown: Sequence[np.ndarray],
    points: np.ndarray,
    cell: float,
    tolerance: float,
) -> float:
    """Intersection over union of the part's pixels and those of cells around points (N, 3)"""
    both = either = 0
    for one, image in zip(masked, shown, strict=True):
        covered = np.zeros(image.shape, bool)
        rows, y, x = one.seen(points, tolerance)
        covered[y, x] = True
        if len(rows):
            distance = np.median(np.linalg.norm(points[rows] - one.place, axis=1))
            size = int(np.ceil(one.view.fx * cell / distance)) + 1
            covered = binary_closing(np.pad(covered, size), np.ones((size, size)))[size:-size, size:-size]
        both += int((covered & (image > 0)).sum())
        either += int(((covered & (image != 0)) | (image > 0)).sum())
    return both / max(either, 1)
