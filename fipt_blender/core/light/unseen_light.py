# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from what no photograph shows: through the openings of a mesh, and from its unseen surfaces.

Rays from points of the surfaces land on surfaces that photographs show, on others, or on the hull of the mesh.
Landing places of the last two kinds that are close together are one source; :mod:`.sources` finds its
radiance. It is kept only if points that were held back fit better with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..conventions import equirect_pixel_directions
from ..pixels.grouped import numbered
from ..pixels.store import PixelStore
from ..surface.room import Room
from .cache import SIDES, VoxelGrid
from .clipped import MOST_POINTS, OUTSIDE, hemisphere_rays
from .environment import Environment, Hull, map_cells
from .observations import Observations
from .sources import (
    DARKEST,
    LEAST_GROUP,
    Expectation,
    SourceLight,
    Transport,
    held_back_gain,
    solve_sources,
)

RAYS = 512  # from each point
# Width of sources in metres, and at most this share of the room's largest side.
SIZE, SIZE_SHARE = 0.5, 0.1
# Voxels along each side of the cubes of which a side is unseen if no pixel sees it.
UNSEEN = 4
# Sources on which fewer of all rays land are left as they are, and at most so many are solved for.
LEAST_SHARE, MOST_SOURCES = 2e-5, 200
# Points of one surface whose colors differ by less, in logarithms of ratios, have one albedo.
COLOR_STEP = 0.25
LEAST_POINTS, LEAST_WEIGHT = 200, 0.5  # pixels that are compared, and the weight of each
GAIN = 3.0  # least logarithm of the likelihood of points held back
NORMAL_WEIGHT = 0.5  # metres that opposite normals are apart where the light of a point is that of another


def with_unseen_light(observed: Observations, room: Room, label: np.ndarray, seed: int) -> Observations:
    """Observations whose environment has the light that nothing shows, if points held back confirm it.

    Args:
        label: (T,) int surface of each triangle, on which points of one color have one albedo.
    """
    found = find_sources(observed, room, label, seed)
    if found is None or found.gain < GAIN:
        return observed
    return replace(observed, environment=found.environment(observed, room))


