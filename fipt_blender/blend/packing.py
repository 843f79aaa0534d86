# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""UV islands as plain arrays: finding them, judging their overlap, packing them into images.

Numpy only. Packing is by shelves: islands sorted by height stand in rows from the bottom of an image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..core.textures.raster import cover_count

# Texels an island keeps free on each side; two neighbours are twice as far apart.
PAD = 4
# Islands that fill less of their box than this are cut, unless the box is small anyway.
MIN_FILL = 0.4
MIN_SPLIT_TEXELS = 4096


@dataclass
class Packing:
    """Where each island went."""

    image: np.ndarray  # (N,) i32
    offset: np.ndarray  # (N,2) f64 texels of the island's lower left corner
    scale: np.ndarray  # (N,) f64 factor on the extent that was asked for
    sizes: list[tuple[int, int]]  # width, height of each image


def connected_triangles(corners: np.ndarray) -> np.ndarray:
    """Connected components of triangles that share corner ids.

    Args:
        corners: (T,3) integer ids.

    Returns:
        (T,) i32 component of each triangle, numbered from 0 in order of first appearance.
    """
    if not len(corners):
        return np.zeros(0, np.int32)
    _, ids = np.unique(corners, return_inverse=True)
    ids = ids.reshape(-1, 3)
    label = np.arange(ids.max() + 1)
    while True:
        lowest = label[ids].min(axis=1)
        new = label.copy()
        for corner in range(3):
            np.minimum.at(new, ids[:, corner], lowest)
            # The label is itself a corner of the component: following it doubles the reach.
            np.minimum.at(new, label[ids[:, corner]], lowest)
        new = new[new]
        if np.array_equal(new, label):
            break
        label = new
    _, first, component = np.unique(label[ids[:, 0]], return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[component]


def uv_islands(vertex_ids: np.ndarray, corner_uv: np.ndarray) -> np.ndarray:
    """Islands of triangles that share a vertex at the same UV position.

    Args:
        vertex_ids: (T,3) the mesh's vertices.
        corner_uv: (T,3,2).

    Returns:
        (T,) i32 island of each triangle.
    """
    keys = np.empty((corner_uv.shape[0] * 3, 3), np.int64)
    keys[:, 0] = vertex_ids.ravel()
    keys[:, 1:] = np.round(corner_uv.reshape(-1, 2).astype(np.float64) * 1e6)
    order = np.lexsort(keys.T)
    new = np.any(np.diff(keys[order], axis=0) != 0, axis=1)
    ids = np.empty(len(keys), np.int64)
    ids[order] = np.concatenate([[0], np.cumsum(new)]) if len(keys) else 0
    return connected_triangles(ids.reshape(-1, 3))


def island_bounds(corner_uv: np.ndarray, island: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower left corners and extents of islands, each (N,2) f64."""
    count = int(island.max()) + 1 if len(island) else 0
    low = np.full((count, 2), np.inf)
    high = np.full((count, 2), -np.inf)
    for axis in range(2):
        np.minimum.at(low[:, axis], island, corner_uv[..., axis].min(axis=1))
        np.maximum.at(high[:, axis], island, corner_uv[..., axis].max(axis=1))
    return low, high - low


def turn_islands(corner_uv: np.ndarray, island: np.ndarray, steps: int = 18) -> np.ndarray:
    """Turn each island so that its bounding box is small and lies on its longer side, (T,3,2) f64.

    Args:
        corner_uv: (T,3,2).
        island: (T,) of `uv_islands`.
        steps: angles tried between 0 and 90 degrees.
    """
    best = island_bounds(corner_uv, island)[1].prod(axis=1) * 0.98  # turn only where it is worth it
    angle = np.zeros(len(best))
    for candidate in np.arange(1, steps) * (0.5 * np.pi / steps):
        area = island_bounds(_turn(corner_uv, np.full(len(corner_uv), candidate)), island)[1].prod(axis=1)
        better = area < best
        best, angle = np.where(better, area, best), np.where(better, candidate, angle)
    turned = _turn(corner_uv, angle[island])
    extent = island_bounds(turned, island)[1]
    upright = extent[:, 1] > extent[:, 0]
    return _turn(turned, np.where(upright, 0.5 * np.pi, 0.0)[island])


def split_sparse_islands(corners: np.ndarray, island: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Cut islands that leave most of their bounding box empty (mouldings, rings, frames) into pieces.

    Cuts run between polygons, halfway along the box's longer side. The fields are functions of space, so
    that a cut can't be seen.

    Args:
        corners: (T,3,2) texels.
        island: (T,).
        polygon: (T,) ids; a polygon's triangles stay together.

    Returns:
        (T,) i64 islands, numbered anew from 0.
    """
    area = triangle_areas(corners)
    _, polygon = np.unique(polygon, return_inverse=True)
    members = np.bincount(polygon)
    centre = np.stack(
        [np.bincount(polygon, corners[..., axis].mean(axis=1)) / members for axis in range(2)], axis=1
    )[polygon]
    island = island.astype(np.int64)
    for _ in range(8):
        low, extent = island_bounds(corners, island)
        box = extent.prod(axis=1)
        sparse = (box > MIN_SPLIT_TEXELS) & (np.bincount(island, area) < MIN_FILL * box)
        if not sparse.any():
            break
        axis = extent.argmax(axis=1)[island]
        middle = (low + 0.5 * extent)[island]
        beyond = np.take_along_axis(centre > middle, axis[:, None], axis=1)[:, 0]
        _, island = np.unique(island * 2 + (beyond & sparse[island]), return_inverse=True)
    return island


def _turn(corner_uv: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u, v = corner_uv[..., 0], corner_uv[..., 1]
    return np.stack([cosine * u - sine * v, sine * u + cosine * v], axis=-1)


def triangle_areas(corners: np.ndarray) -> np.ndarray:
    """Areas of triangles in the plane or in space, (T,) f64 from (T,3,2) or (T,3,3)."""
    corners = corners.astype(np.float64)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if corners.shape[2] == 2:
        return 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return 0.5 * np.linalg.norm(np.cross(first, second), axis=1)


def overlap_share(corner_uv: np.ndarray, island: np.ndarray, texels: int = 40_000) -> float:
    """Share of an object's covered texels that two of its triangles of one island claim, 0 to 1.

    Islands are laid out apart first: only an island that lies on itself can't be used.
    """
    low, extent = island_bounds(corner_uv, island)
    total = float((extent[:, 0] * extent[:, 1]).sum())
    if not np.isfinite(total) or total <= 0.0:
        return 1.0
    side = max(int(math.sqrt(texels * 2.0)), 64)
    packing = pack_islands(extent * math.sqrt(texels / total), np.zeros(len(extent), np.int32), side, 1, 64)
    shared = covered = 0
    placed = place(corner_uv, island, low, packing, math.sqrt(texels / total))
    for image, (width, height) in enumerate(packing.sizes):
        count = cover_count(placed[packing.image[island] == image], width, height)
        shared += int((count > 1).sum())
        covered += int((count > 0).sum())
    return shared / covered if covered else 1.0


def place(
    corner_uv: np.ndarray,
    island: np.ndarray,
    low: np.ndarray,
    packing: Packing,
    scale: float = 1.0,
) -> np.ndarray:
    """Corners in texels of their image, (T,3,2) f64.

    Args:
        corner_uv: (T,3,2).
        island: (T,).
        low: (N,2) of `island_bounds`.
        packing: of the islands' extents times `scale`.
        scale: texels a UV unit.
    """
    factor = (packing.scale * scale)[island][:, None, None]
    return (corner_uv - low[island][:, None]) * factor + packing.offset[island][:, None]


def pack_islands(
    extent: np.ndarray, group: np.ndarray, size: int, pad: int = PAD, max_images: int = 16
) -> Packing:
    """Pack rectangles into as few images as their area asks for.

    A group (object) that fills half an image gets images of its own; all others share. Where more than
    `max_images` would be needed everything shrinks; an island larger than an image shrinks alone.

    Args:
        extent: (N,2) wanted width and height in texels.
        group: (N,) i32.
        size: largest width and height of an image.
        pad: texels kept free around each island.
        max_images: most images.
    """
    shrink = 1.0
    while True:
        scale = shrink * np.minimum(
            1.0, (size - 2.0 * pad) / np.maximum(extent.max(axis=1, initial=1.0) * shrink, 1e-30)
        )
        boxes = np.ceil(extent * scale[:, None] - 1e-6).astype(np.int64) + 2 * pad
        packing = _pack_boxes(boxes, group, size)
        if len(packing.sizes) <= max_images:
            packing.offset += pad
            packing.scale = scale
            return packing
        if pad > 1 and (2 * pad) ** 2 * len(boxes) > 0.25 * max_images * size * size:
            pad -= 1  # The gaps alone fill the images: very many small islands.
        else:
            shrink *= 0.98 * math.sqrt(max_images / len(packing.sizes))
            if shrink < 1e-3 and pad <= 1:
                max_images = len(packing.sizes)


def _pack_boxes(boxes: np.ndarray, group: np.ndarray, size: int) -> Packing:
    area = np.bincount(group, (boxes[:, 0] * boxes[:, 1]).astype(np.float64))
    large = area > 0.5 * size * size
    sets = [np.flatnonzero(group == each) for each in np.flatnonzero(large)]
    sets.append(np.flatnonzero(~large[group]))
    image = np.zeros(len(boxes), np.int32)
    offset = np.zeros((len(boxes), 2))
    sizes: list[tuple[int, int]] = []
    for members in sets:
        if not len(members):
            continue
        wanted = 1.15 * float((boxes[members, 0] * boxes[members, 1]).sum())
        width = 1 << max(math.ceil(math.log2(math.sqrt(wanted))), 4)
        width = min(size, max(width, 1 << math.ceil(math.log2(boxes[members].max()))))
        page, x, y, heights = _shelves(boxes[members], width, size)
        image[members] = page + len(sizes)
        offset[members, 0], offset[members, 1] = x, y
        sizes += [(width, min(size, 16 * math.ceil(height / 16))) for height in heights]
    return Packing(image, offset, np.ones(len(boxes)), sizes)


def _shelves(
    boxes: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    page = np.zeros(len(boxes), np.int32)
    x = np.zeros(len(boxes), np.int64)
    y = np.zeros(len(boxes), np.int64)
    heights = [0]
    cursor = shelf = 0  # where the next box stands, and the foot of its shelf
    for index in np.lexsort((np.arange(len(boxes)), -boxes[:, 0], -boxes[:, 1])):
        box_width, box_height = int(boxes[index, 0]), int(boxes[index, 1])
        if cursor + box_width > width:
            cursor, shelf = 0, heights[-1]
        if shelf + box_height > height:
            heights.append(0)
            cursor = shelf = 0
        page[index], x[index], y[index] = len(heights) - 1, cursor, shelf
        cursor += box_width
        heights[-1] = max(heights[-1], shelf + box_height)
    return page, x, y, heights
