"""Surfaces that are clipped in photographs that are not HDR, and the light on all other surfaces, from which
their radiance is inferred (:mod:`..light.clipped`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..light.cache import Pool, seen_grid
from ..light.clipped import MAX_LAMPS, MAX_POINTS, LampLight, LitPoints, light_on_points
from ..light.emitter_surfaces import PATCH, surface_patches
from ..parts.components import graph_components, mesh_components
from ..pixels.grouped import numbered
from ..pixels.store import NO_TRIANGLE
from ..radiometry.adjustment import usable
from ..radiometry.inversion import Radiometry, is_clipped
from ..run.stage_settings import PhotometrySettings
from ..surface.adjacency import weld
from ..surface.room import Room
from ..surface.scan import Scan
from .codes import Codes

# A triangle is a clipped surface if more than this share of its pixels is clipped.
MOSTLY = 0.5
# A lamp's radiance counts as undetermined from this standard deviation of its logarithm on.
VAGUE = 0.4


@dataclass(frozen=True, eq=False)
class ClippedSurfaces:
    """F surfaces most of whose pixels are clipped; the last one is what lies outside the mesh.

    Attributes:
        of_triangle: (T,) int32 surface of each triangle, -1 without.
        light: their radiance; None where too few points determine it.
        reflecting: (F,) bool, those whose radiance reflection alone explains.
        albedo: (F, 3) of these, in units of the pixels' radiance over that of `diffuse`.
        diffuse: (N, 3) L_d of all pixels; (0, 3) where none is known.
    """

    of_triangle: np.ndarray
    light: LampLight | None
    reflecting: np.ndarray
    albedo: np.ndarray
    diffuse: np.ndarray

    def on(self, triangle: np.ndarray) -> np.ndarray:
        """(n,) surface that pixels of these triangles (n,) see, -1 without."""
        seen = np.where(triangle >= 0, self.of_triangle[np.maximum(triangle, 0)], -1)
        return np.where(triangle == NO_TRIANGLE, len(self.reflecting) - 1, seen)

    @property
    def inferred(self) -> np.ndarray:
        """(F,) bool, surfaces whose clipped pixels get the radiance inferred from the light."""
        if self.light is None:
            return np.zeros(len(self.reflecting), bool)
        inferred = (self.light.deviation.max(axis=1) < VAGUE) & ~self.reflecting
        inferred[-1] = True
        return inferred

    def radiance(self, rows: slice, surface: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """(n, 3) radiance of clipped pixels.

        A surface whose light does not determine its radiance keeps the bound, as it may be a highlight or a
        white surface. What lies outside the mesh gets its inferred radiance in any case.

        Args:
            rows: of the pixels of their view. surface: (n,) of each pixel, -1 without. bound: (n, 3).
        """
        result = bound.copy()
        if self.light is None:
            return result
        lamp = (surface >= 0) & self.inferred[surface]
        result[lamp] = np.maximum(bound[lamp], np.exp(self.light.log_radiance[surface[lamp]]))
        lit = np.flatnonzero((surface >= 0) & self.reflecting[surface])
        if len(lit):
            reflected = self.diffuse[rows][lit].astype(np.float64) * self.albedo[surface[lit]]
            result[lit] = np.maximum(bound[lit], reflected)
        return result


def find_clipped_surfaces(room: Room, codes: Codes, label: np.ndarray, footprint: float) -> np.ndarray:
    """(T,) int32 clipped surface that each triangle belongs to, from 0; -1 without.

    A surface is connected triangles most of whose pixels are clipped; the largest `MAX_LAMPS` in the views.
    Triangles of a scan are smaller than pixels, many of them seen by none, and a lamp and the wall around it
    are one mesh. There, patches of one label take the place of triangles, and a surface has one label. A
    label most of whose pixels are clipped is one surface: bars in front of a lamp divide it, and the light of
    its pieces could not be separated.

    Args:
        label: (T,) int part or piece of each triangle.
        footprint: median width of a pixel on the surfaces, metres.
    """
    pixels = codes.pixels
    count, clipped = np.zeros((2, len(room.triangles)))
    for index in codes.encoded:
        rows = pixels.rows(index)
        triangle = np.asarray(pixels.triangle[rows])
        hit = triangle >= 0
        np.add.at(count, triangle[hit], 1.0)
        np.add.at(clipped, triangle[hit], is_clipped(codes.of_view(index))[hit].astype(np.float64))
    mostly = clipped > MOSTLY * count
    if room.scan is not None:
        mostly = _mostly(surface_patches(room.scan, label, PATCH * footprint), clipped, count)
    lamp = np.full(len(room.triangles), -1, np.int32)
    members = np.flatnonzero(mostly)
    if len(members):
        if room.scan is None:
            component = mesh_components(weld(room.vertices)[room.triangles][members])
        else:
            whole = _mostly(numbered([label]), clipped, count)
            component = _pieces_of_scan(room.scan, members, label, whole)
        order = np.argsort(-np.bincount(component, clipped[members]), kind="stable")[:MAX_LAMPS]
        rank = np.full(int(component.max()) + 1, -1, np.int32)
        rank[order] = np.arange(len(order))
        lamp[members] = rank[component]
    return lamp


def _mostly(group: np.ndarray, clipped: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(T,) bool, triangles of groups (T,) most of whose pixels `count` (T,) are `clipped` (T,)."""
    return np.asarray((np.bincount(group, clipped) > MOSTLY * np.bincount(group, count))[group])


