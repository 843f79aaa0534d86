# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment of hand-held exposures: a shift and a turn, by Gauss-Newton on logarithms of their values.

Inverse compositional alignment (Baker and Matthews 2004, Lucas-Kanade 20 Years On) from coarse to fine, with
weights that leave out what is clipped, too dark or has moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..core.robust import deviation

FINEST_SIDE = 1024  # pixels of the longer side at which motion is measured
STILL_PIXELS = 0.15  # smaller motion of any corner, in pixels of the working size, is measurement noise
MOST_SHARE = 0.15  # of the longer side; larger motion is taken for a failure
# Standard deviation of the logarithm at the coarsest size, where noise is averaged out.
LEAST_CONTRAST = 0.02
LEAST_OVERLAP = 0.05  # share of pixels that must be usable in both
# Log values below that of about 1 % of the ceiling are mostly noise.
DARKEST, BRIGHTEST = 0.01, 0.95
_OUTLIER = 2.5  # residuals beyond this many (robust) standard deviations do not count


@dataclass(frozen=True)
class Motion:
    """From places of the reference to those of an exposure: a turn about the image's centre, then a shift.

    Attributes:
        x, y: shift in shares of the longer side.
        angle: radians, clockwise in the image.
        similarity: correlation of the two exposures once they are aligned, -1 to 1.
    """

    x: float = 0.0
    y: float = 0.0
    angle: float = 0.0
    similarity: float = 1.0

    def corner_shift(self, width: int, height: int) -> float:
        """The largest motion of a corner in pixels of an image of this size."""
        points = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
        return float(np.linalg.norm(self.apply(points, width, height) - points, axis=1).max())

    def apply(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """Places (n, 2) x, y in the exposure for places in the reference; (0, 0) is the image's corner."""
        side = max(width, height)
        x, y = points[:, 0] - width / 2.0, points[:, 1] - height / 2.0
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        # Written out: a product of matrices this narrow would wake all threads of the linear algebra library.
        across = cos * x - sin * y + (width / 2.0 + side * self.x)
        return np.stack([across, sin * x + cos * y + (height / 2.0 + side * self.y)], -1)


def after(first: Motion, second: Motion) -> Motion:
    """The motion of `second` as seen from the reference of `first`: first, then second."""
    cos, sin = np.cos(second.angle), np.sin(second.angle)
    x = cos * first.x - sin * first.y + second.x
    y = sin * first.x + cos * first.y + second.y
    return Motion(x, y, first.angle + second.angle, min(first.similarity, second.similarity))


def measure(reference: np.ndarray, exposure: np.ndarray) -> Motion:
    """The motion between two exposures of one scene.

    Args:
        reference, exposure: (height, width) linear values, 1 at the ceiling; NaN where they are clipped.

    Returns:
        No motion for bare walls, on which nothing can be followed. A `similarity` of -1 says that too few
        pixels are usable in both.
    """
    pyramids = [_pyramid(log_values(image)) for image in (reference, exposure)]
    coarse = pyramids[0][0][np.isfinite(pyramids[0][0])]
    if len(coarse) and coarse.std() < LEAST_CONTRAST:
        return Motion()
    motion = _searched(pyramids[0][0], pyramids[1][0])
    for first, second in zip(*pyramids, strict=True):
        motion = _refined(first, second, motion)
    return motion


def grey(values: np.ndarray, clipped: np.ndarray, side: int = FINEST_SIDE) -> np.ndarray:
    """(height, width) means of the channels, NaN where clipped, at most about `side` pixels long."""
    factor = max(1, -(-max(values.shape[:2]) // side))
    height, width = (size // factor * factor for size in values.shape[:2])
    mean = values[:height, :width].mean(axis=-1, dtype=np.float32)
    mean[clipped[:height, :width].any(axis=-1)] = np.nan
    return mean.reshape(height // factor, factor, width // factor, factor).mean(axis=(1, 3))


def warped(values: np.ndarray, motion: Motion, start: int, stop: int, margin: float = 0.0) -> np.ndarray:
    """Rows of an exposure in the reference's geometry, bilinear; NaN outside.

    Args:
        values: (height, width, channels), all rows.
        motion: of the exposure.
        start, stop: rows of the reference.
        margin: pixels beyond the border that have its values.
    """
    height, width = values.shape[:2]
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(start, stop) + 0.5)
    places = motion.apply(np.stack([x.ravel(), y.ravel()], -1), width, height) - 0.5
    low = int(np.clip(np.floor(places[:, 1].min()) - 1, 0, height - 1))
    high = int(np.clip(np.ceil(places[:, 1].max()) + 2, low + 1, height))
    rows = values[low:high].astype(np.float32)
    coordinates = [places[:, 1] - low, places[:, 0]]
    channels = [
        ndimage.map_coordinates(rows[..., c], coordinates, order=1, mode="nearest", output=np.float32)
        for c in range(values.shape[2])
    ]
    result = np.stack(channels, -1)
    # Half a pixel beyond the centres of the border's pixels still belongs to the image.
    reach = [width / 2 + margin, height / 2 + margin]
    inside = (np.abs(places + 0.5 - [width / 2, height / 2]) <= reach).all(axis=1)
    result[~inside] = np.nan
    return result.reshape(stop - start, width, -1)


def log_values(image: np.ndarray) -> np.ndarray:
    """Log of usable values, NaN elsewhere."""
    usable = (image > DARKEST) & (image < BRIGHTEST)
    return np.where(usable, np.log(np.where(usable, image, 1.0)), np.nan)


def _pyramid(image: np.ndarray) -> list[np.ndarray]:
    """The image at growing sizes; a pixel of a smaller one is usable if half of its four are."""
    levels = [image]
    while max(levels[0].shape) >= 96 and min(levels[0].shape) >= 16:
        last = levels[0]
        height, width = (size // 2 * 2 for size in last.shape)
        blocks = last[:height, :width].reshape(height // 2, 2, width // 2, 2)
        counts = np.isfinite(blocks).sum(axis=(1, 3))
        sums = np.nansum(blocks, axis=(1, 3))
        levels.insert(0, np.where(counts >= 2, sums / np.maximum(counts, 1), np.nan))
    return levels


def _searched(reference: np.ndarray, exposure: np.ndarray) -> Motion:
    """The best shift by whole pixels at the coarsest size, by the correlation of what both can use."""
    reach = int(np.ceil(MOST_SHARE * max(reference.shape)))
    height, width = reference.shape
    best, found = -2.0, Motion()
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            rows, columns = slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx))
            other_rows = slice(rows.start + dy, rows.stop + dy)
            a, b = (
                reference[rows, columns],
                exposure[other_rows, slice(columns.start + dx, columns.stop + dx)],
            )
            both = np.isfinite(a) & np.isfinite(b)
            if both.sum() < 2 * LEAST_OVERLAP * reference.size:
                continue
            value = _correlation(a[both], b[both])
            if value > best:
                best, found = value, Motion(dx / max(height, width), dy / max(height, width))
    return found


def _refined(reference: np.ndarray, exposure: np.ndarray, motion: Motion) -> Motion:
    """Gauss-Newton at one level; brightness may differ by a smooth function, up to the second power."""
    height, width = reference.shape
    side = max(height, width)
    known = np.flatnonzero(np.isfinite(reference))
    if len(known) < LEAST_OVERLAP * reference.size:
        return Motion(motion.x, motion.y, motion.angle, -1.0)
    known = known[:: max(1, len(known) // 40_000)]
    points = np.stack([known % width, known // width], -1) + 0.5
    target = reference.ravel()[known].astype(np.float64)
    for _ in range(20):
        places = motion.apply(points, width, height)
        values, slopes = _sampled(exposure, places)
        valid = np.isfinite(values)
        if valid.sum() < LEAST_OVERLAP * len(points):
            return Motion(motion.x, motion.y, motion.angle, -1.0)
        a, b, slopes = target[valid], values[valid], slopes[valid]
        # How a pixel's place changes with the angle: perpendicular to its way from the centre.
        arm = places[valid] - [width / 2.0 + side * motion.x, height / 2.0 + side * motion.y]
        turning = -slopes[:, 0] * arm[:, 1] + slopes[:, 1] * arm[:, 0]
        columns = np.stack(
            [
                slopes[:, 0] * side,
                slopes[:, 1] * side,
                turning,
                np.ones_like(b),
                b - b.mean(),
                (b - b.mean()) ** 2,
            ],
            -1,
        )
        tone = np.linalg.solve(
            _products(columns[:, 3:], columns[:, 3:]), _products(columns[:, 3:], a[:, None])
        )
        plain = np.einsum("ni,i->n", columns[:, 3:], tone[:, 0])
        residual = a - plain
        spread = deviation(residual) + 1e-6
        weighted = columns * (np.abs(residual) < _OUTLIER * spread)[:, None]
        step = np.linalg.solve(_products(weighted, columns), _products(weighted, residual[:, None]))[:, 0]
        motion = Motion(motion.x + step[0], motion.y + step[1], motion.angle + step[2])
        if max(abs(step[0]), abs(step[1]), abs(step[2])) * side < 2e-3:
            break
    return Motion(motion.x, motion.y, motion.angle, _correlation(a, plain))


def _products(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """first.T @ second, with a little on the diagonal of a square; in one thread, as these are small."""
    products = np.einsum("ni,nj->ij", first, second)
    if len(products) == products.shape[1]:
        products[np.diag_indices(len(products))] *= 1.0 + 1e-9
        products[np.diag_indices(len(products))] += 1e-12
    return products


def _sampled(image: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bilinear values (n,) and their slopes (n, 2) along x and y; NaN outside and beside unusable pixels."""
    height, width = image.shape
    x, y = places[:, 0] - 0.5, places[:, 1] - 0.5
    column = np.clip(np.floor(x).astype(int), 0, width - 2)
    row = np.clip(np.floor(y).astype(int), 0, height - 2)
    u, v = x - column, y - row
    outside = (np.minimum(u, v) < 0.0) | (np.maximum(u, v) > 1.0)
    a, b = image[row, column], image[row, column + 1]
    c, d = image[row + 1, column], image[row + 1, column + 1]
    values = (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v
    slopes = np.stack([(b - a) * (1 - v) + (d - c) * v, (c - a) * (1 - u) + (d - b) * u], -1)
    return np.where(outside, np.nan, values), slopes


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt(max((a * a).sum() * (b * b).sum(), 1e-20)))
