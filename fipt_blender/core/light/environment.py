"""Environment map from the pixels that miss the mesh.

Paper Sec. 5.4, "Complex emitters": each pixel of the map is estimated like the emission of a triangle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..conventions import direction_to_equirect
from ..pixels.grouped import grouped_median
from ..pixels.store import NO_TRIANGLE, PixelStore
from ..run.result_contents import MissingLamp

# A smaller observed share of the sphere is a hole in the mesh, not a window; extrapolated to all directions,
# it would light the room through all other holes.
MIN_SHARE = 1e-3
# Most pixels, on average, for the median of a cell of the map; bounds memory for any number of views.
MAX_PIXELS = 200


@dataclass(frozen=True, eq=False)
class Hull:
    """Radiance that enters through the box around a mesh, by the place where a ray leaves it.

    Attributes:
        low, high: (3,) corners of the box, metres.
        counts: (3,) int cells along its sides.
        radiance: (C, 3) float32 of each cell, six for each place on a grid, one a side; negative where it is
            that of the environment's image.
    """

    low: np.ndarray
    high: np.ndarray
    counts: np.ndarray
    radiance: np.ndarray

    @classmethod
    def around(cls, bounds: tuple[np.ndarray, np.ndarray], size: float) -> Hull:
        """A box that sends no light of its own, whose cells are `size` metres wide, around bounds."""
        margin = 1e-3 * float((bounds[1] - bounds[0]).max())
        low, high = np.asarray(bounds[0], np.float64) - margin, np.asarray(bounds[1], np.float64) + margin
        counts = np.maximum(np.round((high - low) / size).astype(np.int64), 1)
        return cls(low, high, counts, np.full((int(counts.prod()) * 6, 3), -1.0, np.float32))

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """(..., 3) middles of the sides of cells, on the box, metres."""
        place = np.stack(np.unravel_index(cells // 6, tuple(self.counts)), axis=-1) + 0.5
        outwards = np.where(cells % 2 == 1, 0.5, -0.5)[..., None] * np.eye(3)[cells % 6 // 2]
        return np.asarray((place + outwards) / self.counts * (self.high - self.low) + self.low)

    def cells(self, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(...,) int64 cells through which rays from points (..., 3) leave the box along (..., 3).

        Points outside of it start where they are nearest to it.
        """
        start, way = np.clip(start, self.low, self.high), np.where(np.abs(direction) < 1e-9, 1e-9, direction)
        reach = np.where(way > 0.0, self.high - start, self.low - start) / way
        side = reach.argmin(axis=-1)
        place = start + np.take_along_axis(reach, side[..., None], axis=-1) * way
        cell = ((place - self.low) / (self.high - self.low) * self.counts).astype(np.int64)
        x, y, z = np.moveaxis(np.clip(cell, 0, self.counts - 1), -1, 0)
        positive = np.take_along_axis(way, side[..., None], axis=-1)[..., 0] > 0.0
        return np.asarray(((x * self.counts[1] + y) * self.counts[2] + z) * 6 + 2 * side + positive)


@dataclass(frozen=True, eq=False)
class Environment:
    """Radiance from outside by direction.

    Attributes:
        image: (H, 2H, 3) float32 equirectangular map in Blender's layout, world axes; directions that no
            pixel saw show the hull as it looks from its middle.
        observed_share: 0..1, solid-angle share of the map that some pixel saw.
        seen: (H, 2H) bool, where that is.
        unseen_light: 0..1, share of the light on the surfaces that is only inferred (:mod:`.unseen_light`).
        unseen_error: standard deviation of the logarithm of the light on the surfaces, because of it.
        unseen: (T,) float32 share of the directions in which inferred lamps are close; None without.
        hull: radiance from all other directions, by place; None without inferred light.
        entries: (E,) int64 cache entries of unseen surfaces, and their inferred `radiance` (E, 3).
        lamps: balls and discs that cast the light of the bright sources of it.
        pixels: (N,) int64 from which it was inferred, and the `light` (N, 3) on them: irradiance over pi.
    """

    image: np.ndarray
    observed_share: float
    seen: np.ndarray
    unseen_light: float = 0.0
    unseen_error: float = 0.0
    unseen: np.ndarray | None = None
    hull: Hull | None = None
    entries: np.ndarray | None = None
    radiance: np.ndarray | None = None
    lamps: tuple[MissingLamp, ...] = ()
    pixels: np.ndarray | None = None
    light: np.ndarray | None = None