def _pieces_of_scan(scan: Scan, members: np.ndarray, label: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """(n,) int64 piece, from 0, of each of the triangles `members` (n,).

    A piece is connected triangles of one label (T,). Where `whole` (T,) is true, it is all triangles of the
    label instead.
    """
    place = np.full(len(label), -1, np.int64)
    place[members] = np.arange(len(members))
    pairs = scan.mesh.dual_edges
    pairs = pairs[(place[pairs] >= 0).all(axis=1) & (label[pairs[:, 0]] == label[pairs[:, 1]])]
    component = graph_components(place[pairs], len(members))
    together = whole[members]
    return numbered([together, np.where(together, label[members], component)])


@dataclass(frozen=True, eq=False)
class Lit:
    """Points of the surfaces, and the light on them; the last lamp is what lies outside the mesh.

    Attributes:
        points: N of them. pixel: (N,) pixel of each. place: (N,) index of its view among those not HDR.
        cache: (E, 3) logarithm of the radiance of the cache's entries over the contrast.
        bound: (F, 3) logarithm over the contrast of the radiance at which each lamp is clipped.
    """

    points: LitPoints
    pixel: np.ndarray
    place: np.ndarray
    cache: np.ndarray
    bound: np.ndarray


def light_on_surfaces(
    room: Room,
    part: np.ndarray,
    lamp: np.ndarray,
    codes: Codes,
    radiometry: Radiometry,
    settings: PhotometrySettings,
) -> Lit:
    """Points of the surfaces with the light that reaches them, and the radiance of all cache entries."""
    pixels, encoded = codes.pixels, codes.encoded
    grid = seen_grid(pixels, room, settings.voxel_resolution, settings.seed)
    lamps = int(lamp.max(initial=-1)) + 1
    pooled, bound = Pool(grid, 3), np.full((lamps + 1, 3), -np.inf)
    rng = np.random.default_rng([settings.seed, 20])
    chosen, values = [], []
    for place, index in enumerate(encoded):
        rows = pixels.rows(index)
        code = codes.of_view(index)
        value = radiometry.values(place, code, codes.radius(index))
        triangle = np.asarray(pixels.triangle[rows])
        on = np.where(triangle >= 0, lamp[np.maximum(triangle, 0)], -1)
        on[triangle == NO_TRIANGLE] = lamps
        np.maximum.at(bound, on[on >= 0], value[on >= 0])
        good = usable(code)
        hit = np.flatnonzero((triangle >= 0) & (on < 0))
        # Clipped and mixed pixels matter only in entries that have no others.
        weight = np.where(good[hit].all(axis=1) & pixels.pure[rows][hit], 1.0, 1e-3)
        pooled.add(grid.entries(*pixels.surface(room, hit + rows.start)), value[hit], weight)
        able = hit[pixels.pure[rows][hit] & good[hit].any(axis=1) & (part[triangle[hit]] >= 0)]
        drawn = rng.permutation(able)[: max(1, MAX_POINTS // len(encoded))]
        chosen.append(drawn + rows.start)
        values.append(np.where(good[drawn], value[drawn], np.nan))
    where = np.concatenate(chosen)
    entry, direct = light_on_points(room, grid, pixels.surface(room, where), lamp, settings.seed)
    points = LitPoints(np.concatenate(values), part[pixels.triangle[where]], entry, direct)
    of_view = np.repeat(np.arange(len(encoded)), [len(rows) for rows in chosen])
    cache = pooled.filled()[0].astype(np.float64)
    return Lit(points, where, of_view, cache, np.where(np.isfinite(bound), bound, 0.0))
