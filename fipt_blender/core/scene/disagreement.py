# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of a scan whose mask names another part than the mesh: they show another surface than they hit."""

from __future__ import annotations

import numpy as np

from ..capture.views import View
from .labels import Parts, at_border
from .pixels import PixelStore
from .room import Room

# Weight of pixels that are adjacent to another id: the photograph mixes both there, wherever the border of
# the mesh is.
BESIDE = 0.1
# Pixels at borders are doubted only in parts of whose pixels at least this share lies away from borders: thin
# parts have hardly any other pixels.
LEAST_INNER = 0.5


def doubt_pixels(store: PixelStore, room: Room, parts: Parts) -> int:
    """Lower the weight of the pixels whose masks and mesh disagree; they are mixed pixels from then on.

    Modelled rooms are left as they are.

    Args:
        store: changed in place, after unmixing.

    Returns:
        Number of pixels that show another part than they hit.
    """
    if room.scan is None or not len(parts.ids):
        return 0
    thin = _thin_parts(store, parts)
    total = 0
    for index, view in enumerate(store.views):
        mask = mask_of(view, parts.kind)
        if mask is None:
            continue
        rows = store.rows(index)
        triangle = np.asarray(store.triangle[rows])
        other, beside = disagreeing(mask, triangle, parts)
        beside &= ~thin[_part_of(triangle, parts)]
        store.weight[rows] = np.where(other, 0.0, np.where(beside, BESIDE, 1.0)) * store.weight[rows]
        store.pure[rows] = store.pure[rows] & ~(other | beside)
        total += int(np.count_nonzero(other))
    return total


def _thin_parts(store: PixelStore, parts: Parts) -> np.ndarray:
    """(P + 1,) bool, parts with few pixels away from the borders of their masks; the last row: no part."""
    inner, every = np.zeros((2, len(parts.ids) + 1))
    for index, view in enumerate(store.views):
        mask = mask_of(view, parts.kind)
        if mask is None:
            continue
        triangle = np.asarray(store.triangle[store.rows(index)])
        other, beside = disagreeing(mask, triangle, parts)
        part = _part_of(triangle, parts)
        every += np.bincount(part[~other], minlength=len(every))
        inner += np.bincount(part[~other & ~beside], minlength=len(every))
    thin: np.ndarray = inner < LEAST_INNER * every
    thin[-1] = False
    return thin


def _part_of(triangle: np.ndarray, parts: Parts) -> np.ndarray:
    """(N,) int64 part of pixels that see triangles (N,), the number of parts for none."""
    part = np.append(parts.triangle_part, np.int32(-1))[np.maximum(triangle, -1)].astype(np.int64)
    return np.where(part >= 0, part, len(parts.ids))


def mask_of(view: View, kind: str) -> np.ndarray | None:
    """(H, W) ids of the view's image from which parts of this kind come, or None."""
    return view.part_ids() if kind == "part" else view.semantic_ids()


def disagreeing(mask: np.ndarray, triangle: np.ndarray, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """Two (H * W,) bool: pixels that show another part than they hit, and pixels at a border of the mask.

    Args:
        mask: (H, W) int ids; 0 and negative ones are unknown.
        triangle: (H * W,) triangle of each pixel, negative where none.
    """
    ids = mask.reshape(-1).astype(np.int64)
    part = np.append(parts.triangle_part, np.int32(-1))[np.maximum(triangle, -1)]
    known = (triangle >= 0) & (part >= 0) & (ids > 0)
    other = known & (np.append(parts.ids, 0)[part] != ids)
    return other, (triangle >= 0) & at_border(mask).reshape(-1)
