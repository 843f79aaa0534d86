"""Turns photographs that are not HDR into radiance: the radiometric adjustment on a capture's pixels.

The views are compared on surface cells (`checks.consistency`). Codes become radiance with a weight.
Triangles that are clipped in most pixels get the radiance inferred from the room's light (`light.clipped`).
Once shadings are baked, both are found again with their light (:mod:`.refit`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.encoded import srgb_decoded
from ..checks.consistency import ConsistencyTable
from ..light.clipped import Expectation, LampLight, LitPoints, solve_lamps
from ..light.observations import median_footprint
from ..pixels.store import LEFT_OUT, VIEW_LUMINANCES, PixelStore
from ..radiometry.adjustment import adjust, usable
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
from ..run.stage_settings import PhotometrySettings
from ..surface.room import Room
from .clipped_surfaces import VAGUE, ClippedSurfaces, Lit, find_clipped_surfaces, light_on_surfaces
from .codes import Codes, calm_samples

# Systematic error of the contrast inferred from light, due to gloss, textures and the coarse cache.
LIGHT_DEVIATION = 0.06
MIN_POINTS = 200
MAX_DEVIATIONS = 4.0  # by which the contrast by light may differ from that of the other sources
UNKNOWN_CONTRAST = 1.0  # standard deviation of its logarithm where light alone shall determine it
# Share of the light from directions that no photograph shows from which on it makes the contrast uncertain.
OPEN = 0.05


@dataclass(frozen=True, eq=False)
class Photometry:
    """The result of the adjustment of a capture's photographs.

    Attributes:
        scale: median luminance in the units of the radiance, by which the pixels are divided.
        weight: (N,) float32 information of each pixel's radiance; 1 for HDR photographs.
        facts: for statistics.json.
        found: what the second adjustment needs.
    """

    scale: float
    weight: np.ndarray
    facts: dict[str, Any]
    found: Found


@dataclass(frozen=True, eq=False)
class Found:
    """What the second adjustment needs of the first.

    Attributes:
        codes: of the photographs.
        radiometry: of the views that are not HDR.
        clipped: surfaces.
        lit: points and the light on them.
    """

    codes: Codes
    radiometry: Radiometry
    clipped: ClippedSurfaces
    lit: Lit

    def of_pixels(self, pixels: PixelStore) -> Found:
        """The same of a copy of the pixels."""
        return replace(self, codes=replace(self.codes, pixels=pixels))


def adjust_photographs(
    pixels: PixelStore, room: Room, part: np.ndarray, scale: float, settings: PhotometrySettings, folder: Path
) -> Photometry:
    """Replace the values of photographs that are not HDR by radiance.

    The unit is the radiance that saturates the median view or, beside HDR photographs, theirs.

    Args:
        pixels: traced, and sorted into pure and mixed ones; `radiance` is changed in place.
        part: (T,) int part of each triangle, negative without.
        scale: by which the pixels' values were divided.
        folder: for memory-mapped arrays.
    """
    codes, basis = Codes.of(pixels, scale, folder), response_basis()
    footprint = median_footprint(pixels)
    cells = ConsistencyTable.of(pixels, room, footprint, part)
    adjustment = adjust(calm_samples(cells, codes), codes.photograph, basis)
    exposures = np.array([pixels.views[index].exposure or np.nan for index in codes.encoded])
    exif = exif_contrast(adjustment.log_gains.mean(axis=1), exposures)
    sources = [usual_contrast(basis), *([exif] if exif else [])]
    radiometry = Radiometry(adjustment, combined(sources), tuple(sources))
    lamp = np.full(len(room.triangles), -1, np.int32)
    if settings.clipped_lamps:
        lamp = find_clipped_surfaces(room, codes, part, footprint)
    lit = light_on_surfaces(room, part, lamp, codes, radiometry, settings)
    expected = Expectation.of(lit.bound, radiometry.contrast.value)
    radiometry, light = solve_light(radiometry, lit.points, lit.cache, expected, LIGHT_DEVIATION)
    lamps = len(lit.bound)
    clipped = ClippedSurfaces(
        lamp, light, np.zeros(lamps, bool), np.zeros((lamps, 3)), np.zeros((0, 3), np.float16)
    )
    return write_radiance(room, part, scale, Found(codes, radiometry, clipped, lit))


def solve_light(
    radiometry: Radiometry, points: LitPoints, cache: np.ndarray, expected: Expectation, error: float
) -> tuple[Radiometry, LampLight | None]:
    """The contrast, with the evidence of light, and the lamps with this contrast; None with too few points.

    Args:
        error: systematic standard deviation of the contrast that is inferred from light.
    """
    if np.isfinite(points.value).any(axis=1).sum() < MIN_POINTS:
        return radiometry, None
    broad = radiometry.contrast.value, UNKNOWN_CONTRAST
    value, deviation = solve_lamps(points, cache, expected, broad).log_contrast
    # Where the mesh is open, most of the light comes from directions that no photograph shows.
    error = float(np.hypot(error, max(float(points.direct[:, -1].mean()) - OPEN, 0.0)))
    sources = [source for source in radiometry.sources if source.name != "light"]
    light, others = Source("light", value, float(np.hypot(deviation, error))), combined(sources)
    # A larger deviation has another cause than the contrast, and would make all radiances wrong.
    if abs(value - others.value) < MAX_DEVIATIONS * np.hypot(light.deviation, others.deviation):
        sources.append(light)
    found = Radiometry(radiometry.adjustment, combined(sources), tuple(sources))
    return found, solve_lamps(points, cache, expected, (found.contrast.value, 0.0))


def write_radiance(room: Room, part: np.ndarray, scale: float, found: Found) -> Photometry:
    """Write the radiance of all codes into the pixels; arguments as of :func:`adjust_photographs`."""
    pixels, encoded = found.codes.pixels, found.codes.encoded
    weight, share = _invert(scale, found)
    unit = _common_unit(pixels, encoded)
    if len(encoded) < len(pixels.views):
        _align(ConsistencyTable.of(pixels, room, median_footprint(pixels), part), encoded)
    middle = _median(pixels, range(len(pixels.views)))
    for index in range(len(pixels.views)):
        pixels.radiance[pixels.rows(index)] /= np.float32(middle)
    names = [pixels.views[index].name for index in encoded]
    facts = found.radiometry.facts(names, share)
    light = found.clipped.light
    facts["lamps"] = [] if light is None else _lamp_facts(light)
    shown = np.array([_shown(pixels, found.codes, index) for index in encoded])
    median = float(np.median(shown))
    facts["median_shown"] = 2.0**median
    for name, value in zip(names, shown, strict=True):
        facts["views"][name]["shown_ev"] = round(float(value) - median, 4)
    return Photometry(unit * middle, weight, facts, found)


def _shown(pixels: PixelStore, codes: Codes, index: int) -> float:
    """Stops after which sRGB's curve, and not the camera's, shows radiance as bright as a photograph does."""
    code, radiance = codes.of_view(index), np.asarray(pixels.radiance[pixels.rows(index)], np.float64)
    good = (usable(code) & (radiance > 0.0)).all(axis=1)
    stops = np.log2(srgb_decoded(code[good] / 255.0) / radiance[good]).mean(axis=1)
    return float(np.median(stops)) if len(stops) else -2.5  # middle grey


def _invert(scale: float, found: Found) -> tuple[np.ndarray, np.ndarray]:
    """Write radiance into the pixels; return their weights (N,) and the share of clipped pixels of each view
    that is not HDR."""
    codes, radiometry = found.codes, found.radiometry
    pixels = codes.pixels
    weight = np.ones(len(pixels), np.float32)
    shares: list[float] = []
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


def _align(table: ConsistencyTable, encoded: Sequence[int]) -> None:
    """Bring photographs that are not HDR to the exposure of those that are."""
    gains, pixels = np.log(table.view_gains()[:, 0]), table.pixels
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
            number_of_much=len(much),
            number_of_views=len(views),
            much=much[0],
            share=100.0 * share,
        )
    strange = [name for name, view in views.items() if view["unexplained"] > MUCH_UNEXPLAINED]
    if strange:
        reporter.warning(
            "view-unexplained", number_of_strange=len(strange), number_of_views=len(views), strange=strange[0]
        )
    lamps = facts["lamps"][:-1]
    vague = sum(max(lamp["deviation"]) > VAGUE for lamp in lamps)
    if lamps:
        reporter.warning("lamps-clipped", number_of_lamps=len(lamps), vague=vague)
