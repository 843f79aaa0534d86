# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Things that a scanner lost, from photographs without masks.

Photographs look through a lost thing onto what lies behind it, each onto another place: they disagree on the
scan there, and agree at the thing's own surface. Points are swept through the room's air. Where photographs
agree that disagree on the scan behind, an upright prism is fitted, as to the masks of a part
(:mod:`.lost_parts`).
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mitsuba as mi
import numpy as np
from scipy.ndimage import binary_closing, binary_erosion, binary_fill_holes, binary_opening
from scipy.ndimage import label as connected
from scipy.stats import binomtest

from ..capture.views import View
from ..conventions import project
from ..geometry.adjacency import NONE
from ..geometry.prism import prism
from ..light.cache import side_index
from ..scene.camera_rays import first_hits
from ..scene.grouped import grouped_median, grouped_sums, numbered
from ..scene.room import Room, triangle_normals
from .cells import CELL_PIXELS, lattice_spacing
from .lost_parts import LEVEL, Surface
from .sights import LEAST_VIEWS

# Difference of the logarithm of radiance (root mean square over the channels) beyond which photographs
# disagree entirely. Gloss and errors of poses make it large on one surface, too.
DISAGREE = 0.35
# Radiance in units of the capture's median, below which differences count less.
FLOOR = 0.05
# A point of a lost thing takes at least this much disagreement away, mean over the views.
LEAST_GAIN = 0.1
# Spacing of the first sweep, in cells of the second, and most points of it.
COARSE, MOST_POINTS = 3, 1_000_000
# Pixels that are compared; those of larger captures are joined.
MOST_PIXELS = 4_000_000
# Gaps of a footprint that are closed, in cells: what stands on a table hides it.
GAP = 3
# Share of all disagreement that a thing must take away: smaller things matter less than a wrong prism.
LEAST_SHARE = 0.02
# Share of the cells inside a prism in which the scan has a surface: scanners look into shades, not tables.
MOST_INSIDE = 0.01
# Cells by which a prism grows or shrinks at a time.
STEPS = (3, 1)
# Rounds in which the views' exposures are found.
_ROUNDS = 3
_CHUNK = 20_000

Box = tuple[np.ndarray, np.ndarray]  # lowest and highest corner, each (3,), metres


