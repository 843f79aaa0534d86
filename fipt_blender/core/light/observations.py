"""Observations of the photographs before any estimation: the surface points, voxels and parts of the pixels,
and the environment.

Data of the pixels is in memory-mapped files and processed view by view, so memory does not grow with the
number of views.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

from ..parts.labels import NO_PART, Parts, surface_labels
from ..pixels.mixed_pixels import find_donors
from ..pixels.store import PixelStore, open_array
from ..run.stage_settings import LightSettings
from ..run.threads import cached_property
from ..surface.room import Room
from .cache import Pool, VoxelGrid, seen_grid, unseen_points
from .environment import Environment, estimate_environment, outside_pixels

# Distance in pixels within which a pure pixel of the same part replaces a mixed one.
DONOR_REACH = 4
# Least information of a mixed pixel that is used, relative to that of a pure one.
MIN_WEIGHT = 0.01
# Stream of the random numbers that draw the pixels to train on.
POOL_STREAM = 9
# Approximate number of pixels for the median footprint.
FOOTPRINT_PIXELS = 200_000


@dataclass(frozen=True)
class Observations:
    """The pixels of all training views and data derived from them.

    Attributes:
        pixels: N of them.
        parts: of the room's triangles.
        surface: (T,) int32 surface of each triangle (:func:`..parts.labels.surface_labels`).
        grid: voxels of the radiance cache.
        entry: (N,) int32 cache entry of each pixel, -1 where the mesh is missed; memory-mapped.
        environment: in units of the capture's median, None where no pixel looks outside.
        footprint: median width of a pixel on the surfaces, metres.
        folder: for memory-mapped arrays.
        left_alone: (T,) bool triangles that are not estimated: their pixels are only used for the light that
            they send.
    """

    pixels: PixelStore
    parts: Parts
    surface: np.ndarray
    grid: VoxelGrid
    entry: np.ndarray
    environment: Environment | None
    footprint: float
    folder: Path
    left_alone: np.ndarray

    def hits(self) -> Iterator[np.ndarray]:
        """(n,) int64 pixels that see the mesh, view by view."""
        for index in range(len(self.pixels.views)):
            yield self.pixels.hits(index)

    def cache(self, without: np.ndarray | None = None) -> np.ndarray:
        """(M * 6, 3) float32 radiance cache of all pixels, or of all but those on the emitters `without`
        ((T,) bool). Unseen surfaces have their inferred radiance, if any.

        Pixels that a camera blurs over the edge of a lamp contain some of its radiance, too. With emitters of
        known radiance it would count twice and make the shadings of the whole room too bright.
        """
        pooled = Pool(self.grid, 3)
        for index, rows in enumerate(self.hits()):
            if without is not None and without.any():
                near = self._near(index, without)
                rows = rows[~near[rows - self.pixels.ranges[index]]]
            rows = rows[self.pixels.weight[rows] >= MIN_WEIGHT]
            pooled.add(self.entry[rows], self.pixels.own[rows], self.pixels.weight[rows])
        cache = pooled.filled()[0]
        environment = self.environment
        if environment is not None and environment.entries is not None:
            cache[environment.entries] = environment.radiance
        return cache

    def means(self, values: np.ndarray) -> np.ndarray:
        """(M * 6, C) float32 mean of per-pixel values in each cache entry; -1 in those that no pixel saw.

        Args:
            values: (N, C); may be memory-mapped.
        """
        return self._pooled(values).mean(missing=-1.0)[0]

    def places(self, room: Room, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A surface point in each cache entry that contains surface.

        Returns:
            (E,) int64 entries, (E, 3) float32 points, metres, and (E,) int64 triangles on which they lie; -1
            in entries with pixels, where the point is the mean of the pixels' positions.
        """
        points, count = self._pooled(self.pixels.position).mean()
        seen = np.flatnonzero(count)
        unseen, others, triangles = unseen_points(self.grid, room, count, rng)
        return (
            np.concatenate([seen, unseen]),
            np.concatenate([points[seen], others]),
            np.concatenate([np.full(len(seen), -1, np.int64), triangles]),
        )

    def _pooled(self, values: np.ndarray) -> Pool:
        """Per-pixel values (N, C) in each cache entry."""
        pooled = Pool(self.grid, values.shape[1])
        for rows in self.hits():
            pooled.add(self.entry[rows], values[rows])
        return pooled

    def _near(self, index: int, marked: np.ndarray) -> np.ndarray:
        """(n,) bool, pixels of a view that see a marked triangle ((T,) bool), and their neighbours."""
        view = self.pixels.views[index]
        triangle = np.asarray(self.pixels.triangle[self.pixels.rows(index)])
        on_marked = ((triangle >= 0) & marked[np.maximum(triangle, 0)]).reshape(view.height, view.width)
        return binary_dilation(on_marked, np.ones((3, 3), bool)).ravel()

    @cached_property
    def part(self) -> np.ndarray:
        """(N,) int32 part of each pixel, NO_PART without one and where the mesh is missed; memory-mapped."""
        part = open_array(self.folder / "part.npy", (len(self.pixels),), np.int32, create=True)
        # One more row, at -1, for pixels that miss the mesh.
        of_triangle = np.append(self.parts.triangle_part, np.int32(NO_PART))
        for index in range(len(self.pixels.views)):
            rows = self.pixels.rows(index)
            part[rows] = of_triangle[np.maximum(self.pixels.triangle[rows], -1)]
        return part

    @cached_property
    def donor(self) -> np.ndarray:
        """(N,) int64 pixel that replaces each, -1 for none: see :func:`find_donors`; memory-mapped.

        Without parts it is unknown which neighbour shows the same surface. A mixed pixel without a pure
        neighbour replaces itself, with what is known of the radiance of its own surface.
        """
        reach = DONOR_REACH if self.parts.kind == "part" else 0
        donors = open_array(self.folder / "donor.npy", (len(self.pixels),), np.int64, create=True)
        for index, hit in enumerate(self.hits()):
            rows = self.pixels.rows(index)
            found = find_donors(self.pixels, index, np.asarray(self.part[rows]), reach)
            known = np.asarray(self.pixels.weight[hit]) >= MIN_WEIGHT
            alone = hit[known & (found[hit - rows.start] < 0)]
            found[alone - rows.start] = alone
            found[hit[self.left_alone[self.pixels.triangle[hit]]] - rows.start] = -1
            donors[rows] = found
        return donors

    @cached_property
    def pool(self) -> np.ndarray:
        """(P,) int64 pixels to train on, ascending; memory-mapped.

        A pixel with a donor is drawn with the donor's weight as probability, so that the mean of a loss over
        the pool is its weighted mean.
        """
        views = range(len(self.pixels.views))
        counts = [len(self._drawn(index)) for index in views]
        pool = open_array(self.folder / "pool.npy", (sum(counts),), np.int64, create=True)
        ends = np.cumsum(counts)
        for index in views:
            pool[ends[index] - counts[index] : ends[index]] = self._drawn(index)
        return pool

    def _drawn(self, index: int) -> np.ndarray:
        """(n,) int64 pixels of a view that belong to the pool."""
        rows = self.pixels.rows(index)
        donor = np.asarray(self.donor[rows])
        weight = np.where(donor >= 0, self.pixels.weight[np.maximum(donor, 0)], 0.0)
        drawn = np.random.default_rng([POOL_STREAM, index]).random(len(weight))
        return np.flatnonzero(drawn < weight) + rows.start


