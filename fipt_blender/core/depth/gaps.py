"""What depth cameras lose between measured pixels: black, shining and narrow surfaces.

The inverse of the depth is linear on a plane, so that a plane on both sides of a gap is continued exactly.
Between two surfaces at different depths that would be a curtain: steep ones are left out, and fusion keeps
only what no image looks through.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .range_image import RangeImage

# Change of the depth across a gap, in the gap's width; more is an edge between two surfaces.
STEEPEST = 1.0


def gap_image(image: RangeImage) -> RangeImage:
    """The depths of the pixels that were not measured, from those in their rows and columns that were.

    Pixels with no measurement on two opposite sides stay 0, and so do the measured ones.
    """
    known = image.depth > 0.0
    inverse = np.divide(1.0, image.depth, out=np.zeros(known.shape), where=known)
    along, weights = _continued(inverse, known, image.fx)
    across, others = (values.T for values in _continued(inverse.T, known.T, image.fy))
    total = np.where(known, 0.0, weights + others)
    mean = (weights * along + others * across) / np.maximum(total, 1e-12)
    depth = np.divide(1.0, mean, out=np.zeros(known.shape), where=(total > 0.0) & (mean > 0.0))
    return replace(image, depth=depth.astype(np.float32), weight=None)


def _continued(inverse: np.ndarray, known: np.ndarray, focal: float) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depths (H, W) between the known pixels of each row, and their weights, 0 without both sides."""
    height, width = inverse.shape
    place, row = np.broadcast_to(np.arange(width), known.shape), np.arange(height)[:, None]
    before = np.maximum.accumulate(np.where(known, place, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, place, width)[:, ::-1], axis=1)[:, ::-1]
    between = (before >= 0) & (after < width)
    before, after = np.maximum(before, 0), np.minimum(after, width - 1)
    start, end, gap = inverse[row, before], inverse[row, after], np.maximum(after - before, 1)
    # |1 / start - 1 / end| against the gap's width at the nearer side
    level = np.abs(end - start) * focal <= STEEPEST * gap * np.minimum(start, end)
    values = start + (end - start) * (place - before) / gap
    return values, np.where(between & level, 1.0 / gap, 0.0)
