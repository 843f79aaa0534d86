"""Cells that sources of unseen light consist of, and the rays that land on them (:mod:`.unseen_light`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from ..pixels.grouped import grouped_sums, numbered
from ..surface.room import Room
from .cache import SIDES, VoxelGrid
from .clipped import ON_LAMP, OUTSIDE, hemisphere_rays
from .environment import Hull, map_cells
from .observations import Observations
from .sources import DARKEST, Expectation, SourceLight, Transport

RAYS, CHUNK = 1024, 256  # from each point; points at a time
# Width of sources in metres, and at most this share of the room's largest side, which has at most so many.
SIZE, SIZE_SHARE, MAX_CELLS = 0.5, 0.1, 32
# A source consists of cells, so many along its width. It is halved as long as it casts more than this share
# of the light, and there are fewer sources than that.
FINER, DIVIDED_SHARE, MAX_DIVIDED = 4, 0.005, 400
HALVES = 4  # of a source that is halved along both sides: most are flat
UNSEEN = 4  # voxels along each side of the cubes of which a side is unseen if no pixel sees it
DARK_OUTSIDE = 0.01  # least expected radiance outside, in units of the capture's median


def middles(grid: VoxelGrid, entry: np.ndarray) -> np.ndarray:
    """(..., 3) middles of the voxels of cache entries, metres; of the first one for negative entries."""
    corner = np.stack(np.unravel_index(grid.voxels, (grid.resolution,) * 3), axis=1)
    return np.asarray(((corner + 0.5) * grid.size + grid.low)[np.maximum(entry, 0) // SIDES])


@dataclass(frozen=True, eq=False)
class Rays:
    """Where R rays from each of N points land.

    Attributes:
        entry: (N, R) int32 cache entry, ON_LAMP or OUTSIDE.
        cell: (N, R) int32 of :class:`Cells`; -1 where photographs show what is there.
        direction: (N, R, 3) float32.
    """

    entry: np.ndarray
    cell: np.ndarray
    direction: np.ndarray


def traced(
    observed: Observations,
    room: Room,
    cells: Cells,
    lamps: np.ndarray,
    lit: tuple[np.ndarray, np.ndarray],
    seed: int,
    count: int = RAYS,
) -> Rays:
    """Rays from points.

    Args:
        lamps: (T,) bool, lamps of known radiance.
        lit: (N, 3) positions, metres, and (N, 3) normals.
    """
    known, environment, found = np.where(lamps, 0, -1).astype(np.int32), observed.environment, []
    for number, first in enumerate(range(0, len(lit[0]), CHUNK)):
        position, normal = (array[first : first + CHUNK] for array in lit)
        stream = seed * 1009 + number
        entry, direction = hemisphere_rays(room, observed.grid, position, normal, known, stream, count)
        cell, outside = cells.of_entry[np.maximum(entry, 0)], entry == OUTSIDE
        cell[entry == ON_LAMP] = -1
        start = np.broadcast_to(position[:, None], direction.shape)
        cell[outside] = cells.hull.cells(start[outside], direction[outside])
        if environment is not None:
            pixel = map_cells(direction, environment.seen.shape[1])
            cell[outside & environment.seen.reshape(-1)[pixel]] = -1
        found.append((entry, cell.astype(np.int32), direction.astype(np.float32)))
    return Rays(*(np.concatenate(column) for column in zip(*found, strict=True)))


@dataclass(frozen=True, eq=False)
class Cells:
    """F cells of which sources consist: those of the hull, and after these cubes of unseen surfaces by side.

    Attributes:
        hull: around mesh and cameras: light comes from outside of what photographs looked through.
        of_entry: (M * 6,) int64 cell of each cache entry, -1 where photographs show it.
        cube: (F, 3) int place of each, in widths of a cell.
        side: (F,) int to which it shines, as of cache entries: an axis twice, plus one in negative direction.
        size: metres, FINER widths of a cell.
    """

    hull: Hull
    of_entry: np.ndarray
    cube: np.ndarray
    side: np.ndarray
    size: float

    @classmethod
    def of(cls, observed: Observations, room: Room) -> Cells:
        """Those of a room."""
        cameras = observed.pixels.camera_positions()
        low, high = np.minimum(room.bounds[0], cameras.min(0)), np.maximum(room.bounds[1], cameras.max(0))
        longest = float((high - low).max())
        size = max(min(SIZE, SIZE_SHARE * longest), longest / MAX_CELLS)
        hull, grid = Hull.around((low, high), size / FINER), observed.grid
        count, seen = len(hull.radiance), np.zeros(len(grid.voxels) * SIDES, bool)
        for rows in observed.hits():
            seen[observed.entry[rows]] = True
        corner = np.stack(np.unravel_index(grid.voxels, (grid.resolution,) * 3), axis=1)
        block = numbered([*np.repeat(corner // UNSEEN, SIDES, 0).T, np.tile(np.arange(SIDES), len(corner))])
        entry = np.flatnonzero(np.bincount(block, seen)[block] == 0.0)
        cube = np.floor(corner[entry // SIDES] * grid.size / (size / FINER)).astype(np.int64)
        side = entry % SIDES
        patch = numbered([*cube.T, side]) if len(entry) else entry
        first = np.unique(patch, return_index=True)[1]
        of_entry = np.full(len(seen), -1, np.int64)
        of_entry[entry] = patch + count
        around = np.stack(np.unravel_index(np.arange(count) // 6, tuple(hull.counts)), axis=1)
        return cls(
            hull,
            of_entry,
            np.concatenate([around, cube[first]]),
            np.concatenate([np.arange(count) % 6, side[first]]),
            size,
        )

    @property
    def outside(self) -> np.ndarray:
        """(F,) bool, those of the hull."""
        return np.arange(len(self.cube)) < len(self.hull.radiance)

    def sources(self, width: int) -> np.ndarray:
        """(F,) int64 from 0, sources of so many cells along each side."""
        return numbered([self.outside.astype(np.int64), *(self.cube // width).T, self.side])


@dataclass(frozen=True, eq=False)
class Landed:
    """Where rays from N points land.

    Attributes:
        counts: (N, F) share of each point's rays that land on each cell, sparse.
        seen: (N, 3) irradiance over pi by all that is neither source nor lamp of known radiance.
        source: (F,) int64 from 0, -1 for cells that are left as they are.
        sums: (F, 9) of the rays: logarithm of the radiance that cache and environment have for the cell,
            landing place in metres, direction; and number (F,) of rays.
    """

    counts: csr_array
    seen: np.ndarray
    source: np.ndarray
    sums: np.ndarray
    number: np.ndarray

    @classmethod
    def of(
        cls, rays: Rays, observed: Observations, lamps: np.ndarray, cells: Cells, source: np.ndarray
    ) -> Landed:
        """Those of rays; `lamps`: as of :func:`traced`, `source`: of each cell."""
        cache, environment, grid = observed.cache(lamps), observed.environment, observed.grid
        size = len(source)
        seen, sums, number = [], np.zeros((size, 9)), np.zeros(size)
        for first in range(0, len(rays.entry), CHUNK):
            entry, cell, way = (
                array[first : first + CHUNK] for array in (rays.entry, rays.cell, rays.direction)
            )
            light = np.where((entry >= 0)[..., None], cache[np.maximum(entry, 0)], 0.0)
            if environment is not None:
                pixel = map_cells(way, environment.seen.shape[1])
                far = environment.image.reshape(-1, 3)[pixel]
                light = np.where((entry == OUTSIDE)[..., None], far, light)
            inside = np.append(source, -1)[cell] >= 0
            seen.append(np.where(inside[..., None], 0.0, light).mean(axis=1))
            own, on_hull = cell[inside], entry[inside] < 0
            place = middles(grid, entry[inside])
            place[on_hull] = cells.hull.centers(own[on_hull])
            logs = np.log(np.maximum(light[inside], DARKEST))
            logs[on_hull] = np.maximum(logs[on_hull], np.log(DARK_OUTSIDE))
            columns = np.concatenate([logs, place, way[inside]], axis=1)
            sums += grouped_sums(columns, own, size)
            number += np.bincount(own, minlength=size)
        row, ray = np.nonzero(rays.cell >= 0)
        share = np.full(len(row), 1.0 / rays.cell.shape[1])
        counts = csr_array((share, (row, rays.cell[row, ray])), shape=(len(rays.cell), size))
        return cls(counts, np.concatenate(seen), source, sums, number)

    def _by_source(self, values: np.ndarray) -> np.ndarray:
        """(K, ...) sums over the cells (F, ...) of each source."""
        own = self.source >= 0
        return grouped_sums(values[own], self.source[own], int(self.source.max()) + 1)

    def means(self) -> np.ndarray:
        """(K, 9) means of what the cells have sums of."""
        number = self._by_source(self.number[:, None])
        return np.asarray(self._by_source(self.sums) / np.maximum(number, 1.0))

    def transport(self, logs: np.ndarray, group: np.ndarray, known: np.ndarray) -> Transport:
        """The points with the light of the sources; `logs`: (N, 3) logarithms of their radiance, others as of
        `Transport`."""
        own = np.flatnonzero(self.source >= 0)
        shape = (len(self.source), int(self.source.max()) + 1)
        member = csr_array((np.ones(len(own)), (own, self.source[own])), shape=shape)
        return Transport(logs, group, self.seen, (self.counts @ member).toarray(), known)

    def expectation(self, cells: Cells) -> Expectation:
        """What is expected of the sources before their light is measured."""
        return Expectation(self.means()[:, :3], self._by_source(cells.outside[:, None])[:, 0] > 0)

    def divided(
        self,
        cells: Cells,
        points: Transport,
        expected: Expectation,
        light: SourceLight,
        width: np.ndarray,
    ) -> tuple[Landed, Expectation, np.ndarray] | None:
        """With halves of the sources that cast much light, what is expected of these, and their widths in
        cells; None where none is divided.

        Halves are expected to be as bright as their whole was found. Sources on the hull stay whole: what
        shines through an opening is farther away than that.
        """
        share = light.shares(points).mean(axis=0)
        much = (share > DIVIDED_SHARE) & (width > 1) & ~expected.outside
        order = np.argsort(-np.where(much, share, 0.0), kind="stable")
        much[order[max(MAX_DIVIDED - len(width), 0) // HALVES :]] = False
        if not much.any():
            return None
        own = np.flatnonzero((self.source >= 0) & (self.number > 0.0))
        before = self.source[own]
        half = np.where(much, width // 2, width)
        finer = np.full(len(self.source), -1, np.int64)
        cube = cells.cube[own] // half[before][:, None]
        parts = numbered([before, *np.where(much[before][:, None], cube, 0).T])
        finer[own] = parts
        parent = np.zeros(int(parts.max()) + 1, np.int64)
        parent[parts] = before
        logs = np.where(much[:, None], np.log(light.radiance), expected.log_radiance)
        finer_expected = Expectation(logs[parent], expected.outside[parent])
        return replace(self, source=finer), finer_expected, half[parent]
