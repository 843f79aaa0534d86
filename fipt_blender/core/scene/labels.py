# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts: which triangles have the same material, for the regularisation of roughness and metallic.

They come from the mesh's objects or material slots, or from id images, which are fused onto the triangles by
majority so that all views agree (paper, supplementary "Semantic segmentation acquisition").
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..capture.views import View
from .components import mesh_components
from .room import Room

NO_PART = -1
_IDS = 1 << 32  # larger than any id


@dataclass(frozen=True)
class Parts:
    """The part of each triangle.

    Attributes:
        triangle_part: (T,) int32 from 0, NO_PART without one.
        kind: ``part`` (one material each), ``semantic`` (classes, each of several materials) or ``none``.
    """

    triangle_part: np.ndarray
    kind: str


def choose_parts(room: Room, views: Sequence[View], triangles: Sequence[np.ndarray]) -> Parts:
    """Parts from the source that room.json names; ``auto`` takes the finest available one.

    Args:
        triangles: for each view the (H * W,) triangle that each pixel sees, negative where none.
    """
    source = choose_source(room, views)
    # A generator: all images together may not fit into memory.
    images = (view.part_ids() if source == "masks" else view.semantic_ids() for view in views)
    return label_parts(room, source, images, triangles)


def usable_sources(room: Room, views: Sequence[View]) -> list[str]:
    """The sources that distinguish any surfaces, in the order in which ``auto`` prefers them."""
    usable = {
        "masks": any(view.parts for view in views),
        "semantics": any(view.semantics for view in views),
        "materials": len(np.unique(room.triangle_material)) > 1,
        "objects": len(np.unique(room.triangle_object)) > 1,
    }
    return [source for source, is_usable in usable.items() if is_usable]


def choose_source(room: Room, views: Sequence[View]) -> str:
    """The source that room.json names, with ``auto`` resolved; semantics or none where masks are missing.

    ``auto`` never takes loose pieces, because scans contain many fragments that are not parts.
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
        images: for masks and semantics the id image of each view, or None; not used for other sources.
        triangles: for each view the triangle that each pixel of its id image sees, negative where none.
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
    """(T,) int32 connected piece of each triangle, from 0; a piece never extends over several objects.

    Args:
        triangles: (T, 3) welded vertex indices; triangles that share a vertex are connected.
        objects: (T,) object of each triangle.
    """
    if not len(triangles):
        return np.zeros(0, np.int32)
    # A node for each vertex of each object.
    keys = triangles.astype(np.int64) + objects.astype(np.int64)[:, None] * (int(triangles.max()) + 1)
    corners = np.unique(keys, return_inverse=True)[1].reshape(-1, 3)
    return mesh_components(corners).astype(np.int32)


def fuse_masks(masks: Iterable[np.ndarray | None], triangles: Iterable[np.ndarray], count: int) -> np.ndarray:
    """The id that most pixels of each triangle have.

    Args:
        masks: (H, W) int ids of each view, or None; negative ids and 0 (nothing hit) do not count.
        triangles: for each view the (H * W,) triangle that each pixel sees, negative where none.
        count: number of triangles.

    Returns:
        (count,) int64 ids, NO_PART where no labelled pixel saw the triangle. Ties go to the lower id.
    """
    key, votes = np.zeros(0, np.int64), np.zeros(0, np.int64)
    pending: list[tuple[np.ndarray, np.ndarray]] = []
    for mask, triangle in zip(masks, triangles, strict=True):
        if mask is None:
            continue
        ids = mask.reshape(-1).astype(np.int64)
        valid = (ids > 0) & (triangle >= 0)
        pixel_keys = triangle[valid].astype(np.int64) * _IDS + ids[valid]
        pending.append(np.unique(pixel_keys, return_counts=True))
        # Merging costs a sort of all keys, so that it waits until the pending ones are as many.
        if sum(len(keys) for keys, _ in pending) > len(key):
            key, votes = _summed(key, votes, pending)
            pending = []
    key, votes = _summed(key, votes, pending)
    label = np.full(count, NO_PART, np.int64)
    # The last assignment to a triangle wins, so sort by votes, then by descending id.
    order = np.lexsort((-(key % _IDS), votes))
    label[key[order] // _IDS] = key[order] % _IDS
    return label


def _summed(
    key: np.ndarray, votes: np.ndarray, more: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Each key once, ascending, and the sum of its votes."""
    keys, counts = zip((key, votes), *more, strict=True)
    key, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.zeros(len(key), np.int64)
    np.add.at(total, inverse.reshape(-1), np.concatenate(counts))
    return key, total


def spread_labels(labels: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Give triangles without a label the highest label of their neighbours, ring by ring.

    Args:
        labels: (T,) int, negative for none.
        triangles: (T, 3) welded vertex indices; triangles that share a vertex are neighbours.

    Returns:
        (T,) int64, negative where no triangle of the connected piece has a label.
    """
    labels = labels.astype(np.int64).copy()
    # The triangles around each vertex, concatenated over the vertices.
    around = np.argsort(triangles, axis=None, kind="stable") // 3
    count = np.bincount(triangles.reshape(-1))
    first = np.cumsum(count) - count
    vertex_label = np.full(len(count), NO_PART, np.int64)
    ring = np.flatnonzero(labels >= 0)
    while len(ring):
        corners = triangles[ring].reshape(-1)
        np.maximum.at(vertex_label, corners, np.repeat(labels[ring], 3))
        touched = np.unique(corners)
        # Rows of `around`: count[touched] of them, starting at first[touched].
        ends = np.cumsum(count[touched])
        rows = np.arange(ends[-1]) + np.repeat(first[touched] + count[touched] - ends, count[touched])
        neighbours = around[rows]
        ring = np.unique(neighbours[labels[neighbours] < 0])
        labels[ring] = vertex_label[triangles[ring]].max(axis=1)
    return labels


def weld(vertices: np.ndarray) -> np.ndarray:
    """(V,) int64 index of each vertex after merging those at the same position (to 1e-6 of the extent)."""
    extent = float(np.ptp(vertices, axis=0).max(initial=0.0)) or 1.0
    cells = np.round(vertices.astype(np.float64) / (1e-6 * extent)).astype(np.int64)
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)


def _compact(labels: np.ndarray) -> np.ndarray:
    """(T,) int32 labels numbered from 0 without gaps; negative ones become NO_PART."""
    compact = np.full(len(labels), NO_PART, np.int32)
    known = labels >= 0
    compact[known] = np.unique(labels[known], return_inverse=True)[1]
    return compact
