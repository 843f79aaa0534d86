"""Images with fewer pixels: means of radiance over the pixels that each covers, majorities of ids."""

from __future__ import annotations

import numpy as np


def means(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """The mean over the area of each pixel of an image at another size.

    Pixels across a border count with the share of their area, so that the mean of the image stays.

    Args:
        image: (H, W, C) float.
        width, height: of the result.

    Returns:
        (height, width, C) float32.
    """
    channels = image.shape[2]
    if image.shape[:2] == (height, width):
        return image.astype(np.float32)
    rows = _first_axis_means(image.reshape(image.shape[0], -1), height)
    turned = rows.reshape(height, -1, channels).swapaxes(0, 1).reshape(-1, height * channels)
    return np.ascontiguousarray(
        _first_axis_means(turned, width).reshape(width, height, channels).swapaxes(0, 1)
    )


def narrowed(image: np.ndarray, width: int) -> np.ndarray:
    """The image with the same proportions, at this width if it is wider."""
    if image.shape[1] <= width:
        return image
    return means(image, width, max(1, round(image.shape[0] * width / image.shape[1])))


def _first_axis_means(values: np.ndarray, count: int) -> np.ndarray:
    """(count, K) float32 means over equal lengths of the first axis of values (n, K)."""
    length = len(values)
    result = np.empty((count, values.shape[1]), np.float32)
    for index in range(count):
        # In units of 1 / count of a pixel all borders are whole numbers.
        begin, end = index * length, (index + 1) * length
        first, last = begin // count, -(-end // count)
        borders = np.clip(np.arange(first, last + 1) * count, begin, end)
        weights = (np.diff(borders) / length).astype(np.float32)
        result[index] = weights @ values[first:last]
    return result


def majority(ids: np.ndarray, width: int, height: int) -> np.ndarray:
    """The id that most of the pixels with their centre in each larger pixel have; the lowest of several.

    Args:
        ids: (H, W) int.
        width, height: of the result, at most W and H.

    Returns:
        (height, width) int32.
    """
    lowest = int(ids.min())
    present = np.zeros(int(ids.max()) - lowest + 1, bool)
    present[ids - lowest] = True
    known = np.flatnonzero(present)
    number = np.zeros(len(present), np.int32)
    number[known] = np.arange(len(known), dtype=np.int32)
    column = _target(ids.shape[1], width) * len(known)
    row = _target(ids.shape[0], height)
    result = np.empty((height, width), np.int32)
    # About 4 million counters at a time.
    step = max(1, (1 << 22) // (width * len(known)))
    for begin in range(0, height, step):
        end = min(begin + step, height)
        first, last = np.searchsorted(row, [begin, end])
        place = (row[first:last] - begin)[:, None] * (width * len(known)) + column
        place += number[ids[first:last] - lowest]
        counts = np.bincount(place.reshape(-1), minlength=(end - begin) * width * len(known))
        best = counts.reshape(end - begin, width, len(known)).argmax(axis=-1)
        result[begin:end] = known[best] + lowest
    return result


def _target(length: int, count: int) -> np.ndarray:
    """(length,) int64, in which of `count` equal lengths the centre of each pixel lies."""
    return (2 * np.arange(length) + 1) * count // (2 * length)