@dataclass(frozen=True, eq=False)
class Sources:
    """K sources, and the points that they light.

    Attributes:
        points: N of them. place: (N, 3) positions, normal: (N, 3).
        light: what was found. gain: see :func:`.sources.held_back_gain`.
        entries: (E,) int64 cache entries of unseen surfaces, of_entry: (E,) their source, -1 without.
        hull: with a source for each of its cells, -1 without, in place of radiance.
    """

    points: Transport
    where: np.ndarray
    expected: Expectation
    position: np.ndarray
    normal: np.ndarray
    light: SourceLight
    gain: float
    entries: np.ndarray
    of_entry: np.ndarray
    hull: Hull
    of_cell: np.ndarray

    def environment(self, observed: Observations, room: Room) -> Environment:
        """What was observed, with the light of the sources."""
        before = observed.environment
        width = 64 if before is None else before.image.shape[1]
        radiance = self.light.radiance.astype(np.float32)
        table = np.where((self.of_cell >= 0)[:, None], radiance[np.maximum(self.of_cell, 0)], 0.0)
        hull = replace(self.hull, radiance=table.astype(np.float32))
        seen = np.zeros((width // 2, width), bool) if before is None else before.seen
        image = np.zeros((*seen.shape, 3), np.float32) if before is None else before.image.copy()
        ways = equirect_pixel_directions(width, width // 2)[~seen]
        middle = np.broadcast_to(0.5 * (hull.low + hull.high), ways.shape)
        image[~seen] = hull.radiance[hull.cells(middle, ways)]
        known = self.of_entry >= 0
        share = self.light.share(self.points)
        tree = cKDTree(np.concatenate([self.position, NORMAL_WEIGHT * self.normal], axis=1))
        centers = room.vertices[room.triangles].mean(axis=1)
        near = tree.query(np.concatenate([centers, NORMAL_WEIGHT * room.normals], axis=1), 4)[1]
        return Environment(
            image,
            0.0 if before is None else before.observed_share,
            seen,
            share[near].mean(axis=1).astype(np.float32),
            hull,
            self.entries[known],
            radiance[self.of_entry[known]],
        )


def find_sources(observed: Observations, room: Room, label: np.ndarray, seed: int) -> Sources | None:
    """The sources with their radiance; None where the photographs show all that lights the room."""
    pixels, grid = observed.pixels, observed.grid
    where = _comparable(pixels, np.random.default_rng([seed, 23]))
    if len(where) < LEAST_POINTS:
        return None
    logs = np.log(np.asarray(pixels.own[where], np.float64))
    ratio = np.floor((logs[:, [0, 2]] - logs[:, [1]]) / COLOR_STEP).astype(np.int64)
    group = numbered([label[np.asarray(pixels.triangle[where])], *ratio.T])
    where = where[np.bincount(group)[group] >= LEAST_GROUP]
    if len(where) < LEAST_POINTS:
        return None
    group = np.unique(group[np.bincount(group)[group] >= LEAST_GROUP], return_inverse=True)[1].reshape(-1)
    position, normal = pixels.surface(room, where)
    nothing = np.full(len(room.triangles), -1, np.int32)
    entry, direction = hemisphere_rays(room, grid, position, normal, nothing, seed, RAYS)
    extent = float((room.bounds[1] - room.bounds[0]).max())
    size = min(SIZE, SIZE_SHARE * extent)
    hull = Hull.around(room.bounds, size)
    # Sources: of cache entries that no pixel sees, and of cells of the hull.
    source_of_entry = unseen_patches(grid, seen_entries(observed), size)
    outside = entry == OUTSIDE
    environment = observed.environment
    cell = np.full(entry.shape, -1, np.int64)
    start = np.broadcast_to(position[:, None], direction.shape)
    cell[outside] = hull.cells(start[outside], direction[outside])
    shown = np.zeros((*entry.shape, 3))
    if environment is not None:
        of_map = map_cells(direction[outside], environment.seen.shape[1])
        known = np.zeros(entry.shape, bool)
        known[outside] = environment.seen.reshape(-1)[of_map]
        shown[outside] = environment.image.reshape(-1, 3)[of_map]
        shown[~known] = 0.0
        cell[known] = -1
    patches = int(source_of_entry.max(initial=-1)) + 1
    source = np.where(
        entry >= 0, source_of_entry[np.maximum(entry, 0)], np.where(cell >= 0, patches + cell, -1)
    )
    count = np.bincount(source[source >= 0], minlength=patches + len(hull.radiance))
    chosen = np.argsort(-count, kind="stable")[:MOST_SOURCES]
    chosen = np.sort(chosen[count[chosen] > LEAST_SHARE * entry.size])
    if not len(chosen):
        return None
    number = np.full(len(count), -1, np.int64)
    number[chosen] = np.arange(len(chosen))
    place = np.where(source >= 0, number[np.maximum(source, 0)], -1)
    cache = observed.cache()
    shown = np.where((entry >= 0)[..., None], cache[np.maximum(entry, 0)], shown)
    shown[place >= 0] = 0.0
    rows = np.repeat(np.arange(len(where)), entry.shape[1]).reshape(entry.shape)
    pairs = rows[place >= 0] * len(chosen) + place[place >= 0]
    unseen = np.bincount(pairs, minlength=len(where) * len(chosen)).reshape(len(where), -1) / entry.shape[1]
    points = Transport(logs_of(pixels, where), group, shown.mean(axis=1), unseen)
    of_entry = np.where(source_of_entry >= 0, number[np.maximum(source_of_entry, 0)], -1)
    expected = expectation(cache, of_entry, len(chosen), chosen >= patches, points)
    gain = held_back_gain(points, expected, np.random.default_rng([seed, 24]))
    entries = np.flatnonzero(of_entry >= 0)
    light = solve_sources(points, expected)
    of_cell = number[patches:]
    lit = points, where, expected, position, normal
    return Sources(*lit, light, gain, entries, of_entry[entries], hull, of_cell)


def expectation(
    cache: np.ndarray, of_entry: np.ndarray, sources: int, outside: np.ndarray, points: Transport
) -> Expectation:
    """Of unseen surfaces what the cache has for them, of the hull the median light of the room."""
    mean = np.full((sources, 3), np.log(max(float(np.median(points.seen)), DARKEST)))
    known = np.flatnonzero(of_entry >= 0)
    logs = np.log(np.maximum(cache[known], DARKEST))
    number = np.bincount(of_entry[known], minlength=sources)
    for channel in range(3):
        sums = np.bincount(of_entry[known], logs[:, channel], sources)
        mean[number > 0, channel] = (sums / np.maximum(number, 1))[number > 0]
    return Expectation(mean, outside)


def logs_of(pixels: PixelStore, where: np.ndarray) -> np.ndarray:
    """(n, 3) logarithms of the radiance of pixels (n,)."""
    return np.log(np.asarray(pixels.own[where], np.float64))


def _comparable(pixels: PixelStore, rng: np.random.Generator) -> np.ndarray:
    """(N,) int64 pixels of surfaces, from all views alike."""
    share = max(1, MOST_POINTS // max(len(pixels.views), 1))
    chosen = [np.zeros(0, np.int64)]
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        good = (np.asarray(pixels.triangle[rows]) >= 0) & np.asarray(pixels.pure[rows])
        good &= (np.asarray(pixels.weight[rows]) >= LEAST_WEIGHT) & (pixels.own[rows] > DARKEST).all(axis=1)
        chosen.append(rng.permutation(np.flatnonzero(good))[:share] + rows.start)
    return np.concatenate(chosen)


def seen_entries(observed: Observations) -> np.ndarray:
    """(M * 6,) bool, cache entries that pixels see."""
    seen = np.zeros(len(observed.grid.voxels) * SIDES, bool)
    for rows in observed.hits():
        seen[observed.entry[rows]] = True
    return seen


def unseen_patches(grid: VoxelGrid, seen: np.ndarray, size: float) -> np.ndarray:
    """(M * 6,) int64 source of each cache entry, a side in a cube of unseen ones, from 0; -1 where it is seen.

    Args:
        seen: (M * 6,) bool. size: of the cubes, metres.
    """
    corner = np.stack(np.unravel_index(grid.voxels, (grid.resolution,) * 3), axis=1)
    side = np.tile(np.arange(SIDES), len(corner))
    around = numbered([*np.repeat(corner // UNSEEN, SIDES, axis=0).T, side])
    unseen = np.flatnonzero(np.bincount(around, seen)[around] == 0.0)
    cube = np.floor(corner * grid.size / size).astype(np.int64)
    result = np.full(len(seen), -1, np.int64)
    if len(unseen):
        result[unseen] = numbered([*cube[unseen // SIDES].T, unseen % SIDES])
    return result