def outside_pixels(pixels: PixelStore) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """World directions (m, 3) and radiance (m, 3) of the pixels that miss the mesh, view by view."""
    for index, view in enumerate(pixels.views):
        rows = pixels.rows(index)
        # Mixed pixels contain the colour of the window's frame; cracks of the mesh have mixed pixels only.
        missed = np.flatnonzero((pixels.triangle[rows] == NO_TRIANGLE) & pixels.pure[rows])
        if len(missed):
            yield view.rays()[1][missed], np.asarray(pixels.radiance[missed + rows.start])


def estimate_environment(
    outside: Callable[[], Iterable[tuple[np.ndarray, np.ndarray]]], width: int, rng: np.random.Generator
) -> Environment | None:
    """Median radiance of the pixels in each cell of the map; None if hardly any pixel looks outside.

    Cells without pixels take the radiance of the nearest observed ones (diffused outwards), so that a window
    seen from a few places lights the room from all angles. At most about `MAX_PIXELS` random pixels per cell
    are used.

    Args:
        outside: returns a new iterable at each call, of unit world directions (n, 3) of pixels that miss the
            mesh and their radiance (n, 3), in chunks.
        width: of the map in pixels; the height is half of it.
    """
    height = width // 2
    count = np.zeros(height * width, np.int64)
    for directions, _ in outside():
        count += np.bincount(map_cells(directions, width), minlength=len(count))
    if not count.any():
        return None
    share_kept = MAX_PIXELS / np.maximum(count, 1)
    cells, kept = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.float32)]
    for directions, radiance in outside():
        cell = map_cells(directions, width)
        chosen = rng.random(len(cell)) < share_kept[cell]
        cells.append(cell[chosen])
        kept.append(radiance[chosen])
    cell, radiance = np.concatenate(cells), np.concatenate(kept)
    image = grouped_median(radiance, cell, height * width).astype(np.float32)
    known = np.bincount(cell, minlength=height * width) > 0
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    weight = np.repeat(np.cos(latitude), width)
    share = float(weight[known].sum() / weight.sum())
    if share < MIN_SHARE:
        return None
    seen = known.reshape(height, width)
    return Environment(diffused(image.reshape(height, width, 3), seen), share, seen)


def map_cells(directions: np.ndarray, width: int) -> np.ndarray:
    """(...,) int64 row-major cell of the map, `width` cells wide, for each direction (..., 3)."""
    height = width // 2
    uv = direction_to_equirect(directions)
    column = np.clip((uv[..., 0] * width).astype(np.int64), 0, width - 1)
    # v counts up from the lower edge, rows count down from the upper one
    row = np.clip(((1.0 - uv[..., 1]) * height).astype(np.int64), 0, height - 1)
    return row * width + column


def diffused(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill unknown cells by the mean of known neighbours, ring by ring; columns wrap around."""
    image, known = image.copy(), known.copy()
    while not known.all():
        sums = np.zeros_like(image)
        count = np.zeros(known.shape, np.float32)
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            mask = np.roll(known, step, axis=axis)
            values = np.roll(image, step, axis=axis)
            if axis == 0:  # the poles do not wrap
                mask[0 if step == 1 else -1] = False
            sums += values * mask[..., None]
            count += mask
        reach = ~known & (count > 0)
        image[reach] = sums[reach] / count[reach][:, None]
        known |= reach
    return image