@dataclass(frozen=True)
class _Pixels:
    """The N pixels of all views, on lattices.

    Attributes:
        size: median width of a pixel on the scan, at least the scan's median edge, metres.
        views: as wide as their lattices.
        first: (V + 1,) int, where the pixels of each view begin.
        view: (N,) int.
        direction: (N, 3) float32 unit vector through the pixel.
        color: (N, 3) float32 logarithm of radiance, apart from the view's exposure.
        distance: (N,) float32 metres to the first surface, infinite without one.
        cell: (N,) int, from 0: place on that surface, by which pixels are compared; -1 without one.
        doubt: (N,) float32, 0 where the photographs of the cell agree, 1 where they disagree; NaN where
            fewer than `LEAST_VIEWS` views see it.
    """

    size: float
    views: list[View]
    first: np.ndarray
    view: np.ndarray
    direction: np.ndarray
    color: np.ndarray
    distance: np.ndarray
    cell: np.ndarray
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
        """The points (P, 3) that a view sees well before the surface: their rows, and pixels."""
        seen = self.views[view]
        place, depth = project(points, seen)
        inside = (depth > 0.0) & (place >= 0.0).all(axis=1)
        inside &= (place[:, 0] < seen.width) & (place[:, 1] < seen.height)
        rows = np.flatnonzero(inside)
        x, y = place[rows].astype(np.int64).T
        pixel = self.first[view] + y * seen.width + x
        away = np.linalg.norm(points[rows] - seen.camera_to_world[:3, 3], axis=1)
        free = away < self.distance[pixel] - self.size
        return rows[free], pixel[free]

    def through(self, box: Box) -> np.ndarray:
        """(n,) int pixels whose rays enter a box before they meet the surface."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [(corner - self.places)[self.view] / self.direction for corner in box]
        near, far = np.minimum(*ends).max(axis=1), np.maximum(*ends).min(axis=1)
        return np.flatnonzero((far > np.maximum(near, 0.0)) & (near < self.distance))


def lost_surfaces(room: Room, views: Sequence[View], edge: float) -> list[Surface]:
    """Prisms for things in front of a scan that the photographs show.

    Mitsuba's variant must be set.

    Args:
        room: the scan.
        views: training views.
        edge: median edge of the scan, metres.

    Returns:
        for each its surface, whose triangles are on no planes.
    """
    pixels = _pixels(room, views, edge)
    middles = room.vertices.astype(np.float64)[room.triangles].mean(axis=1)
    found: list[Surface] = []
    for box in _boxes(pixels, room.bounds):
        fitted = _fitted(pixels, box, middles)
        if fitted is not None:
            thing, pixels = fitted
            found.append((*thing.mesh, np.full(len(thing.mesh[1]), NONE)))
    return found


def _pixels(room: Room, views: Sequence[View], edge: float) -> _Pixels:
    """What the views show of a scan with this median edge, metres."""
    every = sum(view.width * view.height / lattice_spacing(view) ** 2 for view in views)
    coarser = int(np.ceil(np.sqrt(every / MOST_PIXELS)))
    smaller, means, used = zip(
        *(_on_lattice(view, coarser * lattice_spacing(view)) for view in views), strict=True
    )
    sizes = [view.width * view.height for view in smaller]
    number = np.repeat(np.arange(len(views), dtype=np.int32), sizes)
    radiance, shown = np.concatenate(means), np.concatenate(used)
    color = np.log(np.maximum(radiance / max(float(np.median(radiance)), 1e-12), 0.0) + FLOOR)
    direction = np.concatenate([view.rays()[1].reshape(-1, 3) for view in smaller]).astype(np.float32)
    triangle, distance = _hits(room, smaller, number, direction)
    distance[~shown] = 0.0
    met = (triangle >= 0) & shown
    view, hits = number[met], (triangle[met], distance[met])
    widths = distance[met] / np.array([view.fx for view in smaller])[view]
    size = max(edge, float(np.median(widths)) if len(widths) else 0.0)
    on = _cells(smaller, room, view, direction[met], hits, size)
    color -= _exposures(view, on, color[met], len(views))[number]
    cell, doubt = np.full(len(number), -1, np.int64), np.full(len(number), np.nan, np.float32)
    cell[met], doubt[met] = on, _doubts(view, on, color[met])
    first = np.concatenate([[0], np.cumsum(sizes)])
    arrays = (color.astype(np.float32), distance.astype(np.float32), cell, doubt)
    return _Pixels(size, list(smaller), first, number, direction, *arrays)


def _on_lattice(view: View, step: int) -> tuple[View, np.ndarray, np.ndarray]:
    """The view with fewer pixels, the mean radiance (N, 3) of each, and (N,) bool, which are not masked."""
    width, height = view.width // step, view.height // step
    focal = {name: getattr(view, name) / step for name in ("fx", "fy", "cx", "cy")}

    def means(image: np.ndarray) -> np.ndarray:
        blocks = image[: height * step, : width * step].reshape(height, step, width, step, -1)
        return np.asarray(blocks.mean(axis=(1, 3)).reshape(width * height, -1))

    masked = view.masked()
    used = np.ones(width * height, bool) if masked is None else means(masked)[:, 0] == 0.0
    return replace(view, width=width, height=height, **focal), means(view.radiance()), used


def _hits(
    room: Room, views: Sequence[View], view: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangle and distance (:func:`.first_hits`) of rays from the views (n,) along directions (n, 3)."""
    places = np.array([each.camera_to_world[:3, 3] for each in views], np.float32)
    origin = mi.Point3f(np.ascontiguousarray(places[view].T))
    return first_hits(room.intersect(mi.Ray3f(origin, mi.Vector3f(np.ascontiguousarray(direction.T)))))


def _cells(
    views: Sequence[View],
    room: Room,
    view: np.ndarray,
    direction: np.ndarray,
    hits: tuple[np.ndarray, np.ndarray],
    size: float,
) -> np.ndarray:
    """(n,) int from 0, place on the room's surface and side of it that rays meet (triangle, distance)."""
    triangle, distance = hits
    places = np.array([each.camera_to_world[:3, 3] for each in views])
    points = places[view] + direction * distance[:, None]
    side = side_index(triangle_normals(room.vertices, room.triangles))[triangle]
    return numbered([*np.floor(points / (CELL_PIXELS * size)).astype(np.int64).T, side])


