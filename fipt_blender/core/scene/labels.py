# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts: which triangles are of one material, for the regularisation of roughness and metallic.

From the mesh's objects or material slots, or from id images, fused onto the triangles by majority so that
all views agree (paper, supplementary "Semantic segmentation acquisition").
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..capture.views import View
from .room import Room

NO_PART = -1
_IDS = 1 << 32  # more than any id


@dataclass(frozen=True)
class Parts:
    """A part for each triangle.

    Attributes:
        triangle_part: (T,) int32 from 0, NO_PART without one.
        kind: ``part`` (one material each), ``semantic`` (classes of several materials) or ``none``.
    """

    triangle_part: np.ndarray
    kind: str


def choose_parts(room: Room, views: Sequence[View], triangles: Sequence[np.ndarray]) -> Parts:
    """Parts from the source that room.json names; ``auto`` takes the finest that there is.

    Args:
        triangles: for each view the (H * W,) triangle seen by each pixel, negative where none.
    """
    source = choose_source(room, views)
    # One after the other: all of them may not fit into memory.
    images = (view.part_ids() if source == "masks" else view.semantic_ids() for view in views)
    return label_parts(room, source, images, triangles)


def usable_sources(room: Room, views: Sequence[View]) -> list[str]:
    """The sources that tell any surfaces apart here, in the order in which ``auto`` prefers them."""
    usable = {
        "masks": any(view.parts for view in views),
        "semantics": any(view.semantics for view in views),
        "materials": len(np.unique(room.triangle_material)) > 1,
        "objects": len(np.unique(room.triangle_object)) > 1,
    }
    return [source for source, use in usable.items() if use]


def choose_source(room: Room, views: Sequence[View]) -> str:
    """The source that room.json names, what ``auto`` stands for, or what is left where masks are missing.

    ``auto`` never takes loose pieces: scans are full of fragments that are no parts.
    """
    usable = usable_sources(room, views)
    source = room.parts
    if source == "auto":
        return usable[0] if usable else "none"
    if source == "masks" and "masks" not in usable:
        source = "semantics"
    return "none" if source == "semantics" and "semantics" not in usable else source


def label_parts(
    room: Room, source: str, images: Iterable[np.ndarray | None], triangles: Iterable[np.ndarray]
) -> Parts:
    """Parts from one source.

    Args:
        source: masks, semantics, materials, objects, loose or none.
        images: for masks and semantics the id image of each view, or None; else not looked at.
        triangles: for each view the triangle seen by each pixel of its id image, negative where none.
    """
    if source == "objects":
        return Parts(room.triangle_object.astype(np.int32), "part")
    if source == "materials":
        return Parts(_compact(room.triangle_material), "part")
    if source == "loose":
        return Parts(room_pieces(room), "part")
    if source in ("masks", "semantics"):
        fused = fuse_masks(images, triangles, len(room.triangles))
        spread = spread_labels(fused, weld(room.vertices)[room.triangles])
        return Parts(_compact(spread), "part" if source == "masks" else "semantic")
    return Parts(np.full(len(room.triangles), NO_PART, np.int32), "none")


def room_pieces(room: Room) -> np.ndarray:
    """(T,) int32 connected piece of each triangle of a room; takes seconds for millions of triangles."""
    return loose_pieces(weld(room.vertices)[room.triangles], room.triangle_object)


def loose_pieces(triangles: np.ndarray, objects: np.ndarray) -> np.ndarray:
    """(T,) int32 connected piece of each triangle, from 0; pieces never reach across objects.

    Args:
        triangles: (T, 3) welded vertex indices; triangles that share a vertex are connected.
        objects: (T,) object of each triangle.
    """
    if not len(triangles):
        return np.zeros(0, np.int32)
    # one vertex for each object that uses it
    keys = triangles.astype(np.int64) + objects.astype(np.int64)[:, None] * (int(triangles.max()) + 1)
    corner = np.unique(keys, return_inverse=True)[1].reshape(-1, 3)
    root = np.arange(int(corner.max()) + 1)
    while True:
        low = root[corner].min(axis=1)
        before = root.copy()
        for axis in range(3):  # each root learns of the lowest one that it touches
            np.minimum.at(root, before[corner[:, axis]], low)
        while (root[root] != root).any():
            root = root[root]
        if np.array_equal(root, before):
            return _compact(root[corner[:, 0]])


