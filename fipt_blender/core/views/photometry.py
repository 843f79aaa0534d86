# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns photographs that are not HDR into radiance: the radiometric adjustment on a capture's pixels.

The views are compared on surface cells (:mod:`.cells`). Codes become radiance with a weight for their errors;
triangles that are clipped in most pixels get the radiance that the light in the room tells (`light.clipped`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from ..capture.encoded import srgb_encoded
from ..geometry.adjacency import weld
from ..light.cache import Pool, VoxelGrid, fill_grid, grid_frame
from ..light.clipped import MOST_LAMPS, MOST_POINTS, LampLight, LitPoints, light_on_points, solve_lamps
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
from ..scene.pixels import LEFT_OUT, NO_TRIANGLE, VIEW_LUMINANCES, PixelStore
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
_LEAST_POINTS = 200
_UNKNOWN_CONTRAST = 1.0  # standard deviation of its logarithm where light alone shall tell it


@dataclass(frozen=True, eq=False)
class Photometry:
    """What was found of a capture's photographs.

    Attributes:
        scale: median luminance in the units of the radiance, by which the pixels are divided.
        weight: (N,) float32 information of each pixel's radiance; 1 for HDR photographs.
        facts: for statistics.json.
    """

    scale: float
    weight: np.ndarray
    facts: dict[str, Any]


def adjust_photographs(
    pixels: PixelStore, room: Room, part: np.ndarray, scale: float, settings: Settings, reporter: Reporter
) -> Photometry:
    """Replace the values of photographs that are not HDR by radiance.

    The unit is the radiance that saturates the median view or, beside HDR photographs, theirs.

    Args:
        pixels: traced, and sorted into pure and mixed ones; `radiance` is changed in place.
        part: (T,) int part of each triangle, negative without.
        scale: by which the pixels' values were divided.
        reporter: gets the warnings ``view-clipped``, ``view-unexplained`` and ``lamps-clipped``.
    """
    encoded = [index for index, view in enumerate(pixels.views) if view.encoded]
    footprint = median_footprint(pixels)
    cells, codes, basis = (
        surface_cells(pixels, room, part, footprint),
        _Codes(pixels, scale),
        response_basis(),
    )
    adjustment = adjust(_samples(cells, codes, encoded), len(encoded), basis)
    exposures = np.array([pixels.views[index].exposure or np.nan for index in encoded])
    told = exif_contrast(adjustment.log_gains.mean(axis=1), exposures)
    sources = [usual_contrast(basis), *([told] if told else [])]
    radiometry = Radiometry(adjustment, combined(sources), tuple(sources))
    lamp = _clipped_surfaces(pixels, room, codes, encoded)
    lit = _light(pixels, room, part, lamp, codes, radiometry, settings)
    found = None
    if len(lit.points.value) >= _LEAST_POINTS:
        broad = radiometry.contrast.value, _UNKNOWN_CONTRAST
        value, deviation = solve_lamps(lit.points, lit.cache, lit.bound, broad).log_contrast
        sources.append(Source("light", value, float(np.hypot(deviation, LIGHT_DEVIATION))))
        radiometry = Radiometry(adjustment, combined(sources), tuple(sources))
        found = solve_lamps(lit.points, lit.cache, lit.bound, (radiometry.contrast.value, 0.0))
    weight, clipped = _invert(pixels, codes, radiometry, lamp, found)
    unit = _common_unit(pixels, encoded)
    if len(encoded) < len(pixels.views):
        _align(pixels, surface_cells(pixels, room, part, footprint), encoded)
    middle = _median(pixels, range(len(pixels.views)))
    for index in range(len(pixels.views)):
        pixels.radiance[pixels.rows(index)] /= np.float32(middle)
    names = [pixels.views[index].name for index in encoded]
    facts = radiometry.facts(names, clipped)
    facts["lamps"] = [] if found is None else _lamp_facts(found)
    _warn(facts, reporter)
    return Photometry(unit * middle, weight, facts)


@dataclass(frozen=True, eq=False)
class _Codes:
    """The codes of pixels whose values are those of sRGB's curve, divided by the scale."""

    pixels: PixelStore
    scale: float

    def of(self, rows: np.ndarray | slice) -> np.ndarray:
        """(n, 3) float64 codes from 0 to 255."""
        return srgb_encoded(np.asarray(self.pixels.radiance[rows], np.float64) * self.scale) * 255.0

    def radius(self, index: int) -> np.ndarray:
        """(H * W,) distance of a view's pixels from its principal point, 1 in the farthest corner."""
        view = self.pixels.views[index]
        x = (np.arange(view.width) + 0.5 - view.cx)[None]
        y = (np.arange(view.height) + 0.5 - view.cy)[:, None]
        squared = (x**2 + y**2).ravel()
        return np.sqrt(squared / squared.max())


def _samples(cells: SurfaceCells, codes: _Codes, encoded: Sequence[int]) -> Samples:
    """Mean codes of surface cells in each of the views `encoded`."""
    pixels = codes.pixels
    # Cells are thinned out rather than pixels, so that each keeps all views that share it.
    step = max(1, cells.pixel_count // (2 * MOST_SAMPLES))
    coarse = replace(cells.grid, size=CLUSTER * cells.grid.size)
    columns: list[tuple[np.ndarray, ...]] = []
    for place, index in enumerate(encoded):
        rows, view = pixels.rows(index), pixels.views[index]
        every = codes.of(rows)
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


def _clipped_surfaces(pixels: PixelStore, room: Room, codes: _Codes, encoded: Sequence[int]) -> np.ndarray:
    """(T,) int32 clipped surface that each triangle belongs to, from 0; -1 without.

    A surface is connected triangles most of whose pixels are clipped; the largest `MOST_LAMPS` in the views.
    """
    count, clipped = np.zeros((2, len(room.triangles)))
    for index in encoded:
        rows = pixels.rows(index)
        triangle = np.asarray(pixels.triangle[rows])
        hit = triangle >= 0
        np.add.at(count, triangle[hit], 1.0)
        np.add.at(clipped, triangle[hit], is_clipped(codes.of(rows))[hit].astype(np.float64))
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
class _Light:
    """What `solve_lamps` needs; the last lamp is what lies outside the mesh."""

    points: LitPoints
    cache: np.ndarray
    bound: np.ndarray


def _light(
    pixels: PixelStore,
    room: Room,
    part: np.ndarray,
    lamp: np.ndarray,
    codes: _Codes,
    radiometry: Radiometry,
    settings: Settings,
) -> _Light:
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
        code = codes.of(rows)
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
    return _Light(points, pooled.filled()[0].astype(np.float64), np.where(np.isfinite(bound), bound, 0.0))


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


def _invert(
    pixels: PixelStore, codes: _Codes, radiometry: Radiometry, lamp: np.ndarray, found: LampLight | None
) -> tuple[np.ndarray, np.ndarray]:
    """Write radiance into the pixels; return their weights (N,) and the share of clipped pixels of each view
    that is not HDR."""
    weight, shares, place = np.ones(len(pixels), np.float32), [], 0
    lamps = int(lamp.max(initial=-1)) + 1
    for index, view in enumerate(pixels.views):
        rows = pixels.rows(index)
        if not view.encoded:
            pixels.radiance[rows] *= np.float32(codes.scale)
            continue
        code, triangle = codes.of(rows), np.asarray(pixels.triangle[rows])
        clipped = is_clipped(code)
        radiance = np.exp(radiometry.values(place, code, codes.radius(index)) * radiometry.factor)
        known = reliability(radiometry.errors(code))
        if found is not None:
            on = np.where(triangle >= 0, lamp[np.maximum(triangle, 0)], -1)
            on[triangle == NO_TRIANGLE] = lamps
            lit = clipped & (on >= 0)
            radiance[lit] = np.maximum(radiance[lit], np.exp(found.log_radiance[on[lit]]))
            known[lit] = 1.0
        pixels.radiance[rows], weight[rows] = radiance, known
        shares.append(float(clipped[triangle != LEFT_OUT].mean()) if (triangle != LEFT_OUT).any() else 0.0)
        place += 1
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


def _warn(facts: dict[str, Any], reporter: Reporter) -> None:
    """Say which photographs, and which lamps, the estimate can rely on less."""
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
