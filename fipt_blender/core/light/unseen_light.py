# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from what no photograph shows: through the openings of a mesh, and from its unseen surfaces.

Rays from points of the surfaces land on surfaces that photographs show, on others, or on the hull of the
mesh. Landing places of the last two kinds that are close together are one source; :mod:`.sources` finds its
radiance. It is kept only if points that were held back fit better with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..conventions import equirect_pixel_directions
from ..parts.components import graph_components
from ..pixels.grouped import numbered
from ..pixels.store import PixelStore
from ..run.stage_settings import LightSettings
from ..run.threads import cached_property
from ..surface.room import Room
from .cache import SIDES, VoxelGrid
from .clipped import MOST_POINTS, OUTSIDE, hemisphere_rays
from .environment import Environment, Hull, diffused, map_cells
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

RAYS, CHUNK = 1024, 256  # from each point; points at a time
# Width of sources in metres, and at most this share of the room's largest side, which has at most so many.
SIZE, SIZE_SHARE, MOST_CELLS = 0.5, 0.1, 32
# Voxels along each side of the cubes of which a side is unseen if no pixel sees it.
UNSEEN = 4
# Sources on which fewer of all rays land are left as they are, and at most so many are solved for.
LEAST_SHARE, MOST_SOURCES = 2e-5, 200
# Points of one surface whose colors differ by less, in logarithms of ratios, have one albedo.
COLOR_STEP = 0.25
LEAST_POINTS, LEAST_WEIGHT = 200, 0.5  # pixels that are compared, and the weight of each
GAIN = 3.0  # least logarithm of the likelihood of points held back
# Rays from a triangle to unseen places that are closer than a source is wide, and triangles that send them;
# others are like the nearest of these, and opposite normals count as twice so many metres.
CLOSE_RAYS, MOST_TRIANGLES, NORMAL_WEIGHT = 64, 20_000, 0.5
# A source is a lamp or a window if it is brighter than the room's median light by this factor.
LAMP = 4.0
BALL, MOST_OF_LAMP = 0.2, 16  # radius of the ball in its place, in widths of a source; sources of a lamp
DARK_OUTSIDE = 0.01  # least expected radiance outside, in units of the capture's median


def with_unseen_light(
    observed: Observations, room: Room, label: np.ndarray, settings: LightSettings
) -> Observations:
    """Observations whose environment has the light that nothing shows, if points held back confirm it.

    Args:
        label: (T,) int surface of each triangle, on which points of one color have one albedo.
    """
    found = find_sources(observed, room, label, settings.seed)
    if found is None or found.gain < GAIN:
        return observed
    environment = found.environment(observed.environment, settings.environment_width)
    unseen = close_share(observed, room, found, settings.seed)
    return replace(observed, environment=replace(environment, unseen=unseen))


