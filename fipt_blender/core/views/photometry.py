# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns photographs that are not HDR into radiance: the radiometric adjustment on a capture's pixels.

The views are compared on surface cells (:mod:`.cells`). Codes become radiance with a weight for their errors;
triangles that are clipped in most pixels get the radiance that the light in the room tells (`light.clipped`).
Once shadings are baked, both are found once more with their light (:mod:`.refit`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from ..capture.encoded import srgb_encoded
from ..geometry.adjacency import weld
from ..light.cache import Pool, VoxelGrid, fill_grid, grid_frame
from ..light.clipped import (
    MOST_LAMPS,
    MOST_POINTS,
    Expectation,
    LampLight,
    LitPoints,
    light_on_points,
    solve_lamps,
)
from ..light.observations import median_footprint
from ..radiometry.adjustment import Samples, adjust, usable
from ..radiometry.contrast import Source, combined, exif_contrast, usual_contrast
from ..radiometry.inversion import (
    MUCH_CLIPPED,
    MUCH_UNEXPLAINED,
    Radiometry,
    is_clipped,
    reliability,
)
from ..radiometry.response import response_basis
from ..run.messages import Reporter
from ..run.settings import Settings
from ..scene.components import mesh_components
from ..scene.pixels import LEFT_OUT, NO_TRIANGLE, VIEW_LUMINANCES, PixelStore, open_array
from ..scene.room import Room, triangle_normals
from .cells import SurfaceCells, lattice_hits, surface_cells
from .exposure import exposure_gains

# Codes may differ by so much in the 3 x 3 pixels around one that is compared: edges would mix surfaces.
CALM_CODES = 24.0
# Approximate number of samples that are compared, one for each cell and view.
MOST_SAMPLES = 40_000
# Clusters, within which errors are alike, are cells of so many times the size.
CLUSTER = 8.0
# A triangle is a clipped surface if more than this share of its pixels is clipped.
MOSTLY = 0.5
# Systematic error of the contrast that light tells: by gloss, textures and the coarse cache.
LIGHT_DEVIATION = 0.06
# Standard deviation of the logarithm of a lamp's radiance from which on it is said to be vague.
VAGUE = 0.4
LEAST_POINTS = 200
UNKNOWN_CONTRAST = 1.0  # standard deviation of its logarithm where light alone shall tell it


@dataclass(frozen=True, eq=False)
class Photometry:
    """What was found of a capture's photographs.

    Attributes:
        scale: median luminance in the units of the radiance, by which the pixels are divided.
        weight: (N,) float32 information of each pixel's radiance; 1 for HDR photographs.
        facts: for statistics.json.
        found: what they were found from.
    """

    scale: float
    weight: np.ndarray
    facts: dict[str, Any]
    found: Found


@dataclass(frozen=True, eq=False)
class ClippedSurfaces:
    """Surfaces that are clipped in most pixels; F with what lies outside the mesh, which is the last.

    Attributes:
        of_triangle: (T,) int32 surface of each triangle, -1 without.
        light: their radiance; None where too few points tell it.
        reflecting: (F,) bool, those that the light on them can make as bright as they are.
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

    def radiance(self, rows: slice, surface: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """(n, 3) radiance of clipped pixels.

        A lamp whose light does not tell its radiance keeps the bound, as it may be a highlight or a white
        surface. What lies outside has an expected radiance in any case.

        Args:
            rows: of the pixels of their view. surface: (n,) of each pixel, -1 without. bound: (n, 3).
        """
        result = bound.copy()
        if self.light is None:
            return result
        told = (self.light.deviation.max(axis=1) < VAGUE) & ~self.reflecting
        told[-1] = True
        lamp = (surface >= 0) & told[surface]
        result[lamp] = np.maximum(bound[lamp], np.exp(self.light.log_radiance[surface[lamp]]))
        lit = np.flatnonzero((surface >= 0) & self.reflecting[surface])
        if len(lit):
            reflected = self.diffuse[rows][lit].astype(np.float64) * self.albedo[surface[lit]]
            result[lit] = np.maximum(bound[lit], reflected)
        return result


@dataclass(frozen=True, eq=False)
class Found:
    """What the second adjustment needs of the first.

    Attributes:
        codes: of the photographs.
        encoded: numbers of the views that are not HDR.
        radiometry: of these.
        clipped: surfaces.
        lit: points and the light on them.
    """

    codes: Codes
    encoded: list[int]
    radiometry: Radiometry
    clipped: ClippedSurfaces
    lit: Lit


def adjust_photographs(
    pixels: PixelStore, room: Room, part: np.ndarray, scale: float, settings: Settings, folder: Path
) -> Photometry:
    """Replace the values of photographs that are not HDR by radiance.

    The unit is the radiance that saturates the median view or, beside HDR photographs, theirs.

    Args:
        pixels: traced, and sorted into pure and mixed ones; `radiance` is changed in place.
        part: (T,) int part of each triangle, negative without.
        scale: by which the pixels' values were divided.
        folder: for memory-mapped arrays.
    """
    encoded = [index for index, view in enumerate(pixels.views) if view.encoded]
    codes, basis = Codes.of(pixels, scale, folder), response_basis()
    cells = surface_cells(pixels, room, part, median_footprint(pixels))
    adjustment = adjust(_samples(cells, codes, encoded), len(encoded), basis)
    exposures = np.array([pixels.views[index].exposure or np.nan for index in encoded])
    told = exif_contrast(adjustment.log_gains.mean(axis=1), exposures)
    sources = [usual_contrast(basis), *([told] if told else [])]
    radiometry = Radiometry(adjustment, combined(sources), tuple(sources))
    lamp = _clipped_surfaces(pixels, room, codes, encoded)
    lit = _light(pixels, room, part, lamp, codes, radiometry, settings)
    expected = Expectation.of(lit.bound, radiometry.contrast.value)
    radiometry, light = solve_light(radiometry, lit.points, lit.cache, expected, LIGHT_DEVIATION)
    lamps = len(lit.bound)
    clipped = ClippedSurfaces(
        lamp, light, np.zeros(lamps, bool), np.zeros((lamps, 3)), np.zeros((0, 3), np.float16)
    )
    return write_radiance(pixels, room, part, scale, Found(codes, encoded, radiometry, clipped, lit))


def solve_light(
    radiometry: Radiometry, points: LitPoints, cache: np.ndarray, expected: Expectation, error: float
) -> tuple[Radiometry, LampLight | None]:
    """The contrast with what light tells of it, and the lamps with this contrast; None with too few points.

    Args:
        error: systematic one of the contrast that light tells.
    """
    if np.isfinite(points.value).any(axis=1).sum() < LEAST_POINTS:
        return radiometry, None
    broad = radiometry.contrast.value, UNKNOWN_CONTRAST
    value, deviation = solve_lamps(points, cache, expected, broad).log_contrast
    sources = [source for source in radiometry.sources if source.name != "light"]
    sources.append(Source("light", value, float(np.hypot(deviation, error))))
    found = Radiometry(radiometry.adjustment, combined(sources), tuple(sources))
    return found, solve_lamps(points, cache, expected, (found.contrast.value, 0.0))


def write_radiance(
    pixels: PixelStore, room: Room, part: np.ndarray, scale: float, found: Found
) -> Photometry:
    """Write the radiance of all codes into the pixels; arguments as of :func:`adjust_photographs`."""
    encoded = found.encoded
    weight, share = _invert(pixels, scale, found)
    unit = _common_unit(pixels, encoded)
    if len(encoded) < len(pixels.views):
        _align(pixels, surface_cells(pixels, room, part, median_footprint(pixels)), encoded)
    middle = _median(pixels, range(len(pixels.views)))
    for index in range(len(pixels.views)):
        pixels.radiance[pixels.rows(index)] /= np.float32(middle)
    names = [pixels.views[index].name for index in encoded]
    facts = found.radiometry.facts(names, share)
    light = found.clipped.light
    facts["lamps"] = [] if light is None else _lamp_facts(light)
    return Photometry(unit * middle, weight, facts, found)


@dataclass(frozen=True, eq=False)
class Codes:
    """The codes of photographs.

    Attributes:
        pixels: of their views.
        stored: (N, 3) uint16 codes from 0 to 65535; memory-mapped.
    """

    pixels: PixelStore
    stored: np.ndarray

    @classmethod
    def of(cls, pixels: PixelStore, scale: float, folder: Path) -> Codes:
        """Those of pixels whose values are decoded by sRGB's curve, and divided by the scale."""
        stored = open_array(folder / "codes.npy", (len(pixels), 3), np.uint16, create=True)
        for index, view in enumerate(pixels.views):
            if view.encoded:
                rows = pixels.rows(index)
                values = srgb_encoded(np.asarray(pixels.radiance[rows], np.float64) * scale)
                stored[rows] = np.round(np.minimum(values, 1.0) * 65535.0)
        return cls(pixels, stored)

    def of_view(self, index: int) -> np.ndarray:
        """(n, 3) float64 codes from 0 to 255 of a view."""
        return self.stored[self.pixels.rows(index)] / 257.0

    def radius(self, index: int) -> np.ndarray:
        """(H * W,) distance of a view's pixels from its principal point, 1 in the farthest corner."""
        view = self.pixels.views[index]
        x = (np.arange(view.width) + 0.5 - view.cx)[None]
        y = (np.arange(view.height) + 0.5 - view.cy)[:, None]
        squared = (x**2 + y**2).ravel()
        return np.sqrt(squared / squared.max())


def _samples(cells: SurfaceCells, codes: Codes, encoded: Sequence[int]) -> Samples:
    """Mean codes of surface cells in each of the views `encoded`."""
    pixels = codes.pixels
    # Cells are thinned out rather than pixels, so that each keeps all views that share it.
    step = max(1, cells.pixel_count // (2 * MOST_SAMPLES))
    coarse = replace(cells.grid, size=CLUSTER * cells.grid.size)
    columns: list[tuple[np.ndarray, ...]] = []
    for place, index in enumerate(encoded):
        rows, view = pixels.rows(index), pixels.views[index]
        every = codes.of_view(index)
        image = every.reshape(view.height, view.width, 3)
        spread = maximum_filter(image, (3, 3, 1)) - minimum_filter(image, (3, 3, 1))
        chosen = lattice_hits(pixels, index)
        chosen = chosen[(spread.max(axis=-1).ravel() <= CALM_CODES)[chosen - rows.start]]
        cell = np.searchsorted(cells.keys, cells.grid.keys(pixels, chosen))
        chosen, cell = chosen[cell % step == 0], cell[cell % step == 0]
        point, first, group = np.unique(cell, return_index=True, return_inverse=True)
        group, count = group.reshape(-1), np.bincount(group.reshape(-1), minlength=len(point))
        inside = chosen - rows.start
        means = [np.bincount(group, every[inside, channel], len(point)) / count for channel in range(3)]
        radius = np.bincount(group, codes.radius(index)[inside], len(point)) / count
        cluster = coarse.keys(pixels, chosen[first])
        columns.append((point, cluster, np.full(len(point), place), radius, np.stack(means, axis=1)))
    point, cluster, view_number, radius, means_of = (np.concatenate(c) for c in zip(*columns, strict=True))
    point, cluster = (np.unique(keys, return_inverse=True)[1].reshape(-1) for keys in (point, cluster))
    return Samples(point, cluster, view_number, radius, means_of)


def _clipped_surfaces(pixels: PixelStore, room: Room, codes: Codes, encoded: Sequence[int]) -> np.ndarray:
    """(T,) int32 clipped surface that each triangle belongs to, from 0; -1 without.

    A surface is connected triangles most of whose pixels are clipped; the largest `MOST_LAMPS` in the views.
    """
    count, clipped = np.zeros((2, len(room.triangles)))
    for index in encoded:
        rows = pixels.rows(index)
        triangle = np.asarray(pixels.triangle[rows])
        hit = triangle >= 0
        np.add.at(count, triangle[hit], 1.0)
        np.add.at(clipped, triangle[hit], is_clipped(codes.of_view(index))[hit].astype(np.float64))
    lamp = np.full(len(room.triangles), -1, np.int32)
    members = np.flatnonzero(clipped > MOSTLY * count)
    if len(members):
        component = mesh_components(weld(room.vertices)[room.triangles][members])
        order = np.argsort(-np.bincount(component, clipped[members]), kind="stable")[:MOST_LAMPS]
        rank = np.full(int(component.max()) + 1, -1, np.int32)
        rank[order] = np.arange(len(order))
        lamp[members] = rank[component]
    return lamp


@dataclass(frozen=True, eq=False)
class Lit:
    """Points of the surfaces, and the light on them; the last lamp is what lies outside the mesh.

    Attributes:
        points: N of them. pixel: (N,) each one's pixel. place: (N,) number of its view among those not HDR.
        cache: (E, 3) logarithm of the radiance of the cache's entries over the contrast.
        bound: (F, 3) logarithm over the contrast of the radiance at which each lamp is clipped.
    """

    points: LitPoints
    pixel: np.ndarray
    place: np.ndarray
    cache: np.ndarray
    bound: np.ndarray


def _light(
    pixels: PixelStore,
    room: Room,
    part: np.ndarray,
    lamp: np.ndarray,
    codes: Codes,
    radiometry: Radiometry,
    settings: Settings,
) -> Lit:
    """Points of the surfaces with the light that reaches them, and the radiance of all cache entries."""
    encoded = [index for index, view in enumerate(pixels.views) if view.encoded]
    normals = triangle_normals(room.vertices, room.triangles).astype(np.float32)

    def surface(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        side = np.where(pixels.front[rows], np.float32(1.0), np.float32(-1.0))
        return np.asarray(pixels.position[rows]), normals[pixels.triangle[rows]] * side[:, None]

    grid = _grid(pixels, room, surface, settings)
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
        # Bounds count where there is nothing else.
        weight = np.where(good[hit].all(axis=1) & pixels.pure[rows][hit], 1.0, 1e-3)
        pooled.add(grid.entries(*surface(hit + rows.start)), value[hit], weight)
        able = hit[pixels.pure[rows][hit] & good[hit].any(axis=1) & (part[triangle[hit]] >= 0)]
        drawn = rng.permutation(able)[: max(1, MOST_POINTS // len(encoded))]
        chosen.append(drawn + rows.start)
        values.append(np.where(good[drawn], value[drawn], np.nan))
    where = np.concatenate(chosen)
    entry, direct = light_on_points(room, grid, surface(where), lamp, settings.seed)
    points = LitPoints(np.concatenate(values), part[pixels.triangle[where]], entry, direct)
    of_view = np.repeat(np.arange(len(encoded)), [len(rows) for rows in chosen])
    cache = pooled.filled()[0].astype(np.float64)
    return Lit(points, where, of_view, cache, np.where(np.isfinite(bound), bound, 0.0))


def _grid(
    pixels: PixelStore,
    room: Room,
    surface: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    settings: Settings,
) -> VoxelGrid:
    frame = grid_frame(room, settings.voxel_resolution)
    marked = np.zeros(settings.voxel_resolution**3, bool)
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        marked[frame.flat_index(*surface(np.flatnonzero(pixels.triangle[rows] >= 0) + rows.start))] = True
    return fill_grid(room, frame, np.flatnonzero(marked), np.random.default_rng([settings.seed, 1]))


def _invert(pixels: PixelStore, scale: float, found: Found) -> tuple[np.ndarray, np.ndarray]:
    """Write radiance into the pixels; return their weights (N,) and the share of clipped pixels of each view
    that is not HDR."""
    weight = np.ones(len(pixels), np.float32)
    shares: list[float] = []
    codes, radiometry = found.codes, found.radiometry
    for index, view in enumerate(pixels.views):
        rows = pixels.rows(index)
        if not view.encoded:
            pixels.radiance[rows] *= np.float32(scale)
            continue
        code, triangle = codes.of_view(index), np.asarray(pixels.triangle[rows])
        clipped = is_clipped(code)
        values = radiometry.values(len(shares), code, codes.radius(index))
        radiance = np.exp(values * radiometry.factor)
        known = reliability(radiometry.errors(code))
        surface = np.where(clipped, found.clipped.on(triangle), -1)
        radiance = found.clipped.radiance(rows, surface, radiance)
        if found.clipped.light is not None:
            known[surface >= 0] = 1.0
        pixels.radiance[rows], weight[rows] = radiance, known
        seen = triangle != LEFT_OUT
        shares.append(float(clipped[seen].mean()) if seen.any() else 0.0)
    return weight, np.array(shares)


def _median(pixels: PixelStore, views: Iterable[int]) -> float:
    """Median luminance of some views' pixels that are not black; 1 without any."""
    values = []
    for index in views:
        rows = pixels.rows(index)
        step = max(1, (rows.stop - rows.start) // VIEW_LUMINANCES)
        values.append(np.asarray(pixels.radiance[rows][::step]).mean(axis=1))
    positive = np.concatenate([*values, np.zeros(0)])
    positive = positive[positive > 0.0]
    return float(np.median(positive)) if len(positive) else 1.0


def _common_unit(pixels: PixelStore, encoded: Sequence[int]) -> float:
    """Divide both kinds of photographs by their medians; returns that of HDR ones, if there are any."""
    kinds = [list(encoded), [index for index in range(len(pixels.views)) if index not in set(encoded)]]
    unit = 1.0
    for kind in kinds:
        if kind:
            unit = _median(pixels, kind)
            for index in kind:
                pixels.radiance[pixels.rows(index)] /= np.float32(unit)
    return unit


def _align(pixels: PixelStore, cells: SurfaceCells, encoded: Sequence[int]) -> None:
    """Bring photographs that are not HDR to the exposure of those that are."""
    gains = np.log(exposure_gains(cells))
    among = np.isin(np.arange(len(gains)), encoded)
    factor = float(np.exp(np.median(gains[among]) - np.median(gains[~among])))
    for index in encoded:
        pixels.radiance[pixels.rows(index)] /= np.float32(factor)


def _lamp_facts(found: LampLight) -> list[dict[str, Any]]:
    """Radiance of each clipped surface and the standard deviation of its logarithm; the last is outside."""
    return [
        {
            "radiance": [round(float(x), 3) for x in np.exp(value)],
            "deviation": [round(float(x), 3) for x in error],
        }
        for value, error in zip(found.log_radiance, found.deviation, strict=True)
    ]


def warn_of_photographs(facts: dict[str, Any], reporter: Reporter) -> None:
    """Say which photographs, and which lamps, the estimate can rely on less.

    The warnings are ``view-clipped``, ``view-unexplained`` and ``lamps-clipped``.
    """
    views = facts["views"]
    much = [name for name, view in views.items() if view["clipped"] > MUCH_CLIPPED]
    if much:
        share = max(views[name]["clipped"] for name in much)
        reporter.warning(
            "view-clipped",
            f"{len(much)} of {len(views)} photographs are over-exposed, {much[0]} for example: up to"
            f" {100.0 * share:.0f} % of their pixels are clipped.",
            "Take photographs with shorter exposures of these places, or brackets.",
        )
    strange = [name for name, view in views.items() if view["unexplained"] > MUCH_UNEXPLAINED]
    if strange:
        reporter.warning(
            "view-unexplained",
            f"No response explains how bright {len(strange)} of {len(views)} photographs are, {strange[0]}"
            " for example. The camera may have brightened parts of the picture (HDR mode, tone mapping).",
            "Switch such functions off, or use the camera's RAW files.",
        )
    lamps = facts["lamps"][:-1]
    vague = sum(max(lamp["deviation"]) > VAGUE for lamp in lamps)
    if lamps:
        reporter.warning(
            "lamps-clipped",
            f"{len(lamps)} bright surfaces are clipped in the photographs. Their radiance is found from the"
            f" light that they cast, of {vague} of them only roughly.",
            "Check the radiance of these lamps in the section Lights.",
        )
