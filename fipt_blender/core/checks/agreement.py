"""Where photographs agree: on the surfaces that they see, and at points in front of these.

Photographs of one surface point agree, apart from gloss. Where the mesh lacks a surface, each photograph sees
it in front of another point of the surface behind (parallax), and they disagree at these points.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import label as connected

from ..capture.views import View
from ..parts.masked_views import grid_points, seen_before
from ..pixels.grouped import grouped_means, grouped_median, numbered, pairs_of
from ..pixels.store import LEFT_OUT
from ..robust import LEAST_VIEWS
from ..run.messages import Progress, unwatched
from ..surface.room import Room
from .consistency import ConsistencyTable, SmallPhotographs, footprint, lattice_spacing

# Difference of the logarithm of radiance (root mean square over the channels) from which on photographs
# disagree completely. Gloss and errors of poses cause differences on one surface, too.
DISAGREE = 0.35
# Most pixels that are compared; those of larger captures are averaged.
MOST_PIXELS = 4_000_000
# Largest edge of a mesh, metres, that determines the size of cells: modelled rooms have few triangles.
MOST_EDGE = 0.05
# A point of a lost thing reduces the disagreement by at least this much, mean over the views.
LEAST_GAIN = 0.1
# A view is on the side of a point's normal if it sees the point at this cosine at least.
LEAST_COSINE = 0.2
# Spacing of the points in the air, in widths of a pixel on the scan, and largest number of points.
COARSE, MOST_POINTS = 3, 1_000_000
_CHUNK = 20_000

Box = tuple[np.ndarray, np.ndarray]  # lowest and highest corner, each (3,), metres


@dataclass(frozen=True)
class ComparedPixels:
    """The N pixels of all views, on lattices."""

    size: float  # median width of a pixel on the scan, at least the scan's median edge, metres
    views: list[View]  # with as many pixels as their lattices
    first: np.ndarray  # (V + 1,) int, where the pixels of each view begin
    view: np.ndarray  # (N,) int
    direction: np.ndarray  # (N, 3) float32 unit vector through the pixel
    color: np.ndarray  # (N, 3) float32 logarithm of radiance, apart from the view's exposure
    distance: np.ndarray  # (N,) float32 metres to the first surface, infinite without one
    cell: np.ndarray  # (N,) int, from 0: place on that surface, by which pixels are compared; -1 without one
    # (N,) float32, 0 where the photographs of the cell agree, 1 where they disagree; NaN where fewer
    # than `LEAST_VIEWS` views see it
    doubt: np.ndarray

    @property
    def places(self) -> np.ndarray:
        """(V, 3) of the cameras, metres."""
        return np.array([view.camera_to_world[:3, 3] for view in self.views])

    @property
    def disagreement(self) -> float:
        """Number of pixels that disagree with others."""
        return float(np.nansum(self.doubt))

    def before(self, view: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points (P, 3) that a view sees clearly in front of the surface: their rows, and pixels."""
        first, end = self.first[view : view + 2]
        rows, pixel = seen_before(self.views[view], self.distance[first:end], points, self.size)
        return rows, first + pixel

    def through(self, box: Box) -> np.ndarray:
        """(n,) int pixels whose rays enter a box before they meet the surface."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [(corner - self.places)[self.view] / self.direction for corner in box]
        near, far = np.minimum(*ends).max(axis=1), np.maximum(*ends).min(axis=1)
        return np.flatnonzero((far > np.maximum(near, 0.0)) & (near < self.distance))

    def swept(
        self, low: np.ndarray, step: float, shape: np.ndarray, progress: Progress = unwatched
    ) -> tuple[np.ndarray, np.ndarray]:
        """How much less photographs disagree at the cells of a grid than behind, and the number of views.

        The first is a mean over the views, 0 where fewer than `LEAST_VIEWS` see a cell.

        Args:
            low: (3,) its lowest corner. step: edge of a cell, metres. shape: (3,) number of cells.
        """
        points = grid_points(low, step, shape)
        gain, count = np.zeros(len(points)), np.zeros(len(points), np.int64)
        for begin in range(0, len(points), _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            gain[rows], count[rows] = self.gains(points[rows])
            progress(min((begin + _CHUNK) / len(points), 1.0))
        return gain.reshape(tuple(shape)), count.reshape(tuple(shape))

    def boxes(
        self, bounds: Box, most_points: int = MOST_POINTS, progress: Progress = unwatched
    ) -> Iterator[tuple[Box, float, float]]:
        """Boxes around what photographs show in the air of the room, the one that explains most first.

        Each with the spacing of the points, and the share of all disagreement that it explains.

        Args:
            bounds: of the room. most_points: that are tested.
        """
        low, high = bounds
        step = max(COARSE * self.size, float((np.prod(high - low) / most_points) ** (1.0 / 3.0)))
        shape = np.maximum(np.ceil((high - low) / step).astype(int), 1)
        gain, views = self.swept(low, step, shape, progress)
        shows = (gain > LEAST_GAIN) & (gain * views > LEAST_VIEWS)
        pieces, count = connected(shows, np.ones((3, 3, 3)))
        # A cell is seen by about (step / size)^2 pixels of a view.
        seen = gain * views * (step / self.size) ** 2
        total = np.bincount(pieces.reshape(-1), seen.reshape(-1), count + 1)[1:]
        for piece in np.argsort(-total):
            cells = np.argwhere(pieces == piece + 1)
            box = low + cells.min(axis=0) * step, low + (cells.max(axis=0) + 1) * step
            yield box, step, float(total[piece] / max(self.disagreement, 1e-30))

    def gains(self, points: np.ndarray, facing: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """As :meth:`swept`, of points (P, 3); 0 where fewer than `LEAST_VIEWS` views see one.

        Args:
            facing: (P, 3) unit normals: only views on their side count; None: all do.
        """
        color = np.full((len(self.views), len(points), 3), np.nan, np.float32)
        on_scan = np.zeros(len(points))
        for view in range(len(self.views)):
            rows, pixel = self.before(view, points)
            if facing is not None:
                cosine = -(self.direction[pixel] * facing[rows]).sum(axis=1)
                rows, pixel = rows[cosine > LEAST_COSINE], pixel[cosine > LEAST_COSINE]
            color[view, rows] = self.color[pixel]
            on_scan[rows] += np.nan_to_num(self.doubt[pixel])
        count = np.isfinite(color[..., 0]).sum(axis=0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # points that no view sees
            own = np.nansum(_doubt(color - np.nanmedian(color, axis=0)), axis=0)
        return np.where(count >= LEAST_VIEWS, on_scan - own, 0.0) / np.maximum(count, 1), count


def compared_pixels(room: Room, views: Sequence[View], edge: float) -> ComparedPixels:
    """The pixels of the views on a scan with this median edge, metres."""
    every = sum(view.width * view.height / lattice_spacing(view) ** 2 for view in views)
    coarser = int(np.ceil(np.sqrt(every / MOST_PIXELS)))
    small = SmallPhotographs.of(views, [coarser * lattice_spacing(view) for view in views])
    unit = np.float32(max(float(np.median(np.concatenate(small.radiance))), 1e-12))
    pixels = replace(small, radiance=[each / unit for each in small.radiance]).traced(room)
    size = max(edge, footprint(pixels))
    table = ConsistencyTable.of(pixels, room, size, colored=True)
    number = pixels.view_of(np.arange(len(pixels))).astype(np.int32)
    color = table.values(slice(None)) - np.log(table.view_gains())[number]
    direction = np.concatenate([view.rays()[1] for view in small.views])
    away = np.linalg.norm(pixels.position - pixels.camera_positions()[number], axis=1)
    distance = np.where(pixels.triangle >= 0, away, np.where(pixels.triangle == LEFT_OUT, 0.0, np.inf))
    cell, doubt = np.full(len(number), -1, np.int64), np.full(len(number), np.nan, np.float32)
    met = np.flatnonzero(pixels.triangle >= 0)
    cell[met] = numbered([table.grid.keys(pixels, met)])
    doubt[met] = doubts(number[met], cell[met], color[met])
    arrays = (color.astype(np.float32), distance.astype(np.float32), cell, doubt)
    return ComparedPixels(size, small.views, pixels.ranges, number, direction, *arrays)


def survey_pixels(room: Room, views: Sequence[View]) -> ComparedPixels | None:
    """The pixels of a survey, None where too few views can be compared; Mitsuba's variant must be set.

    Args:
        views: training views.
    """
    if len(views) < LEAST_VIEWS:
        return None
    corners = room.vertices[room.triangles]
    edge = float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))
    return compared_pixels(room, views, min(edge, MOST_EDGE))


def doubts(view: np.ndarray, cell: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(n,) how much pixels disagree with other views of their cell; NaN where too few see it."""
    on, _, pair = pairs_of(cell, view)
    mean = grouped_means(color, pair)
    known = np.bincount(on) >= LEAST_VIEWS
    medians = grouped_median(mean, on, len(known))
    return np.where(known[cell], _doubt(color - medians[cell]), np.nan)


def _doubt(difference: np.ndarray) -> np.ndarray:
    """Disagreement, 0 to 1, by differences (..., 3) of the logarithm of radiance."""
    return np.minimum((difference**2).mean(axis=-1) / DISAGREE**2, 1.0)
