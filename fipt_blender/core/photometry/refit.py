"""Second adjustment of photographs that are not HDR, with the light of baked shadings.

The light on surfaces determines the response's contrast and the radiance of clipped lamps
(`light.clipped`), but a few rays into the cache underestimate it by several percent where lamps are small and
close. Baked shadings do not: the ratio of their L_d to the light of that model is a correction at each point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..light.clipped import Expectation
from ..light.shadings import SampleCounts
from ..optics.lights import LUMINANCE
from ..pixels.store import PixelStore
from ..radiometry.adjustment import usable
from ..radiometry.inversion import Radiometry, is_clipped
from ..surface.room import Room
from .clipped_surfaces import VAGUE, ClippedSurfaces
from .encoded_photographs import Found, Photometry, solve_light, write_radiance

LightOf = Callable[[np.ndarray, SampleCounts], np.ndarray]
# Samples of the light over the hemisphere and towards lamps: at points that determine the contrast, which
# noise of the light would raise, and at other pixels.
POINT_SAMPLES, PIXEL_SAMPLES = SampleCounts(1024, 0, 256), SampleCounts(64, 0, 32)
# Systematic error of the contrast inferred from the light of shadings, as measured.
REFIT_DEVIATION = 0.03
# Largest correction of the logarithm of light: beyond it, the model or the shading is wrong.
MAX_CORRECTION = 1.0
# Points are not used if their correction differs from the median by more than this over the standard
# deviation of the position of surfaces in metres (by 0.15 on a scan with edges of 2 cm): where normals are
# rough and lamps torn, the baked light is as often wrong as the model. Errors of light raise the contrast.
MAX_DIFFERENCE = 0.003
MAX_LIGHT = 6.0e4  # in half floats
# Darkest L_d, in units of the capture's median, that is compared and by which is divided.
MIN_LIGHT = 1e-3
# Standard deviation of the logarithm of what a clipped surface reflects, due to its albedo and its shadings.
_REFLECTED = 0.5
# Albedo of a part of which no unclipped pixel is known, and the highest that is believed.
_USUAL_ALBEDO, _MAX_ALBEDO = 0.5, 0.9
_MIN_PIXELS = 20
# Most pixels of a part from which its albedo is found.
_ALBEDO_PIXELS = 400


def refit_photographs(
    before: Photometry, pixels: PixelStore, room: Room, part: np.ndarray, light_of: LightOf
) -> Photometry:
    """Find the contrast and the clipped lamps with baked light, and write the radiance again.

    Args:
        before: result of the first adjustment; `pixels.radiance` is in its unit, apart from views' exposures.
        part: (T,) int part of each triangle, negative without.
        light_of: L_d (M, 3) of pixels (M,) with numbers of samples, baked with the radiance of the pixels.
    """
    found = before.found
    lit, contrast = found.lit, found.radiometry.factor
    if found.clipped.light is None:
        return before
    albedo_rows = _albedo_pixels(pixels, part, found)
    clipped_rows = [rows for rows, _, _ in _clipped(pixels, found)]
    seen = lit.pixel[np.asarray(pixels.triangle[lit.pixel]) >= 0]
    others = np.unique(np.concatenate([albedo_rows, *clipped_rows]))
    diffuse = np.zeros((len(pixels), 3), np.float16)
    diffuse[others] = np.minimum(light_of(others, PIXEL_SAMPLES), MAX_LIGHT)
    diffuse[seen] = np.minimum(light_of(seen, POINT_SAMPLES), MAX_LIGHT)
    light = np.asarray(diffuse[lit.pixel], np.float64)
    radiance = np.asarray(pixels.radiance[lit.pixel], np.float64)
    valid = (np.asarray(pixels.triangle[lit.pixel]) >= 0) & (light > MIN_LIGHT).all(axis=1)
    valid &= (radiance > 0.0).all(axis=1)
    if not valid.any():
        return before
    unit, radiometry = _exposed(
        found, lit.points.value * contrast - np.log(np.maximum(radiance, 1e-12)), valid
    )
    shift = found.radiometry.adjustment.log_gains - radiometry.adjustment.log_gains
    model = lit.points.light(lit.cache, _shown(pixels, found, unit), contrast)
    correction = np.log(np.maximum(light, MIN_LIGHT)) + unit - np.log(np.maximum(model, 1e-12))
    usual = np.median(correction[valid], axis=0)
    valid &= (room.place * np.abs(correction - usual) < MAX_DIFFERENCE).all(axis=1)
    points = replace(
        lit.points,
        value=np.where(valid[:, None], lit.points.value + shift[lit.place], np.nan),
        correction=np.clip(correction, -MAX_CORRECTION, MAX_CORRECTION),
    )
    albedos = _albedos(pixels, part, albedo_rows, diffuse)
    reflecting, reflected, albedo = _reflected(pixels, part, diffuse, found, unit, albedos)
    broad = Expectation.of(lit.bound, radiometry.contrast.value)
    expected = Expectation(
        np.where(reflecting[:, None], np.log(np.maximum(reflected, 1e-12)) + unit, broad.log_radiance),
        np.where(reflecting, _REFLECTED, broad.deviation),
    )
    radiometry, lamps = solve_light(radiometry, points, lit.cache, expected, REFIT_DEVIATION)
    if lamps is None:
        return before
    # The light on reflecting surfaces changes with the lamps.
    albedo = albedo * np.exp(
        unit + np.where(reflecting[:, None], lamps.log_radiance - expected.log_radiance, 0.0)
    )
    clipped = ClippedSurfaces(found.clipped.of_triangle, lamps, reflecting, albedo, diffuse)
    again = replace(found, radiometry=radiometry, clipped=clipped, lit=replace(lit, points=points))
    return write_radiance(room, part, before.scale, again)


def _shown(pixels: PixelStore, found: Found, unit: float) -> np.ndarray:
    """(F, 3) radiance of the clipped surfaces that the shadings were baked with.

    Not all have the radiance that was found: the pixels of some hold the bound, or what they reflect.

    Args:
        unit: logarithm of the unit of the pixels' radiance.
    """
    clipped = found.clipped
    assert clipped.light is not None, "asked only where the light was solved"
    total, count = np.zeros((len(clipped.reflecting), 3)), np.zeros(len(clipped.reflecting))
    for index in found.codes.encoded:
        rows = pixels.rows(index)
        surface = clipped.on(np.asarray(pixels.triangle[rows]))
        seen = surface >= 0
        np.add.at(total, surface[seen], np.asarray(pixels.radiance[rows], np.float64)[seen])
        np.add.at(count, surface[seen], 1.0)
    mean = total / np.maximum(count, 1.0)[:, None] * np.exp(unit)
    kept = clipped.inferred | (count == 0)
    return np.where(kept[:, None], np.exp(clipped.light.log_radiance), mean)


def _exposed(found: Found, offset: np.ndarray, valid: np.ndarray) -> tuple[float, Radiometry]:
    """The logarithm of the unit of the pixels' radiance, and the radiometry with corrected exposures.

    Args:
        offset: (N, 3) logarithm of the codes' radiance over the pixels', NaN where it is not known.
    """
    photograph = found.codes.photograph
    usual = float(np.nanmedian(offset[valid])) if np.isfinite(offset[valid]).any() else 0.0
    gains = np.array(found.radiometry.adjustment.log_gains)
    for number in np.unique(photograph):
        own = offset[valid & (photograph[found.lit.place] == number)]
        if np.isfinite(own).any():
            by = float(np.nanmedian(own)) - usual
            gains[photograph == number] += by / found.radiometry.factor if abs(by) > 1e-3 else 0.0
    adjustment = replace(found.radiometry.adjustment, log_gains=gains)
    return usual, replace(found.radiometry, adjustment=adjustment)


def _reflected(
    pixels: PixelStore,
    part: np.ndarray,
    diffuse: np.ndarray,
    found: Found,
    unit: float,
    albedos: dict[int, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The radiance that clipped surfaces reflect.

    Args:
        unit: logarithm of the unit of the pixels' radiance.
        albedos: (3,) of the parts of which one is known.

    Returns:
        (F,) bool, surfaces that would be as bright if they were white, (F, 3) mean radiance that they
        reflect, (F, 3) their albedo.
    """
    lamps = found.clipped.light
    assert lamps is not None, "asked only where the light was solved"
    # The light that a surface casts may show that it is brighter than the bound, as a bulb in a shade is.
    inferred = np.where(lamps.deviation.max(axis=1) < VAGUE, np.exp(lamps.log_radiance) @ LUMINANCE, 0.0)
    count = len(found.clipped.reflecting)
    reflecting, mean, albedo = np.zeros(count, bool), np.ones((count, 3)), np.ones((count, 3))
    rows, surface, bound = (np.concatenate(column) for column in zip(*_clipped(pixels, found), strict=True))
    light, own = np.asarray(diffuse[rows], np.float64), part[pixels.triangle[rows]]
    for number in np.unique(surface):
        mine = surface == number
        white = np.median(light[mine] @ LUMINANCE) * np.exp(unit)
        reflecting[number] = max(np.median(bound[mine]), inferred[number]) <= white
        values, sizes = np.unique(own[mine], return_counts=True)
        albedo[number] = albedos.get(int(values[np.argmax(sizes)]), np.full(3, _USUAL_ALBEDO))
        mean[number] = np.maximum(light[mine].mean(axis=0) * albedo[number], 1e-6)
    return reflecting, mean, albedo


