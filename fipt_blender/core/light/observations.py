# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the photographs say about the room before anything is estimated: which surface points they saw, in
which voxels, of which parts, and what they saw outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..job.settings import Settings
from ..scene.labels import Parts
from ..scene.pixels import PixelStore, find_donors
from ..scene.room import Room, triangle_normals
from .cache import SIDES, VoxelGrid, make_grid, pool
from .environment import Environment, estimate_environment, outside_pixels

# Steps in the image within which a mixed pixel borrows from a pure one of its part.
DONOR_REACH = 4
# About so many pixels give the median footprint.
FOOTPRINT_PIXELS = 200_000


@dataclass(frozen=True)
class Observations:
    """The pixels of all training views and what follows from them.

    Attributes:
        pixels: N of them.
        parts: of the room's triangles.
        hit: (H,) int64 pixels that see the mesh.
        grid: voxels of the radiance cache.
        entries: (H,) int64 cache entry of each of them.
        environment: in units of the capture's median, None where no pixel looks outside.
        footprint: median width of a pixel on the surfaces, metres.
    """

    pixels: PixelStore
    parts: Parts
    hit: np.ndarray
    grid: VoxelGrid
    entries: np.ndarray
    environment: Environment | None
    footprint: float

    def positions(self) -> np.ndarray:
        """(H, 3) float32 surface points seen, metres."""
        return np.asarray(self.pixels.position[self.hit])

    def cache(self, without: np.ndarray | None = None) -> np.ndarray:
        """(M * 6, 3) float32 radiance cache of all pixels, or of all but those lit by the emitters `without`
        ((T,) bool).

        The rim pixels around a lamp hold some of its radiance. Beside emitters of known radiance and shape
        they would count it twice and make the whole room's shadings a few per cent too bright.
        """
        keep: slice | np.ndarray = slice(None)
        if without is not None and without.any():
            keep = ~self._near(without)[self.hit]
        radiance = np.asarray(self.pixels.radiance[self.hit[keep]])
        return pool(self.grid, self.entries[keep], radiance)[0]

    def _near(self, marked: np.ndarray) -> np.ndarray:
        """(N,) bool, pixels that see a marked triangle ((T,) bool), and their neighbours in the image."""
        near = np.zeros(len(self.pixels), bool)
        for index, view in enumerate(self.pixels.views):
            rows = slice(int(self.pixels.ranges[index]), int(self.pixels.ranges[index + 1]))
            triangle = np.asarray(self.pixels.triangle[rows])
            seen = ((triangle >= 0) & marked[np.maximum(triangle, 0)]).reshape(view.height, view.width)
            if seen.any():
                wide = np.pad(seen, 1)
                wide = wide[:-2] | wide[1:-1] | wide[2:]
                near[rows] = (wide[:, :-2] | wide[:, 1:-1] | wide[:, 2:]).ravel()
        return near

    def pixel_parts(self) -> np.ndarray:
        """(N,) int32 part of each pixel, NO_PART without one and where the mesh is missed."""
        part = np.full(len(self.pixels), -1, np.int32)
        part[self.hit] = self.parts.triangle_part[self.pixels.triangle[self.hit]]
        return part

    def pixel_entries(self) -> np.ndarray:
        """(N,) int64 cache entry of each pixel, 0 where the mesh is missed."""
        entry = np.zeros(len(self.pixels), np.int64)
        entry[self.hit] = self.entries
        return entry

    def donors(self) -> np.ndarray:
        """(N,) int64 pixel that stands for each, -1 for none: see :func:`find_donors`.

        Without parts nothing says which neighbour shows the same surface. A mixed pixel without a donor
        stands for itself where no pixel sees its surface alone.
        """
        reach = DONOR_REACH if self.parts.kind == "part" else 0
        donors = find_donors(self.pixels, self.pixel_parts(), reach)
        pure = np.asarray(self.pixels.pure)[self.hit]
        alone = np.bincount(self.entries, pure, minlength=len(self.grid.voxels) * SIDES)
        lonely = self.hit[(alone[self.entries] == 0) & (donors[self.hit] < 0)]
        donors[lonely] = lonely
        return donors


def observe(room: Room, pixels: PixelStore, parts: Parts, settings: Settings) -> Observations:
    """Sort the pixels into voxels and look outside; quick, so it is not kept between sessions."""
    hit = np.flatnonzero(pixels.triangle >= 0)
    position = np.asarray(pixels.position[hit])
    seen = triangle_normals(room.vertices, room.triangles).astype(np.float32)[pixels.triangle[hit]]
    seen *= np.where(pixels.front[hit], np.float32(1.0), np.float32(-1.0))[:, None]
    rng = np.random.default_rng([settings.seed, 1])
    grid = make_grid(room, position, seen, settings.voxel_resolution, rng)
    return Observations(
        pixels=pixels,
        parts=parts,
        hit=hit,
        grid=grid,
        entries=grid.entries(position, seen),
        environment=estimate_environment(*outside_pixels(pixels), settings.environment_width),
        footprint=median_footprint(pixels),
    )


def median_footprint(pixels: PixelStore) -> float:
    """Median width in metres of a pixel on the surfaces that it sees."""
    hit = np.flatnonzero(pixels.triangle >= 0)
    some = hit[:: max(1, len(hit) // FOOTPRINT_PIXELS)]
    view_of = pixels.view_of(some)
    distance = np.linalg.norm(pixels.position[some] - pixels.camera_positions()[view_of], axis=1)
    focal = np.array([min(view.fx, view.fy) for view in pixels.views])
    return float(np.median(distance / focal[view_of]))
