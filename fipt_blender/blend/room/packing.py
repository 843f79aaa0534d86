"""Packing UV islands into images by shelves: sorted by height, they stand in rows from the bottom up.

Numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# Texels kept free on each side of an island; neighbours are twice as far apart.
PAD = 4
_FILL = 0.85  # of an image that shelves fill: what has no place is on another image


@dataclass
class Packing:
    """Where each island lies."""

    image: np.ndarray  # (N,) i32
    offset: np.ndarray  # (N,2) f64 texels of the island's lower left corner
    scale: np.ndarray  # (N,) f64 factor on the wanted extent
    sizes: list[tuple[int, int]]  # width, height of each image


def pack_islands(
    extent: np.ndarray, group: np.ndarray, size: int, pad: int = PAD, max_images: int = 16
) -> Packing:
    """Pack rectangles into as few images as their area needs.

    A group (part) lies on as few images as possible, unless more than `max_images` were needed. Where they
    are all the same, all islands are scaled down, and so is an island that is larger than an image.

    Args:
        extent: (N,2) wanted width and height in texels.
        group: (N,) int, the group of each island.
        size: largest width and height of an image.
        pad: texels kept free around each island.
        max_images: the most images.
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
        if group.any():  # groups that are kept together leave more of the images empty
            group = np.zeros_like(group)
        elif pad > 1 and (2 * pad) ** 2 * len(boxes) > 0.25 * max_images * size * size:
            pad -= 1  # very many small islands, whose padding alone fills the images
        else:
            shrink *= 0.98 * math.sqrt(max_images / len(packing.sizes))
            if shrink < 1e-3 and pad <= 1:
                max_images = len(packing.sizes)


def pack_apart(extent: np.ndarray, group: np.ndarray, size: int) -> Packing:
    """Pack the islands of each group into an image of its own, in the order of the groups' numbers.

    Args:
        extent, group, size: as for `pack_islands`; a group that does not fit is scaled down.
    """
    result = _empty(len(extent))
    for index, value in enumerate(np.unique(group)):
        members = np.flatnonzero(group == value)
        packing = pack_islands(extent[members], np.zeros(len(members), np.int64), size, PAD, max_images=1)
        result.image[members] = index
        result.offset[members], result.scale[members] = packing.offset, packing.scale
        result.sizes.append(packing.sizes[0])
    return result


def _pack_boxes(boxes: np.ndarray, group: np.ndarray, size: int) -> Packing:
    area = np.bincount(group, (boxes[:, 0] * boxes[:, 1]).astype(np.float64))
    sharing: list[list[int]] = []  # groups that share an image
    left: list[float] = []  # its free area, texels; of a group that needs several, that of all
    room = _FILL * size * size
    for index in np.argsort(-area, kind="stable")[: np.count_nonzero(area)].tolist():
        place = next((place for place, free in enumerate(left) if area[index] <= free), len(left))
        if place == len(left):
            sharing.append([])
            left.append(room * max(math.ceil(area[index] / room), 1))
        sharing[place].append(index)
        left[place] -= area[index]
    image = np.zeros(len(boxes), np.int32)
    offset = np.zeros((len(boxes), 2))
    sizes: list[tuple[int, int]] = []
    for groups in sharing:
        members = np.flatnonzero(np.isin(group, groups))
        box_area = 1.15 * float((boxes[members, 0] * boxes[members, 1]).sum())
        width = 1 << max(math.ceil(math.log2(math.sqrt(box_area))), 4)
        width = min(size, max(width, 1 << math.ceil(math.log2(boxes[members].max()))))
        page, x, y, heights = _shelves(boxes[members], width, size)
        image[members] = page + len(sizes)
        offset[members, 0], offset[members, 1] = x, y
        # Powers of two, as graphics processors and other programs want them.
        sizes += [(width, min(size, 1 << max(math.ceil(math.log2(height)), 4))) for height in heights]
    packing = _empty(len(boxes))
    packing.image, packing.offset, packing.sizes = image, offset, sizes
    return packing


def _empty(count: int) -> Packing:
    """Of so many islands, of which none lies anywhere yet."""
    return Packing(np.zeros(count, np.int32), np.zeros((count, 2)), np.ones(count), [])


def _shelves(
    boxes: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    page = np.zeros(len(boxes), np.int32)
    x = np.zeros(len(boxes), np.int64)
    y = np.zeros(len(boxes), np.int64)
    heights = [0]
    cursor = shelf = 0  # left edge of the next box, and bottom of its shelf
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


def place(
    corner_uv: np.ndarray, island: np.ndarray, low: np.ndarray, packing: Packing, scale: float = 1.0
) -> np.ndarray:
    """Corners in texels of their image, (T,3,2) f64.

    Args:
        corner_uv: (T,3,2).
        island: (T,).
        low: (N,2) of `island_bounds`.
        packing: result of `pack_islands` for the islands' extents times `scale`.
        scale: texels per UV unit.
    """
    factor = (packing.scale * scale)[island][:, None, None]
    return (corner_uv - low[island][:, None]) * factor + packing.offset[island][:, None]
