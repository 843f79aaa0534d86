"""Alignment of hand-held exposures: a shift and a turn, by Gauss-Newton on logarithms of their values.

Inverse compositional alignment (Baker and Matthews 2004, Lucas-Kanade 20 Years On) from coarse to fine, with
weights that leave out what is clipped, too dark or has moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..core.robust import deviation
from .frames import block_mean, blocks

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
    """From places of the reference to those of an exposure: a turn about the image's centre, then a shift."""

    # x, y: shift in shares of the longer side
    x: float = 0.0
    y: float = 0.0
    angle: float = 0.0  # radians, clockwise in the image
    similarity: float = 1.0  # correlation of the two exposures once they are aligned, -1 to 1

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
    mean = values.mean(axis=-1, dtype=np.float32)
    mean[clipped.any(axis=-1)] = np.nan
    return block_mean(mean, max(1, -(-max(mean.shape) // side)))


def warped(values: np.ndarray, motion: Motion, start: int, stop: int, margin: int = 0) -> np.ndarray:
    """Rows of an exposure in the reference's geometry, bilinear; NaN outside.

    Args:
        values: (height, width, channels), all rows.
        motion: of the exposure.
        start, stop: rows of the reference.
        margin: pixels beyond the border that have its values.
    """
    height, width = values.shape[:2]
    cos, sin = np.cos(motion.angle), np.sin(motion.angle)
    matrix = np.array([[cos, sin], [-sin, cos]])  # of rows and columns
    origin = motion.apply(np.array([[0.5, start + 0.5]]), width, height)[0, ::-1] - 0.5
    reach = origin[0] + np.add.outer([0.0, cos * (stop - start - 1)], [0.0, sin * (width - 1)])
    low = int(np.clip(np.floor(reach.min()) - 1, 0, height - 1))
    high = int(np.clip(np.ceil(reach.max()) + 2, low + 1, height))
    rows = np.pad(values[low:high].astype(np.float32), ((margin,) * 2, (margin,) * 2, (0, 0)), "edge")
    shape, offset = (stop - start, width), origin + margin - [low, 0]
    moved = [
        ndimage.affine_transform(rows[..., c], matrix, offset, shape, order=1, cval=np.nan)
        for c in range(values.shape[2])
    ]
    return np.stack(moved, -1)


def log_values(image: np.ndarray) -> np.ndarray:
    """Log of usable values, NaN elsewhere."""
    usable = (image > DARKEST) & (image < BRIGHTEST)
    return np.where(usable, np.log(np.where(usable, image, 1.0)), np.nan)


def _pyramid(image: np.ndarray) -> list[np.ndarray]:
    """The image at growing sizes; a pixel of a smaller one is usable if half of its four are."""
    levels = [image]
    while max(levels[0].shape) >= 96 and min(levels[0].shape) >= 16:
        four = blocks(levels[0], 2)
        counts = np.isfinite(four).sum(axis=(1, 3))
        sums = np.nansum(four, axis=(1, 3))
        levels.insert(0, np.where(counts >= 2, sums / np.maximum(counts, 1), np.nan))
    return levels


def _searched(reference: np.ndarray, exposure: np.ndarray) -> Motion:
    """The best shift by whole pixels at the coarsest size, by the correlation of what both can use."""
    (height, width), side = reference.shape, max(reference.shape)
    reach = int(np.ceil(MOST_SHARE * side))
    padded = np.pad(exposure, reach, constant_values=np.nan)
    best, found = -2.0, Motion()
    for dy, dx in np.ndindex(2 * reach + 1, 2 * reach + 1):
        moved = padded[dy : dy + height, dx : dx + width]
        both = np.isfinite(reference) & np.isfinite(moved)
        if both.sum() < 2 * LEAST_OVERLAP * reference.size:
            continue
        value = _correlation(reference[both], moved[both])
        if value > best:
            best, found = value, Motion((dx - reach) / side, (dy - reach) / side)
    return found


def _refined(reference: np.ndarray, exposure: np.ndarray, motion: Motion) -> Motion:
    """Gauss-Newton at one level; brightness may differ by a smooth function, up to the second power."""
    height, width = reference.shape
    side = max(height, width)
    known = np.flatnonzero(np.isfinite(reference))
    overlap = len(known) / reference.size
    known = known[:: max(1, len(known) // 40_000)]
    points = np.stack([known % width, known // width], -1) + 0.5
    target = reference.ravel()[known]
    slopes = np.gradient(exposure)
    for _ in range(20):
        places = motion.apply(points, width, height)
        sampled = [
            ndimage.map_coordinates(image, places.T[::-1] - 0.5, order=1, cval=np.nan)
            for image in (exposure, *slopes)
        ]
        valid = np.isfinite(sampled).all(axis=0)
        if valid.sum() < LEAST_OVERLAP * len(points) or overlap < LEAST_OVERLAP:
            return replace(motion, similarity=-1.0)
        a, (b, down, across) = target[valid], (values[valid] for values in sampled)
        # How a pixel's place changes with the angle: perpendicular to its way from the centre.
        arm = places[valid] - [width / 2.0 + side * motion.x, height / 2.0 + side * motion.y]
        turning = down * arm[:, 0] - across * arm[:, 1]
        b = b - b.mean()
        columns = np.stack([across * side, down * side, turning, np.ones_like(b), b, b**2], -1)
        tone = columns[:, 3:]
        plain = np.einsum("ni,i->n", tone, _solved(tone, tone, a))
        residual = a - plain
        used = np.abs(residual) < _OUTLIER * deviation(residual, 1e-6)
        step = _solved(columns * used[:, None], columns, residual)
        motion = Motion(motion.x + step[0], motion.y + step[1], motion.angle + step[2])
        if np.abs(step[:3]).max() * side < 2e-3:
            break
    return replace(motion, similarity=_correlation(a, plain))


def _solved(weighted: np.ndarray, columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least squares in one thread, as these are small; a little on the diagonal decides what nothing does."""
    normal = np.einsum("ni,nj->ij", weighted, columns)
    normal[np.diag_indices(len(normal))] *= 1.0 + 1e-9
    normal[np.diag_indices(len(normal))] += 1e-12
    return np.linalg.solve(normal, np.einsum("ni,n->i", weighted, target))


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt(max((a * a).sum() * (b * b).sum(), 1e-20)))
