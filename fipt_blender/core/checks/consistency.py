"""The consistency table: what each view shows of each cell, a small piece of the room's surface.

Photographs of one surface point agree, apart from gloss, if exposures, poses and mesh are right. Checks of
these read the table, which is made anew where pixels or mesh have changed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from ..capture.views import View, photographs_of
from ..light.cache import side_index
from ..light.observations import median_footprint
from ..pixels.camera_rays import rays_along
from ..pixels.grouped import grouped_means, summed_by_key
from ..pixels.store import CELL_PIXELS, LEFT_OUT, PixelStore, TracedView, traced
from ..robust import deviation, without_means
from ..surface.room import Room

# Radiance below this share of the capture's median is too dark to compare exposures; it is clamped to it.
DARK = 0.02
# Radiance in units of the median, below which differences of colours count less.
FLOOR = 0.05
# Most cells along the room's longest side.
MOST_CELLS = 1024
# Photographs are compared on a lattice of pixels of about this width.
REGISTERED_WIDTH = 320
# Exposures are estimated from about this many pixels.
GAIN_PIXELS = 1_000_000
# Cells that a view must share with others before its exposure is judged.
SHARED_CELLS = 30
# Least standard deviation of the logarithm of a cell's radiance in a view.
LEAST_SPREAD = 0.01
# Rounds in which cells and views are weighted by their residuals.
_ROUNDS = 8


@dataclass(frozen=True)
class CellGrid:
    """How surface points are sorted into cells by position, side and part."""

    part: np.ndarray  # (T,) int part of each triangle, negative without
    side: np.ndarray  # (T,) int64 dominant direction of each triangle's normal
    low: np.ndarray  # (3,) corner of a cell below the room, metres
    size: float  # edge of a cell, metres

    @classmethod
    def of(cls, room: Room, size: float, part: np.ndarray | None = None) -> CellGrid:
        """The grid of a room for pixels of this width on its surfaces, metres; without parts where None."""
        low, high = room.bounds
        edge = max(CELL_PIXELS * size, float((high - low).max()) / MOST_CELLS)
        part = np.full(len(room.triangles), -1) if part is None else part
        # Cells of one size are the same on every mesh.
        return cls(part, side_index(room.normals), edge * np.floor(low / edge), edge)

    def keys(self, seen: PixelStore | TracedView, rows: np.ndarray) -> np.ndarray:
        """(M,) int64 key of the cell that each pixel (M,) sees; equal where the cells are."""
        place = np.floor((np.asarray(seen.position[rows]) - self.low) / self.size).astype(np.int64) + 1
        place = np.clip(place, 0, MOST_CELLS + 3)
        triangle = np.asarray(seen.triangle[rows])
        key = (place[:, 0] * (MOST_CELLS + 4) + place[:, 1]) * (MOST_CELLS + 4) + place[:, 2]
        key = key * 12 + self.side[triangle] * 2 + np.asarray(seen.front[rows])
        return key * (int(self.part.max(initial=0)) + 2) + self.part[triangle] + 1


@dataclass(frozen=True)
class ConsistencyTable:
    """The surface cells that V views saw.

    Only the cells are kept: their number depends on the surface. Pixels are looked up view by view with their
    current values, so that pixels left out and corrected exposures count from then on.
    """

    pixels: PixelStore
    grid: CellGrid  # how pixels are sorted into cells
    keys: np.ndarray  # (count,) int64 key of each cell, ascending
    pixel_count: int  # number of pixels that the cells were made of
    colored: bool  # whether colours are compared (C of 3), or grey (C of 1)

    @classmethod
    def of(
        cls,
        pixels: PixelStore,
        room: Room,
        size: float,
        part: np.ndarray | None = None,
        colored: bool = False,
    ) -> ConsistencyTable:
        """Sort the pure pixels into cells by position, side and part.

        Args:
            size: width of a pixel on the surfaces, metres.
            part: (T,) int part of each triangle, negative without; None where parts do not count.
        """
        spacing = float(np.median([lattice_spacing(view) for view in pixels.views]))
        grid = CellGrid.of(room, spacing * size, part)
        views = (grid.keys(pixels, lattice_hits(pixels, index)) for index in range(len(pixels.views)))
        keys, count = summed_by_key((keys, np.ones(len(keys))) for keys in views)
        return cls(pixels, grid, keys, int(count.sum()), colored)

    def values(self, rows: np.ndarray | slice) -> np.ndarray:
        """(M, C) float64 log of the radiance of pixels (M,)."""
        radiance = np.asarray(self.pixels.radiance[rows])
        if self.colored:
            return np.log(np.maximum(radiance, 0.0, dtype=np.float64) + FLOOR)
        return np.log(np.maximum(radiance.mean(axis=1, dtype=np.float64), DARK))[:, None]

    def of_view(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The lattice pixels of a view that see a single surface of the mesh.

        Returns:
            (M,) int64 pixels among those of all views, ascending, (M,) int64 their cells, and (M, C) values.
        """
        rows = lattice_hits(self.pixels, index)
        return rows, np.searchsorted(self.keys, self.grid.keys(self.pixels, rows)), self.values(rows)

    def means(
        self, step: int = 1, without: Collection[int] = ()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """View (K,) and cell (K,) of each `step`-th cell in each view, and the mean (K, C) of its values."""
        found = []
        for index in range(len(self.pixels.views)):
            _, cell, value = self.of_view(index)
            asked = (cell % step == 0) & (index not in without)
            own, place = np.unique(cell[asked], return_inverse=True)
            found.append((np.full(len(own), index), own, grouped_means(value[asked], place)))
        view, cell, mean = (np.concatenate(columns) for columns in zip(*found, strict=True))
        return view, cell, mean

    def view_gains(self, without: Collection[int] = ()) -> np.ndarray:
        """(V, C) factor by which each photograph is brighter than the others; 1 where that can't be judged.

        Robust least squares of log radiance = surface cell + photograph, of which a panorama is one. The
        median photograph has a factor of 1.

        Args:
            without: indices of views that are ignored, because their poses are wrong.
        """
        photograph = photographs_of(self.pixels.views)
        # Cells are thinned out rather than pixels, so that each cell keeps all views that share it.
        view, cell, value = self.means(max(1, -(-self.pixel_count // GAIN_PIXELS)), without)
        shared = np.bincount(cell)[cell] > 1
        cell, view, value = cell[shared], photograph[view[shared]], value[shared]
        count = int(photograph.max()) + 1
        judged = np.bincount(view, minlength=count) >= SHARED_CELLS
        if not judged.any():
            return np.ones((len(photograph), value.shape[1]))
        weight, gain = np.ones(len(cell)), np.zeros((count, value.shape[1]))
        for _ in range(_ROUNDS):
            gain = _solved(cell, view, value, weight, count)
            residual = without_means(value - gain[view], cell, weight)
            square = (residual**2).mean(axis=1)
            weight = 1.0 / (1.0 + square / (2.0 * deviation(residual, LEAST_SPREAD)) ** 2)
        gain -= np.median(gain[judged], axis=0)
        return np.where(judged[:, None], np.exp(gain), 1.0)[photograph]

    def pair_correlation(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How the values of V views go together in the cells that two of them share.

        Returns:
            three (V, V): correlation over all channels, number of shared cells, and variance of the view of
            the row in them, summed over the channels.
        """
        view, cell, mean = self.means()
        shape = len(self.pixels.views), len(self.keys)
        shows = csr_array((np.ones(len(view)), (view, cell)), shape)
        shared = (shows @ shows.T).toarray()
        common, covariance, variance = np.maximum(shared, 1.0), np.zeros(shared.shape), np.zeros(shared.shape)
        for channel in mean.T:
            value = csr_array((channel, (view, cell)), shape)
            sums = (value @ shows.T).toarray()
            covariance += (value @ value.T).toarray() / common - sums * sums.T / common**2
            variance += (value.multiply(value) @ shows.T).toarray() / common - (sums / common) ** 2
        return covariance / np.sqrt(np.maximum(variance * variance.T, 1e-12)), shared, variance


def _solved(
    cell: np.ndarray, view: np.ndarray, value: np.ndarray, weight: np.ndarray, views: int
) -> np.ndarray:
    """(views, C) log gains by weighted least squares, with the cells eliminated.

    Only their differences are determined: of all solutions the smallest is taken.

    Args:
        cell, view: (K,) int. value: (K, C) log radiance. weight: (K,).
    """
    shares = csr_array((weight, (cell, view)), shape=(int(cell.max()) + 1, views))
    total = np.maximum(np.bincount(cell, weight), 1e-12)
    normal = np.diag(np.bincount(view, weight, views)) - (shares.T @ (shares / total[:, None])).toarray()
    pulled = weight[:, None] * without_means(value, cell, weight)
    right = np.stack([np.bincount(view, column, views) for column in pulled.T], axis=1)
    return np.linalg.lstsq(normal, right, rcond=1e-12)[0]


def lattice_spacing(view: View) -> int:
    """Spacing in pixels of a view's lattice."""
    return max(1, view.width // REGISTERED_WIDTH)


def lattice(view: View) -> tuple[slice, slice]:
    """Rows and columns of a view's image that lie on its lattice."""
    step = lattice_spacing(view)
    return slice(step // 2, None, step), slice(step // 2, None, step)


def lattice_hits(pixels: PixelStore, index: int) -> np.ndarray:
    """(M,) int64 pixels on the lattice of a view that see a single surface of the mesh."""
    view, rows = pixels.views[index], pixels.rows(index)
    usable = (np.asarray(pixels.triangle[rows]) >= 0) & pixels.pure[rows]
    chosen = np.zeros((view.height, view.width), bool)
    on_lattice = lattice(view)
    chosen[on_lattice] = usable.reshape(chosen.shape)[on_lattice]
    return np.flatnonzero(chosen) + rows.start


@dataclass(frozen=True, eq=False)
class SmallPhotographs:
    """Photographs on fewer pixels, which are compared before the pixels of an estimation are traced."""

    views: list[View]  # with as many pixels as the arrays have
    radiance: list[np.ndarray]  # of each view (n, 3), means over square blocks of pixels
    masked: list[np.ndarray]  # of each view (n,) bool, blocks with a masked pixel

    @classmethod
    def of(cls, views: Sequence[View], steps: Sequence[int]) -> SmallPhotographs:
        """The photographs of views, with blocks of so many pixels along each side."""
        found = cls([], [], [])
        for view, step in zip(views, steps, strict=True):
            width, height = view.width // step, view.height // step
            masked = view.masked()
            images = view.radiance(), np.zeros((view.height, view.width), bool) if masked is None else masked
            radiance, covered = (
                image[: height * step, : width * step]
                .reshape(height, step, width, step, -1)
                .mean(axis=(1, 3))
                .reshape(width * height, -1)
                for image in images
            )
            cropped = replace(view, width=width * step, height=height * step)
            found.views.append(cropped.resized(width, height))
            found.radiance.append(radiance)
            found.masked.append(covered[:, 0] > 0.0)
        return found

    def images(self) -> Iterator[np.ndarray]:
        """The photographs (h, w, 3)."""
        for view, radiance in zip(self.views, self.radiance, strict=True):
            yield radiance.reshape(view.height, view.width, 3)

    def traced(self, room: Room) -> PixelStore:
        """What their pixels see of a room, in memory; all that meet it are pure and see fronts."""
        sizes = [len(each) for each in self.radiance]
        rays = zip(*(view.rays() for view in self.views), strict=True)
        seen = traced(room.intersect(rays_along(*(np.concatenate(each) for each in rays))))
        triangle = np.where(np.concatenate(self.masked), np.int32(LEFT_OUT), seen.triangle)
        ranges = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        radiance, pure = np.concatenate(self.radiance), triangle >= 0
        arrays = radiance, seen.position, seen.normal, triangle, np.ones_like(pure), pure, radiance, pure
        return PixelStore(self.views, ranges, *arrays)


def footprint(pixels: PixelStore) -> float:
    """Median width in metres of a pixel on the surfaces that it sees, 0 where none sees any."""
    return median_footprint(pixels) if (np.asarray(pixels.triangle) >= 0).any() else 0.0