def observe(
    room: Room, pixels: PixelStore, parts: Parts, settings: LightSettings, folder: Path
) -> Observations:
    """Assign the pixels to voxels and estimate the environment; quick, so the result is not stored.

    Args:
        folder: for memory-mapped arrays, which are overwritten.
    """
    grid = seen_grid(pixels, room, settings.voxel_resolution, settings.seed)
    entry = open_array(folder / "entry.npy", (len(pixels),), np.int32, create=True)
    for index in range(len(pixels.views)):
        hit, rows = pixels.hits(index), pixels.rows(index)
        own = np.full(rows.stop - rows.start, -1, np.int32)
        own[hit - rows.start] = grid.entries(*pixels.surface(room, hit))
        entry[rows] = own
    return Observations(
        pixels=pixels,
        parts=parts,
        surface=surface_labels(room, parts),
        grid=grid,
        entry=entry,
        environment=estimate_environment(
            partial(outside_pixels, pixels),
            settings.environment_width,
            np.random.default_rng([settings.seed, 6]),
        ),
        footprint=median_footprint(pixels),
        folder=folder,
        left_alone=np.zeros(len(room.triangles), bool),
    )


def median_footprint(pixels: PixelStore) -> float:
    """Median width in metres of a pixel on the surfaces that it sees."""
    rows = pixels.some_hits(FOOTPRINT_PIXELS)
    view, focal = pixels.view_of(rows), np.array([min(view.fx, view.fy) for view in pixels.views])
    distance = np.linalg.norm(pixels.position[rows] - pixels.camera_positions()[view], axis=1)
    return float(np.median(distance.astype(np.float64) / focal[view]))