def fuse_masks(masks: Iterable[np.ndarray | None], triangles: Iterable[np.ndarray], count: int) -> np.ndarray:
    """Each triangle takes the id that most of its pixels have.

    Args:
        masks: (H, W) int ids of each view, or None; negative ids and 0 (nothing hit) do not count.
        triangles: (H * W,) triangle seen by each pixel of each view, negative where none.
        count: number of triangles.

    Returns:
        (count,) int64 ids, NO_PART where no labelled pixel saw the triangle. Ties go to the lower id.
    """
    key, votes = np.zeros(0, np.int64), np.zeros(0, np.int64)
    waiting: list[tuple[np.ndarray, np.ndarray]] = []
    for mask, triangle in zip(masks, triangles, strict=True):
        if mask is None:
            continue
        ids = mask.reshape(-1).astype(np.int64)
        valid = (ids > 0) & (triangle >= 0)
        found = triangle[valid].astype(np.int64) * _IDS + ids[valid]
        waiting.append(np.unique(found, return_counts=True))
        if sum(len(more) for more, _ in waiting) > len(key):  # rarer and rarer: sorting takes time
            key, votes = _summed(key, votes, waiting)
            waiting = []
    key, votes = _summed(key, votes, waiting)
    label = np.full(count, NO_PART, np.int64)
    # The last assignment to a triangle wins, so sort by votes, then by descending id.
    order = np.lexsort((-(key % _IDS), votes))
    label[key[order] // _IDS] = key[order] % _IDS
    return label


def _summed(
    key: np.ndarray, votes: np.ndarray, more: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Each key once, with its votes in all."""
    keys, numbers = zip((key, votes), *more, strict=True)
    key, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.zeros(len(key), np.int64)
    np.add.at(total, inverse.reshape(-1), np.concatenate(numbers))
    return key, total


def spread_labels(labels: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Give triangles without a label the highest one among their neighbours, ring by ring.

    Args:
        labels: (T,) int, negative without.
        triangles: (T, 3) welded vertex indices; triangles are neighbours where they share a vertex.
    """
    labels = labels.astype(np.int64).copy()
    # The triangles around each vertex, one vertex after the other.
    around = np.argsort(triangles, axis=None, kind="stable") // 3
    number = np.bincount(triangles.reshape(-1))
    first = np.cumsum(number) - number
    vertex = np.full(len(number), NO_PART, np.int64)
    ring = np.flatnonzero(labels >= 0)
    while len(ring):
        corners = triangles[ring].reshape(-1)
        np.maximum.at(vertex, corners, np.repeat(labels[ring], 3))
        touched = np.unique(corners)
        # Rows of `around`: number[touched] of them from first[touched] on.
        ends = np.cumsum(number[touched])
        rows = np.arange(ends[-1]) + np.repeat(first[touched] + number[touched] - ends, number[touched])
        beside = around[rows]
        ring = np.unique(beside[labels[beside] < 0])
        labels[ring] = vertex[triangles[ring]].max(axis=1)
    return labels


def weld(vertices: np.ndarray) -> np.ndarray:
    """(V,) int64 index of each vertex after merging those at the same place (to 1e-6 of the extent)."""
    extent = float(np.ptp(vertices, axis=0).max(initial=0.0)) or 1.0
    cells = np.round(vertices.astype(np.float64) / (1e-6 * extent)).astype(np.int64)
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)


def _compact(labels: np.ndarray) -> np.ndarray:
    """(T,) int32 labels numbered from 0 without gaps; negative ones become NO_PART."""
    result = np.full(len(labels), NO_PART, np.int32)
    known = labels >= 0
    result[known] = np.unique(labels[known], return_inverse=True)[1]
    return result
