"""The radiance cache L' of paper Eq. 9: all photographs averaged on a sparse voxel grid over the surfaces.

A voxel has six entries, one for each dominant direction of the surface normal, so that the two sides of a
lamp shade or a thin wall, and the walls of a corner, do not mix. Entries without pixels take the mean of the
smallest coarser voxel with pixels, instead of black.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..pixels.store import PixelStore
from ..run.threads import in_threads
from ..surface.room import Room

SIDES = 6  # of an entry: the directions of the axes
# Points per chunk: temporary arrays of all pixels of a large capture would take gigabytes.
CHUNK = 1 << 18
# Points are offset along their normal by this share of a voxel, so that a wall on a voxel border is in one.
LIFT = 0.25


@dataclass(frozen=True)
class VoxelGrid:
    """A sparse grid of the voxels that contain surfaces.

    Attributes:
        low: (3,) float64 lowest corner, metres.
        size: (3,) float64 edge lengths of a voxel, metres.
        resolution: voxels along each axis.
        rows: (resolution^3,) int32 row of each voxel; empty voxels next to a surface have a neighbour's row,
            others row 0.
        voxels: (M,) int64 flat voxel index of each row.
    """

    low: np.ndarray
    size: np.ndarray
    resolution: int
    rows: np.ndarray
    voxels: np.ndarray

    def flat_index(self, positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(N,) int64 flat voxel index of surface points with normals on the seen side."""

        def of_chunk(part: slice) -> np.ndarray:
            cell = (positions[part] + normals[part] * (LIFT * self.size) - self.low) / self.size
            x, y, z = np.clip(cell.astype(np.int64), 0, self.resolution - 1).T
            return (x * self.resolution + y) * self.resolution + z

        return np.concatenate(list(in_threads(of_chunk, _chunks(len(positions)))))

    def entries(self, positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(N,) int64 cache entry (row times six plus side) of surface points."""
        return self.rows[self.flat_index(positions, normals)].astype(np.int64) * SIDES + side_index(normals)


def side_index(normals: np.ndarray) -> np.ndarray:
    """(N,) int64 in 0..5: dominant axis of each normal, twice, plus one where it is negative."""

    def of_chunk(part: slice) -> np.ndarray:
        axis = np.abs(normals[part]).argmax(axis=1)
        negative = np.take_along_axis(normals[part], axis[:, None], axis=1)[:, 0] < 0
        return axis * 2 + negative

    return np.concatenate(list(in_threads(of_chunk, _chunks(len(normals)))))


def _chunks(count: int) -> list[slice]:
    return [slice(start, start + CHUNK) for start in range(0, max(count, 1), CHUNK)]


def seen_grid(pixels: PixelStore, room: Room, resolution: int, seed: int) -> VoxelGrid:
    """The grid of the voxels that pixels saw or that contain surface."""
    frame = grid_frame(room, resolution)
    seen = np.zeros(resolution**3, bool)
    for index in range(len(pixels.views)):
        seen[frame.flat_index(*pixels.surface(room, pixels.hits(index)))] = True
    return fill_grid(room, frame, np.flatnonzero(seen), np.random.default_rng([seed, 1]))


def grid_frame(room: Room, resolution: int) -> VoxelGrid:
    """The grid over the room's bounds, without rows."""
    low, high = room.bounds
    extent = np.maximum(high - low, 1e-3 * (high - low).max())
    size = extent / (resolution - 2)
    low = low - size  # a free layer, so that lifted points stay inside
    return VoxelGrid(low, size, resolution, np.zeros(0, np.int32), np.zeros(0, np.int64))


def fill_grid(room: Room, frame: VoxelGrid, seen: np.ndarray, rng: np.random.Generator) -> VoxelGrid:
    """The grid with a row for each voxel that was seen or that contains surface.

    Args:
        seen: (K,) int flat voxel indices.
    """
    samples, triangle = sample_surface(room, float(np.median(frame.size)), rng)
    sample_normals = room.normals[triangle]
    holds_surface = np.zeros(frame.resolution**3, bool)
    holds_surface[seen] = True
    for sign in (1.0, -1.0):
        holds_surface[frame.flat_index(samples, sign * sample_normals)] = True
    voxels = np.flatnonzero(holds_surface)
    rows = np.full(frame.resolution**3, -1, np.int32)
    rows[voxels] = np.arange(len(voxels), dtype=np.int32)
    _point_to_neighbours(rows.reshape((frame.resolution,) * 3))
    return VoxelGrid(frame.low, frame.size, frame.resolution, np.maximum(rows, 0), voxels)


def sample_surface(room: Room, spacing: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points (S, 3) all over the mesh, about `spacing` / 2 metres apart, and their triangles (S,)."""
    wanted = room.areas * 4.0 / spacing**2
    # Bounded, whatever the scale of the room.
    wanted *= min(1.0, 4e6 / max(wanted.sum(), 1.0))
    counts = np.maximum(np.ceil(wanted).astype(np.int64), 1)
    triangle = np.repeat(np.arange(len(counts)), counts)
    u, v = rng.random((2, len(triangle)))
    points = in_threads(lambda part: room.points_on(triangle[part], u[part], v[part]), _chunks(len(u)))
    return np.concatenate(list(points)), triangle


def unseen_points(
    grid: VoxelGrid, room: Room, count: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A surface point in each entry that contains surface but that no pixel saw.

    Args:
        count: (M * 6,) pixels in each entry, or their weight.

    Returns:
        (U,) int64 entries, (U, 3) float32 points, metres, and (U,) triangles on which they lie.
    """
    points, triangle = sample_surface(room, float(np.median(grid.size)), rng)
    normals = room.normals[triangle]
    entries = np.concatenate([grid.entries(points, sign * normals) for sign in (1.0, -1.0)])
    of_unseen = np.flatnonzero(count[entries] == 0)
    entries = entries[of_unseen]
    first = np.full(len(count), -1, np.int64)
    first[entries[::-1]] = of_unseen[::-1]  # the last value that is written stays
    unseen = np.flatnonzero(first >= 0)
    place = first[unseen] % len(points)
    return unseen, points[place].astype(np.float32), triangle[place]


def _point_to_neighbours(rows: np.ndarray) -> None:
    """Give empty voxels next to filled ones their neighbour's row, in place: rounding may query them."""
    filled = rows >= 0
    for axis in range(3):
        for step in (1, -1):
            source = np.roll(rows, step, axis=axis)
            usable = np.roll(filled, step, axis=axis) & (rows < 0)
            edge = [slice(None)] * 3
            edge[axis] = slice(0, 1) if step == 1 else slice(-1, None)
            usable[tuple(edge)] = False  # np.roll wraps around
            rows[usable] = source[usable]


def pool(grid: VoxelGrid, entries: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Average values on cache entries and fill the entries without any.

    Args:
        entries: (N,) entry of each value.
        values: (N, C) floats.

    Returns:
        (filled (M * 6, C) float32, weight (M * 6,) float64 number of values that fell into each entry).
    """
    pooled = Pool(grid, values.shape[1])
    pooled.add(entries, values)
    return pooled.filled()


class Pool:
    """Sums of values on cache entries, accumulated in chunks: see :func:`pool`."""

    def __init__(self, grid: VoxelGrid, channels: int) -> None:
        total = len(grid.voxels) * SIDES
        self._grid = grid
        self._weight = np.zeros(total)
        self._sums = np.zeros((channels, total))

    def add(self, entries: np.ndarray, values: np.ndarray, weight: np.ndarray | None = None) -> None:
        """Accumulate (N, C) values on (N,) entries; the result does not depend on the chunks' sizes.

        Args:
            weight: (N,) of the values; 1 each if None.
        """
        factor = np.ones(len(entries)) if weight is None else weight.astype(np.float64)
        np.add.at(self._weight, entries, factor)
        for sums, column in zip(self._sums, values.T, strict=True):
            np.add.at(sums, entries, factor * column)

    def mean(self, missing: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """(M * 6, C) float32 mean of each entry, `missing` without values, and (M * 6,) sum of weights."""
        mean = np.full((len(self._weight), len(self._sums)), missing, np.float32)
        observed, values = self._observed()
        mean[observed] = values
        return mean, self._weight

    def filled(self) -> tuple[np.ndarray, np.ndarray]:
        """The same with missing means filled; see :func:`pool`."""
        observed, values = self._observed()
        # Upwards: means that the coarser voxels add up, and how many each is the sum of.
        number, entry, means = np.ones(len(observed), np.int64), observed, values
        voxel, size = self._grid.voxels, self._grid.resolution
        coarser = []  # of each coarser grid: the voxel that holds each finer one, entries with values, means
        while size > 1:
            x, y, z = np.unravel_index(voxel, (size,) * 3)
            size = (size + 1) // 2
            coarse = ((x >> 1) * size + (y >> 1)) * size + (z >> 1)
            exists = np.zeros(size**3, bool)
            exists[coarse] = True
            voxel, parent = np.flatnonzero(exists), (np.cumsum(exists) - 1)[coarse]
            key = parent[entry // SIDES] * SIDES + entry % SIDES
            totals = len(voxel) * SIDES
            number = np.bincount(key, number, minlength=totals).astype(np.int64)
            entry = np.flatnonzero(number)
            values = np.stack([np.bincount(key, column, minlength=totals)[entry] for column in values.T], 1)
            number = number[entry]
            coarser.append((parent, entry, values / number[:, None]))
        # Downwards: entries without values keep those of the coarser voxel.
        total = float(self._weight.sum())
        every = self._sums.sum(axis=1) / (total if total > 0.0 else 1.0)
        filled = np.tile(every.astype(np.float32), (SIDES, 1))
        for parent, entry, coarse_means in reversed(coarser):
            filled[entry] = coarse_means
            filled = filled.reshape(-1, SIDES * len(every))[parent].reshape(-1, len(every))
        filled[observed] = means
        return filled, self._weight

    def _observed(self) -> tuple[np.ndarray, np.ndarray]:
        """(O,) entries with values, ascending, and their (O, C) float64 means."""
        observed = np.flatnonzero(self._weight > 0.0)
        return observed, (self._sums[:, observed] / self._weight[observed]).T


class SurfaceLookup:
    """Values on the entries of a grid, for gathers at ray hits in Dr.Jit kernels.

    Args:
        grid: the voxels.
        values: (M * 6, C) float32.
    """

    def __init__(self, grid: VoxelGrid, values: np.ndarray) -> None:
        self._resolution = grid.resolution
        self._low = [float(value) for value in grid.low]
        self._size = [float(value) for value in grid.size]
        self._rows = mi.Int32(grid.rows)
        self._set(values)

    def _set(self, values: np.ndarray) -> None:
        self._channels = values.shape[1]
        self._values = mi.Float(np.ascontiguousarray(values, np.float32).reshape(-1))

    def with_values(self, values: np.ndarray) -> SurfaceLookup:
        """A lookup of other values ((M * 6, C)) that shares the grid's rows: 64 MB at 256 voxels."""
        other = copy.copy(self)
        other._set(values)
        return other

    def __call__(
        self, position: mi.Point3f, side_normal: mi.Normal3f, active: mi.Bool = True
    ) -> list[mi.Float]:
        """The C values at surface points; see :meth:`entry`."""
        return self.values(self.entry(position, side_normal, active), active)

    def entry(self, position: mi.Point3f, side_normal: mi.Normal3f, active: mi.Bool = True) -> mi.UInt32:
        """Entry of surface points, the same for all tables of a grid.

        Args:
            position: metres.
            side_normal: geometric normal on the side of interest.
        """
        n = mi.Vector3f(side_normal)
        size, low = mi.Vector3f(*self._size), mi.Point3f(*self._low)
        cell = mi.Point3i(dr.floor((position + n * size * LIFT - low) / size))
        cell = dr.clip(cell, 0, self._resolution - 1)
        voxel = (cell.x * self._resolution + cell.y) * self._resolution + cell.z
        row = dr.gather(mi.Int32, self._rows, mi.UInt32(voxel), active)
        a = dr.abs(n)
        # The same choice as side_index: the first of equal axes wins.
        axis = dr.select((a.x >= a.y) & (a.x >= a.z), 0, dr.select(a.y >= a.z, 1, 2))
        component = dr.select(axis == 0, n.x, dr.select(axis == 1, n.y, n.z))
        return mi.UInt32(row * SIDES + axis * 2 + dr.select(component < 0.0, 1, 0))

    def values(self, entry: mi.UInt32, active: mi.Bool = True) -> list[mi.Float]:
        """The C values of entries."""
        base = entry * self._channels
        return [dr.gather(mi.Float, self._values, base + i, active) for i in range(self._channels)]
