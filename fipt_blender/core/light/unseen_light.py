"""Light from what no photograph shows: through the openings of a mesh, and from its unseen surfaces.

Rays from points of the surfaces land on surfaces that photographs show, on others, or on the hull of the
mesh. Landing places of the last two kinds that are close together are one source; :mod:`.sources` finds its
radiance. Sources that cast much of the light are divided, and solved for again. The light is kept only if
points that were held back fit better with it. The light of presumed lamps is sampled towards them: few rays
would hit a bulb, and the light of the others would be explained by sources beside it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..conventions import equirect_pixel_directions
from ..optics.lights import AreaLights, EmitterTable
from ..parts.components import graph_components
from ..pixels.grouped import numbered
from ..pixels.store import PixelStore
from ..run.result_contents import MissingLamp
from ..run.stage_settings import LightSettings
from ..run.threads import cached_property
from ..surface.room import Room
from .cache import SIDES, SurfaceLookup, VoxelGrid
from .clipped import MAX_POINTS, OUTSIDE
from .environment import Environment, diffused
from .observations import Observations
from .radiance import CachedRadiance
from .shadings import SampleCounts, ShadingPoints, bake
from .source_cells import DARK_OUTSIDE, FINER, Cells, Landed, middles, traced
from .sources import (
    DARKEST,
    MIN_GROUP,
    Expectation,
    SourceLight,
    Transport,
    held_back_gain,
    solve_sources,
)

# Sources on which fewer of all rays land are left as they are, and at most so many are solved for.
MIN_SHARE, MAX_SOURCES = 2e-5, 200
# Points of one surface whose colors differ by less, in logarithms of ratios, have one albedo.
COLOR_STEP = 0.25
MIN_POINTS, MIN_WEIGHT = 200, 0.5  # pixels that are compared, and the weight of each
KNOWN_POINTS = 4  # one of so many pixels is added of surfaces of known albedo, where there are some
LAMP_SAMPLES = SampleCounts(16, 0, 64)  # of the light of presumed lamps at each
# Relative error of the inferred part of the light beside its covariance: root mean square of five rooms.
MODEL_ERROR = 0.3
GAIN = 3.0  # least gain of points held back, and share of the light, in their standard errors
# Rays to unseen places closer than a source is wide, and pixels that send them.
CLOSE_RAYS, MAX_CLOSE = 64, 20_000
# A source is a lamp or a window if it is brighter by this factor than the room's median light and what is
# around it.
LAMP = 4.0
# Sources of one side are one lamp if they are closer than so many of their widths; others, of a whole one.
APART, CLOSE = 1.5, 0.5
MIN_LAMP = 0.005  # share of the light that a lamp casts
BALL = 0.2  # least radius of a lamp in widths of a whole source
# Where photographs looked past it, in widths of a whole source; places that are tried.
MIN_RADIUS, MAX_PLACES = 0.04, 16
WIDEST = 2.0  # radius of a disc in widths of a whole source; what is wider is divided
FLAT = 0.7  # it is a disc if more than this share of its light leaves to one side
# Of discs from the surface that shines or, outwards, from the hull, in widths of a source.
CLEARANCE = 0.1
MAX_LOOKS = 100_000  # rays of pixels on which no lamp may lie


def with_unseen_light(
    observed: Observations,
    room: Room,
    label: np.ndarray,
    lamps: EmitterTable,
    settings: LightSettings,
    base_color: np.ndarray | None = None,
) -> Observations:
    """Observations whose environment has the light that nothing shows, if points held back confirm it.

    Args:
        label: (T,) int surface of each triangle, on which points of one color have one albedo.
        lamps: presumed ones. base_color: (T, 3) of triangles of which it is known, else NaN; None: of none.
    """
    found = find_sources(observed, room, label, lamps, settings.seed, base_color)
    if found is None:
        return observed
    environment = found.environment(observed.environment, settings.environment_width)
    unseen = close_share(observed, room, found, lamps, settings.seed)
    return replace(observed, environment=replace(environment, unseen=unseen))


@dataclass(frozen=True, eq=False)
class Sources:
    """K sources, and the N points that they light.

    Attributes:
        points: N of them, with `position` and `normal` (N, 3), and `pixel`: (N,) int64 that shows each.
        expected, light: what was expected of the sources, and what was found.
        entries: (E,) int64 cache entries of unseen surfaces, of_entry: (E,) their source.
        cells: F that the sources consist of. of_cell: (F,) source of each, -1 without.
        reflected: (K, 3) radiance that the cache has of each, as of surfaces around it; 0 on the hull.
        place, toward: (K, 3) mean place, metres, and mean unit direction of the rays that land there.
        width: (K,) metres. side: (K,) to which each shines, as of cache entries.
        looks: (S, 3) cameras and (S, 3) what pixels of theirs see: there is nothing between them.
    """

    points: Transport
    pixel: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    expected: Expectation
    light: SourceLight
    entries: np.ndarray
    of_entry: np.ndarray
    cells: Cells
    of_cell: np.ndarray
    reflected: np.ndarray
    place: np.ndarray
    toward: np.ndarray
    width: np.ndarray
    side: np.ndarray
    looks: tuple[np.ndarray, np.ndarray]

    def environment(self, before: Environment | None, width: int) -> Environment:
        """What was observed outside, with the light of the sources; `width`: of a new map in pixels."""
        radiance = self.light.radiance.astype(np.float32)
        of_hull = self.of_cell[: len(self.cells.hull.radiance)]
        table = np.where((of_hull >= 0)[:, None], radiance[of_hull], -1.0).astype(np.float32)
        hull = replace(self.cells.hull, radiance=table)
        if before is None:
            shape = (width // 2, width)
            before = Environment(np.zeros((*shape, 3), np.float32), 0.0, np.zeros(shape, bool))
        image, (height, width) = before.image.copy(), before.seen.shape
        ways = equirect_pixel_directions(width, height)
        middle = np.broadcast_to(0.5 * (hull.low + hull.high), ways.reshape(-1, 3).shape)
        # In a world, sources that are lamps of their own would shine twice, and from wrong places.
        far = np.where(np.append(self.lamp >= 0, False)[of_hull, None], DARK_OUTSIDE, table)
        near = far[hull.cells(middle, ways.reshape(-1, 3))].reshape(image.shape)
        inferred = ~before.seen & (near[..., 0] >= 0.0)
        image[inferred] = near[inferred]
        if inferred.any():  # from elsewhere, other directions lead there
            image = diffused(image, before.seen | inferred)
        share = float(self.shares.sum())
        return replace(
            before,
            image=image,
            unseen_light=share,
            unseen_error=float(np.hypot(self.light.error(self.points).mean(), MODEL_ERROR * share)),
            hull=hull,
            entries=self.entries,
            radiance=radiance[self.of_entry],
            lamps=tuple(self.lamps()),
            pixels=self.pixel,
            light=np.asarray(self.points.seen + self.points.unseen @ self.light.radiance, np.float32),
        )

    @cached_property
    def shares(self) -> np.ndarray:
        """(K,) mean share of the light on the points that each source casts."""
        return np.asarray(self.light.shares(self.points).mean(axis=0))

    @cached_property
    def lamp(self) -> np.ndarray:
        """(K,) int64 lamp or window that each source belongs to; -1 for dim ones.

        Openings are lamps however wide they are: in the world's image, what shines through them would be far
        away, and its light would not fall off in the room. Unseen surfaces that are as bright as those around
        them reflect: in Blender they do that by themselves.
        """
        level = LAMP * np.maximum(float(np.median(self.points.seen)), self.reflected.mean(axis=1))
        members = np.flatnonzero(self.light.radiance.mean(axis=1) > level)
        result = np.full(len(self.place), -1, np.int64)
        if not len(members):
            return result
        place, width, side = self.place[members], self.width[members], self.side[members]
        one, other = cKDTree(place).query_pairs(APART * self.cells.size, output_type="ndarray").T
        distance = np.linalg.norm(place[one] - place[other], axis=1)
        near = distance < APART * np.maximum(width[one], width[other])
        near &= (side[one] == side[other]) | (distance < CLOSE * self.cells.size)
        lamp = graph_components(np.stack([one, other], axis=1)[near], len(members))
        own = np.bincount(lamp, self.shares[members]) > MIN_LAMP
        result[members] = np.where(own, np.cumsum(own) - 1, -1)[lamp]
        return result

    def lamps(self) -> Iterator[MissingLamp]:
        """Discs and balls that cast the light of bright sources, as lamps that the mesh lacks.

        What shines to one side is a disc as wide as its sources are spread, or several; others are balls.
        They are as small as what photographs looked through demands. If that is less than MIN_RADIUS, they
        move to one of their sources, or there is none: a lamp where cameras look would be in the picture.
        """
        clusters = [np.flatnonzero(self.lamp == index) for index in range(int(self.lamp.max(initial=-1)) + 1)]
        while clusters:
            own = clusters.pop()
            weight = self.points.unseen[:, own].sum(axis=0) * self.light.radiance[own].mean(axis=1)
            place = np.average(self.place[own], axis=0, weights=weight)
            inwards = -1.0 if self.expected.outside[own].any() else 1.0
            of_side = np.bincount(self.side[own], weight, SIDES)
            if of_side.max() <= FLAT * of_side.sum():
                way, radius = np.average(self.toward[own], axis=0, weights=weight), BALL * self.cells.size
                center = place - inwards * radius * way / max(float(np.linalg.norm(way)), 1e-9)
                yield from self._fitted(own, center, radius, None)
                continue
            facing = np.eye(3)[of_side.argmax() // 2] * (1.0 - 2.0 * (of_side.argmax() % 2))
            radius, beyond = self._spread(own, place, facing)
            if radius > WIDEST * self.cells.size and beyond.any() and not beyond.all():
                clusters += [own[beyond], own[~beyond]]
            else:
                center = place + inwards * CLEARANCE * self.cells.size * facing
                yield from self._fitted(own, center, radius, facing)

    def _spread(self, own: np.ndarray, place: np.ndarray, facing: np.ndarray) -> tuple[float, np.ndarray]:
        """Radius of a disc around a place (3,) that is as wide as sources (n,), metres, and which of these
        are beyond its middle along the longest way over it."""
        off = self.place[own] - place
        off -= (off @ facing)[:, None] * facing
        power = self.light.radiance[own].mean(axis=1) * self.width[own] ** 2
        square = (off**2).sum(axis=1) + self.width[own] ** 2 / 6.0  # of a square around its middle
        radius = float(np.sqrt(2.0 * np.average(square, weights=power)))
        along = np.linalg.svd(off * np.sqrt(power)[:, None], full_matrices=False)[2][0]
        return max(radius, BALL * self.cells.size), off @ along > 0.0

    def _fitted(
        self, own: np.ndarray, middle: np.ndarray, radius: float, facing: np.ndarray | None
    ) -> Iterator[MissingLamp]:
        """The lamp of a place and at most a radius, metres, that casts about the light of sources (n,)."""
        brightest = own[np.argsort(-self.shares[own], kind="stable")[:MAX_PLACES]]
        for center in (middle, *self.place[brightest]):
            free = free_radius(center, facing, *self.looks)
            if free >= MIN_RADIUS * self.cells.size:
                break
        else:
            return
        radius = min(radius, free)
        cast = self.points.unseen[:, own] @ self.light.radiance[own]
        lit = cast.sum(axis=1) > 0.0
        toward = center - self.position[lit]
        squared = np.maximum((toward**2).sum(axis=1), radius**2)
        cosine = np.maximum((toward * self.normal[lit]).sum(axis=1), 0.0) / np.sqrt(squared)
        # Irradiance over pi by a lamp of radiance 1, where its light and that of the sources are alike.
        unit = radius**2 * cosine / squared
        if facing is not None:
            unit *= np.maximum(-toward @ facing, 0.0) * np.sqrt(squared) / (squared + radius**2)
        fitted = unit @ cast[lit] / max(float(unit @ unit), 1e-12)
        toward = None if facing is None else facing.tolist()
        share = float(self.shares[own].sum())
        yield MissingLamp(center.tolist(), radius, fitted.tolist(), True, toward, share)


def find_sources(
    observed: Observations,
    room: Room,
    label: np.ndarray,
    lamps: EmitterTable,
    seed: int,
    base_color: np.ndarray | None = None,
) -> Sources | None:
    """The sources with their radiance; None where the photographs show all that lights the room, as far as
    points that are held back, and standard errors, tell. Arguments as of :func:`with_unseen_light`."""
    pixels = observed.pixels
    if base_color is None:
        base_color = np.full((len(room.triangles), 3), np.nan)
    known, shines = np.isfinite(base_color[:, 0]), np.isin(np.arange(len(room.triangles)), lamps.triangles)
    where, group = _comparable(pixels, label, known, shines, np.random.default_rng([seed, 23]))
    if len(where) < MIN_POINTS:
        return None
    lit = pixels.surface(room, where)
    cells = Cells.of(observed, room)
    rays = traced(observed, room, cells, shines, lit, seed)
    source = cells.sources(FINER)
    count = np.bincount(source[rays.cell[rays.cell >= 0]], minlength=int(source.max(initial=-1)) + 1)
    chosen = np.argsort(-count, kind="stable")[:MAX_SOURCES]
    chosen = np.sort(chosen[count[chosen] > MIN_SHARE * rays.cell.size])
    if not len(chosen):
        return None
    number = np.full(len(count), -1, np.int64)
    number[chosen] = np.arange(len(chosen))
    landed = Landed.of(rays, observed, shines, cells, number[source])
    landed = replace(landed, seen=landed.seen + lamp_light(room, observed.grid, lamps, lit, seed))
    logs = np.log(np.asarray(pixels.own[where], np.float64))
    albedo = np.empty((int(group.max()) + 1, 3))
    albedo[group] = base_color[np.asarray(pixels.triangle[where])]
    points, expected = landed.transport(logs, group, albedo), landed.expectation(cells)
    block = numbered([*np.floor(lit[0] / cells.size).astype(np.int64).T])
    if held_back_gain(points, expected, block, np.random.default_rng([seed, 24])) < GAIN:
        return None
    light, width = solve_sources(points, expected), np.full(len(chosen), FINER)
    if light.shares(points).sum(axis=1).mean() < GAIN * light.error(points).mean():
        return None
    while (finer := landed.divided(cells, points, expected, light, width)) is not None:
        landed, expected, width = finer
        points = landed.transport(logs, group, albedo)
        light = solve_sources(points, expected)
    of_entry = np.append(landed.source, -1)[cells.of_entry]
    entries = np.flatnonzero(of_entry >= 0)
    means, shown = landed.means(), pixels.some_hits(MAX_LOOKS)
    own, side = np.flatnonzero(landed.source >= 0), np.zeros(len(width), np.int64)
    side[landed.source[own]] = cells.side[own]
    return Sources(
        points=points,
        pixel=where,
        position=lit[0],
        normal=lit[1],
        expected=expected,
        light=light,
        entries=entries,
        of_entry=of_entry[entries],
        cells=cells,
        of_cell=landed.source,
        reflected=np.where(expected.outside[:, None], 0.0, np.exp(means[:, :3])),
        place=means[:, 3:6],
        toward=means[:, 6:] / np.maximum(np.linalg.norm(means[:, 6:], axis=1, keepdims=True), 1e-9),
        width=width * cells.size / FINER,
        side=side,
        looks=(pixels.camera_positions()[pixels.view_of(shown)], np.asarray(pixels.position[shown])),
    )


def free_radius(center: np.ndarray, facing: np.ndarray | None, camera: np.ndarray, seen: np.ndarray) -> float:
    """Largest radius, metres, of a disc or ball that no ray from cameras (S, 3) to what they see (S, 3)
    meets.

    Args:
        center: (3,) metres. facing: (3,) unit normal of a disc; None: a ball.
    """
    way, start = (seen - camera).astype(np.float64), center - camera
    if facing is None:
        along = np.clip((start * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12), 0.0, 1.0)
    else:
        slope = way @ facing
        along = (start @ facing) / np.where(np.abs(slope) < 1e-9, 1e-9, slope)
    squared = ((along[:, None] * way - start) ** 2).sum(axis=1)
    return float(np.sqrt(squared[(along >= 0.0) & (along <= 1.0)].min(initial=np.inf)))


def lamp_light(
    room: Room, grid: VoxelGrid, lamps: EmitterTable, lit: tuple[np.ndarray, np.ndarray], seed: int
) -> np.ndarray:
    """(N, 3) irradiance over pi at points by lamps alone; `lit`: as of :func:`.source_cells.traced`."""
    lights = AreaLights(room.vertices, room.triangles, lamps)
    if not lights.count:
        return np.zeros_like(lit[0])
    dark = SurfaceLookup(grid, np.zeros((len(grid.voxels) * SIDES, 3), np.float32))
    position, normal = (np.asarray(array, np.float32) for array in lit)
    points, source = ShadingPoints(position, normal, normal, normal), CachedRadiance(room, dark, None, lights)
    return bake(points, source, lights, np.zeros(0, np.float32), LAMP_SAMPLES, seed * 31 + 26).diffuse


def close_share(
    observed: Observations, room: Room, found: Sources, lamps: EmitterTable, seed: int
) -> np.ndarray:
    """(T,) float32 share of the directions around each triangle, or the nearest that pixels see, in which
    unseen lamps are closer than a source is wide."""
    rows = observed.pixels.some_hits(MAX_CLOSE)
    shines = np.isin(np.arange(len(room.triangles)), lamps.triangles)
    lit = observed.pixels.surface(room, rows)
    rays = traced(observed, room, found.cells, shines, lit, seed, CLOSE_RAYS)
    place = found.cells.hull.centers(np.where(rays.entry == OUTSIDE, np.maximum(rays.cell, 0), 0))
    place = np.where((rays.entry >= 0)[..., None], middles(observed.grid, rays.entry), place)
    of_lamp = np.append(found.lamp >= 0, False)[np.append(found.of_cell, -1)]
    close = of_lamp[rays.cell] & (np.linalg.norm(place - lit[0][:, None], axis=2) < found.cells.size)
    centers = room.vertices[room.triangles].mean(axis=1)
    nearest = cKDTree(centers[np.asarray(observed.pixels.triangle[rows])]).query(centers)[1]
    return close.mean(axis=1, dtype=np.float32)[nearest]


def _comparable(
    pixels: PixelStore, label: np.ndarray, known: np.ndarray, lamps: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int64 pixels of surfaces, from all views alike, and (N,) the groups of one albedo, from 0.

    Args:
        known: (T,) bool, triangles whose albedo is known: however small they are, they are compared.
        lamps: (T,) bool, presumed ones, whose own radiance no other light has to explain.
    """
    share = max(1, MAX_POINTS // max(len(pixels.views), 1))
    chosen = [np.zeros(0, np.int64)]
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        triangle = np.asarray(pixels.triangle[rows])
        good = (triangle >= 0) & ~lamps[triangle] & np.asarray(pixels.pure[rows])
        good &= (np.asarray(pixels.weight[rows]) >= MIN_WEIGHT) & (pixels.own[rows] > DARKEST).all(axis=1)
        some = rng.permutation(np.flatnonzero(good))
        given = some[known[triangle[some]]]
        some = np.concatenate([some[:share], given[: share // KNOWN_POINTS]])
        chosen.append(np.unique(some) + rows.start if len(given) else some + rows.start)
    where = np.concatenate(chosen)
    logs = np.log(np.asarray(pixels.own[where], np.float64))
    ratio = np.floor((logs[:, [0, 2]] - logs[:, [1]]) / COLOR_STEP).astype(np.int64)
    triangle = np.asarray(pixels.triangle[where])
    group = numbered([label[triangle], known[triangle], *ratio.T])
    enough = np.bincount(group, minlength=1)[group] >= MIN_GROUP
    return where[enough], np.unique(group[enough], return_inverse=True)[1].reshape(-1)