def _clipped(pixels: PixelStore, found: Found) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Clipped pixels of each view: their rows, surface, and luminance at which they are clipped."""
    radiometry, codes = found.radiometry, found.codes
    for place, index in enumerate(codes.encoded):
        rows = pixels.rows(index)
        code, triangle = codes.of_view(index), np.asarray(pixels.triangle[rows])
        surface = found.clipped.on(triangle)
        chosen = np.flatnonzero(is_clipped(code) & (triangle >= 0) & (surface >= 0))
        value = radiometry.values(place, code[chosen], codes.radius(index)[chosen]) * radiometry.factor
        yield chosen + rows.start, surface[chosen], np.exp(value) @ LUMINANCE


def _albedo_pixels(pixels: PixelStore, part: np.ndarray, found: Found) -> np.ndarray:
    """Unclipped pixels of the parts that are clipped somewhere: at most `_ALBEDO_PIXELS` of each."""
    wanted = part[found.clipped.of_triangle >= 0]
    chosen = []
    for index in found.codes.encoded:
        rows = pixels.rows(index)
        triangle = np.asarray(pixels.triangle[rows])
        good = usable(found.codes.of_view(index)).all(axis=1) & (triangle >= 0) & pixels.pure[rows]
        good &= np.isin(part[triangle], wanted) & (part[triangle] >= 0)
        chosen.append(np.flatnonzero(good) + rows.start)
    every = np.concatenate(chosen)
    own = part[pixels.triangle[every]]
    order = np.argsort(own, kind="stable")
    _, first, count = np.unique(own[order], return_index=True, return_counts=True)
    place = np.arange(len(order)) - np.repeat(first, count)
    step = np.repeat(-(-count // _ALBEDO_PIXELS), count)
    return every[order[place % step == 0]] if len(order) else every


def _albedos(
    pixels: PixelStore, part: np.ndarray, rows: np.ndarray, diffuse: np.ndarray
) -> dict[int, np.ndarray]:
    """(3,) median albedo of the pixels (M,) of each part that has enough of them."""
    light = np.asarray(diffuse[rows], np.float64)
    good = (light > MIN_LIGHT).all(axis=1)
    if not good.any():
        return {}
    own, ratio = part[pixels.triangle[rows]][good], pixels.radiance[rows][good] / light[good]
    order = np.argsort(own, kind="stable")
    parts, first = np.unique(own[order], return_index=True)
    groups = zip(parts.tolist(), np.split(ratio[order], first[1:]), strict=True)
    return {
        number: np.clip(np.median(values, axis=0), 0.0, _MAX_ALBEDO)
        for number, values in groups
        if len(values) >= _MIN_PIXELS
    }
