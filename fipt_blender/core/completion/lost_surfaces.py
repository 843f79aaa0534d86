"""Things that a scanner lost: a glossy or dark table, a cabinet, a slab.

Photographs of a lost thing disagree on what the scan has behind it, and agree at the thing's own surface
(:mod:`.agreement`). Points all over the room's air are tested. Where photographs disagree less than on the
surface behind, an upright prism is fitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, binary_fill_holes, binary_opening, label
from scipy.special import bdtrc  # scipy.stats takes half a second to import

from ..checks.agreement import LEAST_GAIN, Box, ComparedPixels, doubts
from ..checks.consistency import CellGrid
from ..pixels.camera_rays import rays_along
from ..pixels.grouped import numbered
from ..pixels.store import traced
from ..run.messages import Progress, unwatched
from ..surface.adjacency import NONE, Surface, without_unused
from ..surface.room import Room

# Share of all disagreement that a thing must take away: smaller things matter less than a wrong prism.
LEAST_SHARE = 0.01
# Share of the cells inside a prism in which the scan has a surface: scanners look into shades, not tables.
MOST_INSIDE = 0.01
# A thing is likely if more views improve than chance explains at this level of significance (sign test).
LEVEL = 0.05
# Cells by which a side of a prism moves at a time.
STEPS = (3, 1)
# Rounds that take the steps of the cells out of a footprint's border.
_ROUNDS = 6


def lost_surfaces(
    room: Room, pixels: ComparedPixels, progress: Progress = unwatched
) -> tuple[list[Surface], ComparedPixels]:
    """Prisms for things in front of a scan that the photographs show.

    Args:
        room: the scan.
        pixels: of the training views on it.

    Returns:
        for each its surface, whose triangles are on no planes; and the pixels with these surfaces.
    """
    middles = room.vertices.astype(np.float64)[room.triangles].mean(axis=1)
    found: list[Surface] = []
    for (low, high), step, share in pixels.boxes(room.bounds, progress=progress):
        if share < LEAST_SHARE:
            break
        fitted = _fitted(pixels, (low - step, high + step), middles)
        if fitted is not None:
            thing, pixels = fitted
            found.append((*thing.mesh, np.full(len(thing.mesh[1]), NONE)))
    return found, pixels


@dataclass(frozen=True)
class _Prism:
    """A prism over cells, and the disagreement that it explains.

    Attributes:
        low: (3,) lowest corner of the cells, metres.
        body: (X, Y, Z) bool, cells inside it: those of a footprint in some layers.
        mesh: vertices, triangles and corner normals.
        rows, distance: (m,) int pixels that see it, and metres to it.
        cell, doubt: (n,) of the pixels that the search touches.
        by_view: (V,) pixels of each view whose disagreement it removes.
    """

    low: np.ndarray
    body: np.ndarray
    mesh: tuple[np.ndarray, np.ndarray, np.ndarray]
    rows: np.ndarray
    distance: np.ndarray
    cell: np.ndarray
    doubt: np.ndarray
    by_view: np.ndarray

    @property
    def score(self) -> float:
        """Pixels of all views whose disagreement it removes."""
        return float(self.by_view.sum())

    @property
    def rank(self) -> tuple[float, int]:
        """Greater for a better prism; of two that explain the same, the smaller one is better."""
        return self.score, -int(self.body.sum())

    @property
    def is_likely(self) -> bool:
        """Whether more of the views get better by it than chance explains."""
        better, changed = int((self.by_view > 0.0).sum()), int((self.by_view != 0.0).sum())
        return bool(bdtrc(better - 1, changed, 0.5) < LEVEL)

    def inside(self, points: np.ndarray, size: float) -> float:
        """Share of the cells well inside it, with edges of `size` metres, that hold points (N, 3)."""
        body = binary_erosion(self.body)
        place = np.floor((points - self.low) / size).astype(np.int64)
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

    pixels: ComparedPixels
    low: np.ndarray
    entering: np.ndarray
    touched: np.ndarray
    place: np.ndarray

    @classmethod
    def within(cls, pixels: ComparedPixels, box: Box) -> _Search:
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

    def prism(self, body: np.ndarray) -> _Prism:
        """A prism of cells (X, Y, Z) bool of the box, and the disagreement that it explains."""
        pixels, layers = self.pixels, np.flatnonzero(body.any(axis=(0, 1)))
        corner = self.low + [0.0, 0.0, layers[0] * pixels.size]
        mesh = prism(body.any(axis=2), corner, pixels.size, len(layers))
        none = np.zeros(len(mesh[1]), np.int32)
        room = Room(*mesh, none, none - 1)
        view, direction = pixels.view[self.entering], pixels.direction[self.entering]
        places = pixels.places[view].astype(np.float32)
        seen = traced(room.intersect(rays_along(places, direction)))
        reached = np.linalg.norm(seen.position - places, axis=1)
        before = pixels.distance[self.entering] - pixels.size
        hides = np.flatnonzero((seen.triangle >= 0) & (reached < before))
        rows, own = self.entering[hides], numbered([CellGrid.of(room, pixels.size).keys(seen, hides)])
        view, color, before = (values[self.touched] for values in (pixels.view, pixels.color, pixels.doubt))
        cell = self.place.copy()
        cell[np.searchsorted(self.touched, rows)] = own + int(self.place.max()) + 1
        known = cell >= 0
        doubt = np.full(len(cell), np.nan, np.float32)
        doubt[known] = doubts(view[known], cell[known], color[known])
        # Cells that too few views see (NaN) are no evidence.
        by_view = np.bincount(view, np.nan_to_num(before - doubt), len(pixels.views))
        return _Prism(self.low, body, mesh, rows, reached[hides], cell, doubt, by_view)

    def accepted(self, found: _Prism) -> ComparedPixels:
        """The pixels with a prism in front of the scan."""
        pixels = self.pixels
        distance, cell, doubt = pixels.distance.copy(), pixels.cell.copy(), pixels.doubt.copy()
        distance[found.rows], doubt[self.touched] = found.distance, found.doubt
        cell[self.touched] = np.where(found.cell >= 0, found.cell + pixels.cell.max() + 1, -1)
        return replace(pixels, distance=distance, cell=cell, doubt=doubt)


def _fitted(pixels: ComparedPixels, box: Box, middles: np.ndarray) -> tuple[_Prism, ComparedPixels] | None:
    """The prism in a box that explains the photographs best, and the pixels with it; None if it is unlikely.

    It starts as the layer of cells that explains most, and grows and shrinks as long as it explains more.

    Args:
        middles: (T, 3) of the scan's triangles.
    """
    low, high = box
    shape = np.maximum(np.ceil((high - low) / pixels.size).astype(int), 1)
    gain, views = pixels.swept(low, pixels.size, shape)
    shows = gain > LEAST_GAIN
    layer = int(np.argmax((gain * views * shows).sum(axis=(0, 1))))
    footprint = _footprint(shows[:, :, layer])
    if footprint is None:
        return None
    search, body = _Search.within(pixels, box), np.zeros(shape, bool)
    body[:, :, layer] = footprint
    best = search.prism(body)
    for step in STEPS:
        kind, failed = 0, 0
        while failed < len(_CHANGES):
            changed = _changed(best.body, step, *_CHANGES[kind])
            tried = None if changed is None else search.prism(changed)
            if tried is not None and tried.rank > best.rank:
                best, failed = tried, 0
            else:
                kind, failed = (kind + 1) % len(_CHANGES), failed + 1
    enough = best.score >= LEAST_SHARE * pixels.disagreement
    if not (enough and best.is_likely) or best.inside(middles, pixels.size) > MOST_INSIDE:
        return None
    return best, search.accepted(best)


# Sides of a prism that move: whether it grows, along which axis, and to which end of it.
_CHANGES = (*product((True, False), (2,), (-1, 1)), *product((True, False), (0, 1), (1, -1)))


def _changed(body: np.ndarray, step: int, grows: bool, along: int, by: int) -> np.ndarray | None:
    """A prism (X, Y, Z) bool with one side moved by a step; None if nothing changes, or nothing is left."""
    beside = np.zeros((3, 3, 3), bool)
    beside[1, 1, 1] = True
    beside[tuple(1 + by * (axis == along) for axis in range(3))] = True
    changed = (binary_dilation if grows else binary_erosion)(body, beside, step)
    return None if (changed == body).all() or not changed.any() else changed


def _footprint(shows: np.ndarray) -> np.ndarray | None:
    """The largest piece of a layer (X, Y) that shows a thing, without holes; None without any."""
    pieces, count = label(binary_opening(shows))
    if not count:
        return None
    return np.asarray(binary_fill_holes(pieces == 1 + np.argmax(np.bincount(pieces.reshape(-1))[1:])))


def prism(
    inside: np.ndarray, corner: np.ndarray, cell: float, layers: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The closed surface of a prism.

    Args:
        inside: (X, Y) bool, cells of the footprint.
        corner: (3,) lowest corner of cell (0, 0), metres.
        cell: edge of a cell, and height of a layer, metres.
        layers: its height in layers, at least 1.

    Returns:
        vertices (V, 3) float32, triangles (T, 3) int32 with fronts outwards, and corner normals (T, 3, 3).
    """
    places = np.argwhere(inside)[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]]
    used, index = np.unique(places.reshape(-1, 2), axis=0, return_inverse=True)
    cells = index.reshape(-1, 4)
    border = _border(cells)
    outline = _smoothed(used.astype(np.float64), border)
    flat = cells[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    count = len(used)
    levels = np.repeat(np.arange(layers + 1), count)[:, None]
    vertices = corner + cell * np.concatenate([np.tile(outline, (layers + 1, 1)), levels], axis=1)
    low = (np.arange(layers)[:, None, None] * count + border).reshape(-1, 2)
    quads = np.concatenate([low, low[:, ::-1] + count], axis=1)
    walls = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    outward = _outward(outline, border)
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(flat), 3, 3))
    triangles = np.concatenate([flat[:, ::-1], flat + layers * count, walls])
    normals = np.concatenate([-up, up, outward[walls % count]])
    used, triangles = without_unused(triangles)
    return vertices[used].astype(np.float32), triangles, normals.astype(np.float32)


def _border(cells: np.ndarray) -> np.ndarray:
    """(E, 2) directed edges of cells (N, 4), counter-clockwise, that only one cell has."""
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    size = int(edges.max()) + 1
    return edges[~np.isin(edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0])]


def _smoothed(places: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Places (V, 2) with those of the border (E, 2) between their neighbours along it."""
    on = np.bincount(border.reshape(-1), minlength=len(places))[:, None]
    for _ in range(_ROUNDS):
        total = np.zeros_like(places)
        np.add.at(total, border[:, 0], places[border[:, 1]])
        np.add.at(total, border[:, 1], places[border[:, 0]])
        places = np.where(on > 0, 0.5 * places + 0.5 * total / np.maximum(on, 1), places)
    return places


def _outward(places: np.ndarray, border: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals of the walls over the border, zero off it."""
    along = places[border[:, 1]] - places[border[:, 0]]
    normal = np.zeros((len(places), 3))
    for end in (0, 1):
        np.add.at(normal, border[:, end], np.stack([along[:, 1], -along[:, 0], 0.0 * along[:, 0]], axis=1))
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))