@dataclass(frozen=True, eq=False)
class Sources:
    """K sources, and the N points that they light.

    Attributes:
        points: N of them, the pixels `where` (N,), with `position` and `normal` (N, 3).
        expected, light: what was expected of the sources, and what was found.
        gain: see :func:`.sources.held_back_gain`.
        entries: (E,) int64 cache entries of unseen surfaces, of_entry: (E,) their source.
        patch: (M * 6,) int64 as of :func:`unseen_patches`.
        hull: around the mesh, of_cell: (C,) source of each of its cells, -1 without.
        place, toward: (K, 3) mean place, metres, and mean unit direction of the rays that land there.
    """

    points: Transport
    where: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    expected: Expectation
    light: SourceLight
    gain: float
    entries: np.ndarray
    of_entry: np.ndarray
    patch: np.ndarray
    hull: Hull
    of_cell: np.ndarray
    place: np.ndarray
    toward: np.ndarray

    def environment(self, before: Environment | None, width: int) -> Environment:
        """What was observed outside, with the light of the sources; `width`: of a new map in pixels."""
        radiance = self.light.radiance.astype(np.float32)
        table = np.where((self.of_cell >= 0)[:, None], radiance[self.of_cell], -1.0).astype(np.float32)
        hull = replace(self.hull, radiance=table)
        if before is None:
            shape = (width // 2, width)
            before = Environment(np.zeros((*shape, 3), np.float32), 0.0, np.zeros(shape, bool))
        image, (height, width) = before.image.copy(), before.seen.shape
        ways = equirect_pixel_directions(width, height)
        middle = np.broadcast_to(0.5 * (hull.low + hull.high), ways.reshape(-1, 3).shape)
        # In a world, sources that are lamps of their own would shine twice, and from wrong places.
        far = np.where(np.append(self.lamp >= 0, False)[self.of_cell, None], DARK_OUTSIDE, table)
        near = far[hull.cells(middle, ways.reshape(-1, 3))].reshape(image.shape)
        inferred = ~before.seen & (near[..., 0] >= 0.0)
        image[inferred] = near[inferred]
        if inferred.any():  # from elsewhere, other directions lead there
            image = diffused(image, before.seen | inferred)
        return replace(
            before,
            image=image,
            unseen_light=float(self.light.share(self.points).mean()),
            hull=hull,
            entries=self.entries,
            radiance=radiance[self.of_entry],
            lamps=tuple(self.lamps()),
        )

    @cached_property
    def lamp(self) -> np.ndarray:
        """(K,) int64 lamp or window that each source belongs to; -1 for dim ones and wide openings."""
        level = LAMP * float(np.median(self.points.seen))
        members = np.flatnonzero(self.light.radiance.mean(axis=1) > level)
        result = np.full(len(self.place), -1, np.int64)
        if len(members):
            pairs = cKDTree(self.place[members]).query_pairs(1.5 * self.size, output_type="ndarray")
            lamp = graph_components(pairs, len(members))
            own = np.bincount(lamp) <= MOST_OF_LAMP
            result[members] = np.where(own, np.cumsum(own) - 1, -1)[lamp]
        return result

    @property
    def size(self) -> float:
        """Width of a source, metres."""
        return float((self.hull.high - self.hull.low).max() / self.hull.counts.max())

    def lamps(self) -> Iterator[dict[str, Any]]:
        """Balls that cast the light of bright sources, as lamps that the mesh lacks."""
        for index in range(int(self.lamp.max(initial=-1)) + 1):
            own = np.flatnonzero(self.lamp == index)
            cast = self.points.unseen[:, own] @ self.light.radiance[own]
            lit = cast.sum(axis=1) > 0.0
            weight = self.points.unseen[:, own].sum(axis=0) * self.light.radiance[own].mean(axis=1)
            place, way = (
                np.average(array[own], axis=0, weights=weight) for array in (self.place, self.toward)
            )
            radius = BALL * self.size
            center = place - radius * way / max(float(np.linalg.norm(way)), 1e-9)
            toward = center - self.position[lit]
            squared = np.maximum((toward**2).sum(axis=1), radius**2)
            cosine = np.maximum((toward * self.normal[lit]).sum(axis=1), 0.0) / np.sqrt(squared)
            # Irradiance over pi by a ball of radiance 1, where its light and that of the sources are alike.
            ball = radius**2 * cosine / squared
            fitted = ball @ cast[lit] / max(float(ball @ ball), 1e-12)
            yield {
                "position": center.tolist(),
                "radius": radius,
                "radiance": fitted.tolist(),
                "inferred": True,
            }


def find_sources(observed: Observations, room: Room, label: np.ndarray, seed: int) -> Sources | None:
    """The sources with their radiance; None where the photographs show all that lights the room."""
    pixels, grid = observed.pixels, observed.grid
    where, group = _comparable(pixels, label, np.random.default_rng([seed, 23]))
    if len(where) < LEAST_POINTS:
        return None
    lit = pixels.surface(room, where)
    longest = float((room.bounds[1] - room.bounds[0]).max())
    size = max(min(SIZE, SIZE_SHARE * longest), longest / MOST_CELLS)
    hull, patch = Hull.around(room.bounds, size), unseen_patches(grid, seen_entries(observed), size)
    patches = int(patch.max(initial=-1)) + 1
    rays = _traced(observed, room, hull, lit, np.where(patch >= 0, patch + len(hull.radiance), -1), seed)
    count = np.bincount(rays.source[rays.source >= 0], minlength=len(hull.radiance) + patches)
    chosen = np.argsort(-count, kind="stable")[:MOST_SOURCES]
    chosen = np.sort(chosen[count[chosen] > LEAST_SHARE * rays.source.size])
    if not len(chosen):
        return None
    number = np.full(len(count) + 1, -1, np.int64)  # the last is that of no source
    number[chosen] = np.arange(len(chosen))
    outside = chosen < len(hull.radiance)
    seen, unseen, mean, way = _transport(rays, observed, number, len(chosen))
    mean = np.where(outside[:, None], np.maximum(mean, np.log(DARK_OUTSIDE)), mean)
    points = Transport(np.log(np.asarray(pixels.own[where], np.float64)), group, seen, unseen)
    expected = Expectation(mean, outside)
    gain = held_back_gain(points, expected, np.random.default_rng([seed, 24]))
    way[0][outside] = hull.centers(chosen[outside])
    of_entry = number[np.where(patch >= 0, patch + len(hull.radiance), -1)]
    entries = np.flatnonzero(of_entry >= 0)
    return Sources(
        points=points,
        where=where,
        position=lit[0],
        normal=lit[1],
        expected=expected,
        light=solve_sources(points, expected),
        gain=gain,
        entries=entries,
        of_entry=of_entry[entries],
        patch=patch,
        hull=hull,
        of_cell=number[: len(hull.radiance)],
        place=way[0],
        toward=way[1],
    )


def close_share(observed: Observations, room: Room, found: Sources, seed: int) -> np.ndarray:
    """(T,) float32 share of the directions around each triangle in which unseen places are closer than a
    source is wide, on the side that pixels see; 0 on triangles that no pixel sees."""
    pixels, rng = observed.pixels, np.random.default_rng([seed, 25])
    side = np.zeros(len(room.triangles))
    for rows in observed.hits():
        side += np.bincount(pixels.triangle[rows], np.where(pixels.front[rows], 1.0, -1.0), len(side))
    seen = np.flatnonzero(side)
    result = np.zeros(len(side), np.float32)
    if not len(seen):
        return result
    centers = room.vertices[room.triangles[seen]].mean(axis=1)
    normals = room.normals[seen] * np.sign(side[seen])[:, None]
    chosen = np.sort(rng.permutation(len(seen))[:MOST_TRIANGLES])
    lit = centers[chosen], normals[chosen]
    patch = found.patch
    of_entry = np.where(patch >= 0, patch + len(found.hull.radiance), -1)
    rays = _traced(observed, room, found.hull, lit, of_entry, seed, CLOSE_RAYS)
    inside = (rays.entry >= 0)[..., None]
    cell = np.where(rays.entry < 0, np.maximum(rays.source, 0), 0)
    place = np.where(inside, _middles(observed.grid, rays.entry), found.hull.centers(cell))
    close = (rays.source >= 0) & (np.linalg.norm(place - lit[0][:, None], axis=2) < found.size)
    columns = [np.concatenate([a, NORMAL_WEIGHT * b], axis=1) for a, b in (lit, (centers, normals))]
    result[seen] = close.mean(axis=1)[cKDTree(columns[0]).query(columns[1])[1]]
    return result


def _middles(grid: VoxelGrid, entry: np.ndarray) -> np.ndarray:
    """(..., 3) middles of the voxels of cache entries, metres; of the first one for negative entries."""
    corner = np.stack(np.unravel_index(grid.voxels, (grid.resolution,) * 3), axis=1)
    return np.asarray(((corner + 0.5) * grid.size + grid.low)[np.maximum(entry, 0) // SIDES])


@dataclass(frozen=True, eq=False)
class _Rays:
    """Where R rays from each of N points land.

    Attributes:
        entry: (N, R) int32 cache entry, negative outside.
        source: (N, R) int32 cell of the hull or, after these, patch of unseen surfaces; -1 for others.
        direction: (N, R, 3) float32.
    """

    entry: np.ndarray
    source: np.ndarray
    direction: np.ndarray


def _traced(
    observed: Observations,
    room: Room,
    hull: Hull,
    lit: tuple[np.ndarray, np.ndarray],
    of_entry: np.ndarray,
    seed: int,
    count: int = RAYS,
) -> _Rays:
    """Rays from points.

    Args:
        lit: (N, 3) positions, metres, and (N, 3) normals.
        of_entry: (M * 6,) source of each cache entry, -1 where photographs show it.
    """
    nothing, environment, found = np.full(len(room.triangles), -1, np.int32), observed.environment, []
    for number, first in enumerate(range(0, len(lit[0]), CHUNK)):
        position, normal = (array[first : first + CHUNK] for array in lit)
        stream = seed * 1009 + number
        entry, direction = hemisphere_rays(room, observed.grid, position, normal, nothing, stream, count)
        source, outside = of_entry[np.maximum(entry, 0)], entry == OUTSIDE
        start = np.broadcast_to(position[:, None], direction.shape)
        source[outside] = hull.cells(start[outside], direction[outside])
        if environment is not None:
            pixel = map_cells(direction, environment.seen.shape[1])
            source[outside & environment.seen.reshape(-1)[pixel]] = -1
        found.append((entry, source.astype(np.int32), direction.astype(np.float32)))
    return _Rays(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _transport(
    rays: _Rays, observed: Observations, number: np.ndarray, sources: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """The light of points by what photographs show and by sources, and what is known of the sources.

    Args:
        number: of each source of the rays, from 0, -1 for those that are left as they are; the last is -1.

    Returns:
        (N, 3) and (N, K) as in :class:`.sources.Transport`; (K, 3) mean logarithm of the radiance that cache
        and environment have for the sources; (K, 3) where rays land on them, metres, and (K, 3) unit mean
        directions of these.
    """
    cache, environment, grid = observed.cache(), observed.environment, observed.grid
    seen, unseen, sums, count = [], [], np.zeros((9, sources)), np.zeros(sources)
    for first in range(0, len(rays.entry), CHUNK):
        entry, source, way = (
            array[first : first + CHUNK] for array in (rays.entry, rays.source, rays.direction)
        )
        light = np.where((entry >= 0)[..., None], cache[np.maximum(entry, 0)], 0.0)
        if environment is not None:
            pixel = map_cells(way, environment.seen.shape[1])
            light = np.where((entry >= 0)[..., None], light, environment.image.reshape(-1, 3)[pixel])
        of_ray = number[source]
        inside = of_ray >= 0
        seen.append(np.where(inside[..., None], 0.0, light).mean(axis=1))
        row = np.arange(len(entry))[:, None] * (sources + 1) + 1 + of_ray
        counts = np.bincount(row.ravel(), minlength=len(entry) * (sources + 1)).reshape(len(entry), -1)
        unseen.append(counts[:, 1:] / entry.shape[1])
        count += counts[:, 1:].sum(axis=0)
        values = [
            np.log(np.maximum(light[inside], DARKEST)),
            _middles(grid, entry[inside]),
            way[inside],
        ]
        columns = np.concatenate(values, axis=1).T
        sums += [np.bincount(of_ray[inside], column, sources) for column in columns]
    mean = (sums / np.maximum(count, 1.0)).T
    toward = mean[:, 6:] / np.maximum(np.linalg.norm(mean[:, 6:], axis=1, keepdims=True), 1e-9)
    return np.concatenate(seen), np.concatenate(unseen), mean[:, :3], (mean[:, 3:6], toward)


def _comparable(
    pixels: PixelStore, label: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int64 pixels of surfaces, from all views alike, and (N,) the groups of one albedo, from 0."""
    share = max(1, MOST_POINTS // max(len(pixels.views), 1))
    chosen = [np.zeros(0, np.int64)]
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        good = (np.asarray(pixels.triangle[rows]) >= 0) & np.asarray(pixels.pure[rows])
        good &= (np.asarray(pixels.weight[rows]) >= LEAST_WEIGHT) & (pixels.own[rows] > DARKEST).all(axis=1)
        chosen.append(rng.permutation(np.flatnonzero(good))[:share] + rows.start)
    where = np.concatenate(chosen)
    logs = np.log(np.asarray(pixels.own[where], np.float64))
    ratio = np.floor((logs[:, [0, 2]] - logs[:, [1]]) / COLOR_STEP).astype(np.int64)
    group = numbered([label[np.asarray(pixels.triangle[where])], *ratio.T])
    enough = np.bincount(group, minlength=1)[group] >= LEAST_GROUP
    return where[enough], np.unique(group[enough], return_inverse=True)[1].reshape(-1)


def seen_entries(observed: Observations) -> np.ndarray:
    """(M * 6,) bool, cache entries that pixels see."""
    seen = np.zeros(len(observed.grid.voxels) * SIDES, bool)
    for rows in observed.hits():
        seen[observed.entry[rows]] = True
    return seen


def unseen_patches(grid: VoxelGrid, seen: np.ndarray, size: float) -> np.ndarray:
    """(M * 6,) int64 source of each cache entry: a side in a cube of unseen ones; -1 where it is seen.

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
