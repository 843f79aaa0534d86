"""Surfaces that complete the parts that a scan tore, from the triangles that are left and from masks or
photographs.

A voxel that both sides of a thin shade or vase cross holds neither, so that scans have holes there; of glossy
parts, a scanner sees only patches. Light then passes where it should not. A shape is fitted to the triangles
that are left of a part: a surface of revolution, or nearly plane sheets. It is continued where the masks show
the part and the scan has nothing; without masks, round things are where photographs agree there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation, binary_opening, binary_propagation
from scipy.ndimage import label as connected

from ..checks.agreement import LEAST_COSINE, LEAST_GAIN, ComparedPixels
from ..parts.masked_views import MISSES, MaskedView
from ..pixels.camera_rays import first_hits, rays_along, trace_pixels
from ..robust import LEAST_VIEWS
from ..run.messages import Progress, unwatched
from ..run.threads import in_threads
from ..surface.adjacency import NONE, Surface, face_vectors
from ..surface.room import Room
from .shapes import CellSurface, fit_revolutions, fit_sheets

# Triangles of a part within this many edges belong to one thing; fewer triangles do not determine a shape.
APART, LEAST_TRIANGLES = 2.0, 100
# Share of a surface of revolution that the scan must have or the masks must show.
LEAST_KNOWN = 0.5
# Without masks, photographs must agree at so many missing cells of a surface of revolution at least.
LEAST_SHOWN = 10
# Sheets complete parts if at least this share of their pixels hits other parts.
TORN = 0.05
# A cell of a shape exists in the scan if the scan has a surface within this many edges in front of or behind
# it, at four points: these offsets from the centre, in cells, along both axes.
WITHIN, _BESIDE = 0.75, (-0.25, 0.25)


def torn_parts(
    room: Room,
    label: np.ndarray,
    masked: Sequence[MaskedView],
    edge: float,
    progress: Progress = unwatched,
) -> list[Surface]:
    """Surfaces that complete the torn parts of a scan.

    Mitsuba's variant must be set.

    Args:
        room: the scan.
        label: (T,) id of the part of each triangle, 0 or less for none.
        masked: the training views with masks.
        edge: median edge of the scan, metres.

    Returns:
        for each its surface, whose triangles are on no planes.
    """
    normals, areas = face_vectors(room.vertices.astype(np.float64), room.triangles)
    middles = room.vertices.astype(np.float64)[room.triangles].mean(axis=1)
    pixels, found = (sum(getattr(one, name) for one in masked) for name in ("pixels", "found"))
    parts = np.unique(label[label > 0])
    completion = _Completion(room, masked, edge)
    completion.look()
    flat = np.ones(len(label), bool)
    for number, part in enumerate(parts):
        for thing in _things(middles, np.flatnonzero(label == part), APART * edge):
            for revolution in fit_revolutions(middles[thing], normals[thing], areas[thing], edge):
                completion.add(revolution, part, _missing_round)
                flat[thing] = False
        progress(0.5 * (number + 1) / len(parts))
    completion.look()  # not before: the outside of a shade would occlude its inside
    rng = np.random.default_rng(0)
    torn = parts[found[parts] < (1.0 - TORN) * pixels[parts]]
    for number, part in enumerate(torn):
        progress(0.5 + 0.5 * number / len(torn))
        rows = np.flatnonzero((label == part) & flat)
        sheets = fit_sheets(middles[rows], normals[rows], areas[rows], edge, LEAST_TRIANGLES, rng)
        # Nearer sheets are completed first, and occlude those behind.
        for sheet in sorted(sheets, key=lambda sheet: completion.distance(sheet, part)):
            completion.add(sheet, part, _missing_flat)
            completion.look()
    return completion.added


def torn_round_things(room: Room, pixels: ComparedPixels, edge: float) -> list[Surface]:
    """Surfaces that complete round things of a scan where no masks tell parts apart.

    Photographs take the place of masks: they agree at a cell that is missing, and not on what the scan has
    behind it.

    Args:
        room: the scan.
        pixels: of the training views on it.
        edge: median edge of the scan, metres.

    Returns:
        as `torn_parts`.
    """
    normals, areas = face_vectors(room.vertices.astype(np.float64), room.triangles)
    middles = room.vertices.astype(np.float64)[room.triangles].mean(axis=1)
    none = np.zeros(len(room.triangles), bool)
    on_plane = none if room.plane is None else room.plane != NONE
    rows = np.flatnonzero(~on_plane & ~(none if room.exact is None else room.exact))
    found = []
    for thing in _things(middles, rows, APART * edge):
        for revolution in fit_revolutions(middles[thing], normals[thing], areas[thing], edge):
            has = _on_scan(revolution, room, edge)
            votes = _agreement(revolution, pixels, ~has)
            if votes.yes.any() and (chosen := _missing_round(has, votes)).any():
                vertices, triangles, facing = revolution.surface(chosen)
                found.append((vertices, triangles, facing, np.full(len(triangles), NONE)))
    return found


def _agreement(shape: CellSurface, pixels: ComparedPixels, missing: np.ndarray) -> _Votes:
    """Votes of photographs on the missing cells (R, S) bool of a shape; all views of a cell vote alike.

    None vote for it unless they do at nearly all of the cells that enough views see.
    """
    centres, facing = (each.reshape(-1, 3) for each in shape.cells())
    gain, count = (each.reshape(shape.shape) for each in pixels.gains(centres, facing))
    seen = missing & (count >= LEAST_VIEWS)
    shown = seen & (gain > LEAST_GAIN)
    enough = shown.sum() >= max(LEAST_SHOWN, (1.0 - MISSES) * seen.sum())
    none = np.zeros_like(count)
    yes, no = np.where(shown & enough, count, 0), np.where(seen & ~shown, count, 0)
    return _Votes(yes, none, no, none.astype(np.float64))


class _Completion:
    """Surfaces that are added to a scan one after the other.

    Args:
        room: the scan.
        masked: views with masks.
        edge: median edge of the scan, metres.
    """

    def __init__(self, room: Room, masked: Sequence[MaskedView], edge: float) -> None:
        self._rooms, self._masked, self._edge = [room], list(masked), edge
        self._seen = 1
        self.added: list[Surface] = []

    def look(self) -> None:
        """Let the surfaces that have been added occlude what is behind them."""
        for room in self._rooms[self._seen :]:
            for number, one in enumerate(self._masked):
                reached = first_hits(trace_pixels(room, one.view))[1].reshape(one.distance.shape)
                nearer = reached < one.distance
                distance = np.where(nearer, reached, one.distance).astype(np.float32)
                self._masked[number] = replace(one, distance=distance, same=one.same | nearer)
        self._seen = len(self._rooms)

    def add(self, shape: CellSurface, part: int, missing: Callable[[np.ndarray, _Votes], np.ndarray]) -> None:
        """Add the missing cells of a shape, if there are any.

        Args:
            missing: returns the cells to add (R, S), given those that exist already and the votes.
        """
        has = np.logical_or.reduce([_on_scan(shape, room, self._edge) for room in self._rooms])
        chosen = missing(has, _votes(shape, self._masked, part, self._edge))
        if chosen.any():
            vertices, triangles, normals = shape.surface(chosen)
            none = np.full(len(triangles), NONE, np.int32)
            self.added.append((vertices, triangles, normals, none))
            self._rooms.append(Room(vertices, triangles, normals, none, none))

    def distance(self, shape: CellSurface, part: int) -> float:
        """Mean distance in metres between views and the cells that they show."""
        votes = _votes(shape, self._masked, part, self._edge)
        return float(votes.distance.sum() / max(votes.yes.sum(), 1))


@dataclass(frozen=True)
class _Votes:
    """Votes on cells of a shape by the views that see their fronts, in front of the scan.

    Attributes:
        yes: (R, S) int, views that show the part where the scan has something else behind the cell.
        there: (R, S) int, views that show the part where the scan has it, behind the cell, off the shape.
        no: (R, S) int, views that show another part.
        distance: (R, S) metres, sum of the distances of the `yes` views.
    """

    yes: np.ndarray
    there: np.ndarray
    no: np.ndarray
    distance: np.ndarray

    @property
    def wrong(self) -> np.ndarray:
        """(R, S) bool, cells that the votes reject."""
        views = self.yes + self.there + self.no
        return np.asarray((self.no > MISSES * views) | (self.there > self.yes))


def _things(middles: np.ndarray, rows: np.ndarray, apart: float) -> list[np.ndarray]:
    """The triangles `rows` of a part, divided into pieces that are apart; without pieces of few triangles."""
    cell = np.floor(middles[rows] / apart).astype(np.int64)
    cell += 1 - cell.min(axis=0)
    grid = np.zeros(cell.max(axis=0) + 2, bool)
    grid[tuple(cell.T)] = True
    piece = connected(grid, np.ones((3, 3, 3)))[0][tuple(cell.T)]
    pieces = (rows[piece == number] for number in np.flatnonzero(np.bincount(piece) >= LEAST_TRIANGLES))
    return list(pieces)


def _on_scan(shape: CellSurface, room: Room, edge: float) -> np.ndarray:
    """(R, S) bool, cells where the scan has a surface that faces the same way."""
    has = np.ones(shape.shape, bool)
    for down in _BESIDE:
        for across in _BESIDE:
            places, facing = (each.reshape(-1, 3) for each in shape.cells(down, across))
            start = places + WITHIN * edge * facing
            surface = room.intersect(rays_along(start, -facing))
            there = np.array(surface.front) & (first_hits(surface)[1] < 2.0 * WITHIN * edge)
            has &= there.reshape(has.shape)
    return has


def _votes(shape: CellSurface, masked: Sequence[MaskedView], part: int, tolerance: float) -> _Votes:
    """Votes on a part at the cells of a shape that are `tolerance` metres or more in front of the scan."""
    centres, facing = (each.reshape(-1, 3) for each in shape.cells())

    def of_view(one: MaskedView) -> tuple[np.ndarray, ...]:
        ray = one.place - centres
        rows = np.flatnonzero((ray * facing).sum(axis=1) > LEAST_COSINE * np.linalg.norm(ray, axis=1))
        seen, y, x = one.seen(centres[rows], tolerance)
        rows = rows[seen]
        shown, same = one.shown(part)[y, x], one.same[y, x]
        away = np.linalg.norm(ray[rows], axis=1)
        far = one.distance[y, x]
        far = np.where(np.isfinite(far), far, 0.0)
        # Through a hole, a view also sees the opposite side of a round thing, which is on the shape.
        behind = one.place + far[:, None] * (-ray[rows] / away[:, None])
        yes = (shown > 0) & ~same
        there = (shown > 0) & same & ~shape.near(behind, 2.0 * tolerance)
        return rows, yes, there, shown < 0, yes * away

    sums = np.zeros((4, len(centres)))
    for rows, *columns in in_threads(of_view, masked):
        for total, column in zip(sums, columns, strict=True):
            total[rows] += column
    return _Votes(*sums.reshape(4, *shape.shape))


def _missing_round(has: np.ndarray, votes: _Votes) -> np.ndarray:
    """(R, S) bool, cells to be added to a surface of revolution; none if masks show no missing ones.

    Cells that no view sees are added, too: the thing is round.
    """
    wanted = ~has & ~votes.wrong
    if not (wanted & (votes.yes >= LEAST_VIEWS)).any():
        return np.zeros(has.shape, bool)
    if (has | (wanted & (votes.yes > 0))).mean() < LEAST_KNOWN:
        return np.zeros(has.shape, bool)
    # One cell more at the borders, so that no gap is left between what is there and what is added.
    around = np.concatenate([wanted[:, -1:], wanted, wanted[:, :1]], axis=1)
    return np.asarray(binary_dilation(around)[:, 1:-1] & ~votes.wrong)


def _missing_flat(has: np.ndarray, votes: _Votes) -> np.ndarray:
    """(R, S) bool, cells to be added to a sheet: those that views show, unless they are fringes."""
    shows = ~has & (votes.yes >= LEAST_VIEWS) & ~votes.wrong
    wanted = shows & binary_opening(shows | has, np.ones((3, 3)))
    wanted &= binary_propagation(binary_opening(shows, np.ones((3, 3))), mask=wanted)
    return np.asarray(wanted | (binary_dilation(wanted) & has))