def _means(view: np.ndarray, cell: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, ...]:
    """View and cell (m,) of each cell in each view, and the mean (m, 3) of its colours."""
    views = int(view.max(initial=0)) + 1
    pairs, pair = np.unique(cell * views + view, return_inverse=True)
    return pairs % views, pairs // views, grouped_sums(color, pair) / np.bincount(pair)[:, None]


def _exposures(view: np.ndarray, cell: np.ndarray, color: np.ndarray, views: int) -> np.ndarray:
    """(views, 3) logarithm of each view's exposure, by the cells (n,) that it shares with others."""
    of, on, mean = _means(view, cell, color)
    count = int(cell.max(initial=-1)) + 1
    known = (np.bincount(on) >= LEAST_VIEWS)[on]
    gains = np.zeros((views, 3))
    for _ in range(_ROUNDS):
        difference = mean - grouped_median(mean - gains[of], on, count)[on]
        gains = grouped_median(difference[known], of[known], views)
    return gains


def _doubts(view: np.ndarray, cell: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(n,) how much pixels disagree with other views of their cell; NaN where too few see it."""
    _, on, mean = _means(view, cell, color)
    known = np.bincount(on) >= LEAST_VIEWS
    medians = grouped_median(mean, on, len(known))
    return np.where(known[cell], _doubt(color - medians[cell]), np.nan)


def _doubt(difference: np.ndarray) -> np.ndarray:
    """Disagreement, 0 to 1, by differences (..., 3) of the logarithm of radiance."""
    return np.minimum((difference**2).mean(axis=-1) / DISAGREE**2, 1.0)


def _swept(pixels: _Pixels, low: np.ndarray, step: float, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the cells of a grid explain better than the scan, mean over the views, and the number of views.

    Args:
        low: (3,) its lowest corner. step: edge of a cell, metres. shape: (3,) number of cells.
    """
    points = low + (np.indices(tuple(shape)).reshape(3, -1).T + 0.5) * step
    gain, count = np.zeros(len(points)), np.zeros(len(points), np.int64)
    for begin in range(0, len(points), _CHUNK):
        rows = slice(begin, begin + _CHUNK)
        gain[rows], count[rows] = _gains(pixels, points[rows])
    return gain.reshape(tuple(shape)), count.reshape(tuple(shape))


def _gains(pixels: _Pixels, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As :func:`_swept`, of points (P, 3); 0 where fewer than `LEAST_VIEWS` views see one."""
    color = np.full((len(pixels.views), len(points), 3), np.nan, np.float32)
    on_scan = np.zeros(len(points))
    for view in range(len(pixels.views)):
        rows, pixel = pixels.before(view, points)
        color[view, rows] = pixels.color[pixel]
        on_scan[rows] += np.nan_to_num(pixels.doubt[pixel])
    count = np.isfinite(color[..., 0]).sum(axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # points that no view sees
        own = np.nansum(_doubt(color - np.nanmedian(color, axis=0)), axis=0)
    return np.where(count >= LEAST_VIEWS, on_scan - own, 0.0) / np.maximum(count, 1), count


def _boxes(pixels: _Pixels, bounds: Box) -> Iterator[Box]:
    """Boxes in which the photographs show more than the scan has, the one that shows most first."""
    low, high = bounds
    step = max(COARSE * pixels.size, float((np.prod(high - low) / MOST_POINTS) ** (1.0 / 3.0)))
    shape = np.maximum(np.ceil((high - low) / step).astype(int), 1)
    gain, views = _swept(pixels, low, step, shape)
    shows = (gain > LEAST_GAIN) & (gain * views > LEAST_VIEWS)
    pieces, count = connected(shows, np.ones((3, 3, 3)))
    # About so many pixels of a view look at one cell.
    seen = gain * views * (step / pixels.size) ** 2
    total = np.bincount(pieces.reshape(-1), seen.reshape(-1), count + 1)[1:]
    for piece in np.argsort(-total):
        if total[piece] < LEAST_SHARE * pixels.disagreement:
            break
        cells = np.argwhere(pieces == piece + 1)
        yield low + (cells.min(axis=0) - 1) * step, low + (cells.max(axis=0) + 2) * step


@dataclass(frozen=True)
class _Prism:
    """A prism over cells, and what it explains.

    Attributes:
        low: (3,) lowest corner of the cells, metres.
        footprint: (X, Y) bool.
        layers: lowest and highest.
        mesh: vertices, triangles and corner normals.
        rows, distance: (m,) int pixels that see it, and metres to it.
        cell, doubt: (n,) of the pixels that the search touches.
        by_view: (V,) pixels of each view whose disagreement it takes away.
    """

    low: np.ndarray
    footprint: np.ndarray
    layers: tuple[int, int]
    mesh: tuple[np.ndarray, np.ndarray, np.ndarray]
    rows: np.ndarray
    distance: np.ndarray
    cell: np.ndarray
    doubt: np.ndarray
    by_view: np.ndarray

    @property
    def score(self) -> float:
        """Pixels of all views whose disagreement it takes away."""
        return float(self.by_view.sum())

    def inside(self, points: np.ndarray, size: float) -> float:
        """Share of the cells well inside it, with edges of `size` metres, that hold points (N, 3)."""
        first, last = self.layers
        body = binary_erosion(np.repeat(self.footprint[:, :, None], last - first + 1, axis=2))
        place = np.floor((points - self.low) / size).astype(np.int64) - [0, 0, first]
        within = ((place >= 0) & (place < body.shape)).all(axis=1)
        held = np.zeros(body.shape, bool)
        held[tuple(place[within].T)] = True
        return float((held & body).sum() / max(body.sum(), 1))


@dataclass(frozen=True)
class _Search:
    """The search for a prism in a box.

    Attributes:
        pixels: of the views.
        low: (3,) lowest corner of the box, metres.
        entering: (m,) int pixels whose rays enter the box.
        touched: (n,) int these, and all that see the same places of the scan; ascending.
        place: (n,) int from 0, cell of the pixels that are touched, -1 without one.
    """

    pixels: _Pixels
    low: np.ndarray
    entering: np.ndarray
    touched: np.ndarray
    place: np.ndarray

    @classmethod
    def within(cls, pixels: _Pixels, box: Box) -> _Search:
        """The search in a box."""
        entering = pixels.through(box)
        behind = np.zeros(int(pixels.cell.max()) + 2, bool)
        behind[pixels.cell[entering]] = True
        behind[-1] = False  # no surface at all
        touched = behind[pixels.cell]
        touched[entering] = True
        rows = np.flatnonzero(touched)
        cells, place = np.unique(pixels.cell[rows], return_inverse=True)
        return cls(pixels, box[0], entering, rows, place - int((cells[:1] < 0).sum()))

    def prism(self, footprint: np.ndarray, layers: tuple[int, int]) -> _Prism:
        """A prism over cells of the box, and what it explains."""
        pixels, (first, last) = self.pixels, layers
        corner = self.low + [0.0, 0.0, first * pixels.size]
        mesh = prism(footprint, corner, pixels.size, last - first + 1)
        none = np.zeros(len(mesh[1]), np.int32)
        room = Room(*mesh, none, none - 1)
        view, direction = pixels.view[self.entering], pixels.direction[self.entering]
        triangle, reached = _hits(room, pixels.views, view, direction)
        hides = np.flatnonzero(reached < pixels.distance[self.entering] - pixels.size)
        rows, hits = self.entering[hides], (triangle[hides], reached[hides])
        own = _cells(pixels.views, room, view[hides], direction[hides], hits, pixels.size)
        view, color, before = (values[self.touched] for values in (pixels.view, pixels.color, pixels.doubt))
        cell = self.place.copy()
        cell[np.searchsorted(self.touched, rows)] = own + int(self.place.max()) + 1
        seen = cell >= 0
        doubt = np.full(len(cell), np.nan, np.float32)
        doubt[seen] = _doubts(view[seen], cell[seen], color[seen])
        # What too few views see tells nothing.
        by_view = np.bincount(view, np.nan_to_num(before - doubt), len(pixels.views))
        return _Prism(self.low, footprint, layers, mesh, rows, hits[1], cell, doubt, by_view)

    def accepted(self, found: _Prism) -> _Pixels:
        """The pixels with a prism before the scan."""
        pixels = self.pixels
        distance, cell, doubt = pixels.distance.copy(), pixels.cell.copy(), pixels.doubt.copy()
        distance[found.rows], doubt[self.touched] = found.distance, found.doubt
        cell[self.touched] = np.where(found.cell >= 0, found.cell + pixels.cell.max() + 1, -1)
        return replace(pixels, distance=distance, cell=cell, doubt=doubt)


def _fitted(pixels: _Pixels, box: Box, middles: np.ndarray) -> tuple[_Prism, _Pixels] | None:
    """The prism in a box that explains the photographs best, and the pixels with it; None if it is unlikely.

    It starts as the layer of cells that explains most, and grows and shrinks as long as it explains more.

    Args:
        middles: (T, 3) of the scan's triangles.
    """
    low, high = box
    shape = np.maximum(np.ceil((high - low) / pixels.size).astype(int), 1)
    gain, views = _swept(pixels, low, pixels.size, shape)
    shows = gain > LEAST_GAIN
    layer = int(np.argmax((gain * views * shows).sum(axis=(0, 1))))
    footprint = _footprint(shows[:, :, layer])
    if footprint is None:
        return None
    search = _Search.within(pixels, box)
    best = search.prism(footprint, (layer, layer))
    for step in STEPS:
        kind, failed = 0, 0
        while failed < len(_CHANGES):
            change = _CHANGES[kind](best, step, int(shape[2]))
            tried = None if change is None else search.prism(*change)
            if tried is not None and tried.score > best.score:
                best, failed = tried, 0
            else:
                kind, failed = (kind + 1) % len(_CHANGES), failed + 1
    changed = best.by_view[best.by_view != 0.0]
    chance = binomtest(int((changed > 0.0).sum()), len(changed), alternative="greater").pvalue
    likely = best.score >= LEAST_SHARE * pixels.disagreement and chance < LEVEL
    if not likely or best.inside(middles, pixels.size) > MOST_INSIDE:
        return None
    return best, search.accepted(best)


Change = tuple[np.ndarray, tuple[int, int]]  # footprint and layers


def _taller(best: _Prism, step: int, height: int, down: int, up: int) -> Change | None:
    """The prism with its ends moved by so many steps, in a box of so many layers."""
    first, last = best.layers
    layers = max(first - down * step, 0), min(last + up * step, height - 1)
    return None if layers == best.layers or layers[0] > layers[1] else (best.footprint, layers)


def _wider(best: _Prism, step: int, _: int, along: int, by: int, grows: bool) -> Change | None:
    """The prism with one side of its footprint moved by a step."""
    moved = _moved(best.footprint, along, by * step)
    footprint = best.footprint | moved if grows else best.footprint & moved
    same = (footprint == best.footprint).all()
    return None if same or not footprint.any() else (footprint, best.layers)


_CHANGES: list[Callable[[_Prism, int, int], Change | None]] = [
    *(partial(_taller, down=down, up=up) for down, up in ((1, 0), (0, 1), (-1, 0), (0, -1))),
    *(
        partial(_wider, along=along, by=by, grows=grows)
        for grows, along, by in itertools.product((True, False), (0, 1), (1, -1))
    ),
]


def _moved(mask: np.ndarray, along: int, by: int) -> np.ndarray:
    """A mask (X, Y) moved by some cells along an axis."""
    rolled = np.roll(mask, by, axis=along)
    rolled[(slice(None),) * along + (slice(0, by) if by > 0 else slice(by, None),)] = False
    return rolled


def _footprint(shows: np.ndarray) -> np.ndarray | None:
    """The largest piece of a layer (X, Y) that shows a thing, without gaps; None without any."""
    pieces, count = connected(binary_opening(shows))
    if not count:
        return None
    largest = pieces == 1 + np.argmax(np.bincount(pieces.reshape(-1))[1:])
    closed = binary_closing(np.pad(largest, GAP), iterations=GAP)[GAP:-GAP, GAP:-GAP]
    return np.asarray(binary_fill_holes(closed))
