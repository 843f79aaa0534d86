"""The probability that a surface emits (after the paper's Sec. 4.4 "Emitter extraction"): two states.

Let x be the logarithm of a pixel's radiance over the most that its surface reflects.
Reflects: x = log a + error, a uniform in [0, 1], the error by Student's t-distribution.
Emits: x is uniform above 0, over orders of magnitude, and falls with a power of the radiance below.
Radiance that is constant in varying light is evidence of emission, too. Lamps are few, and each is connected.

Arrays say how much each pixel and each surface tells (:class:`.emitter_surfaces.EmitterSurfaces`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree
from scipy.special import gamma, logit, stdtr  # scipy.stats takes half a second to import

from ..optics.lights import LUMINANCE
from ..parts.components import component_means, graph_components
from ..pixels.grouped import grouped_sums, pairs_of, rows_of_groups
from ..pixels.store import PixelStore
from ..pixels.unmixing import NOISE, standard_error
from ..robust import DEGREES, deviation
from ..surface.adjacency import weld
from ..surface.room import Room
from .baking import ShadingStore
from .emitter_surfaces import HIDDEN, MUCH_UNSEEN, RADIANCE_ERROR, SPREAD, EmitterSurfaces

# Prior probability that a surface is a lamp, where pixels are brighter than a white surface.
PRIOR = 0.003
# Lamps are brighter than white surfaces by orders of magnitude, evenly on a logarithmic scale, most of them
# up to this logarithm; the density falls with this power of the radiance below.
BRIGHTEST, DIM_POWER = 7.0, 2.0
# Share of a pure pixel's light that may spill over from its neighbours: half where coplanar surfaces meet at
# its centre, 16 to 30 % by a camera's blur (a Gaussian of half a pixel).
SPILL = 0.5
# Constant radiance in varying light: pixels per sample, most samples, relative deviation of it on one lamp.
ALIKE_PIXELS, ALIKE_SAMPLES, ALIKE = 10.0, 30.0, 0.05
# `brighter_than_white`: least factor (noise makes white surfaces brighter, too), and most pixels compared.
BRIGHTER, MAX_COMPARED = 1.1, 200_000


def emission_probability(
    room: Room,
    pixels: PixelStore,
    shadings: ShadingStore,
    white: Callable[[np.ndarray], np.ndarray],
    surfaces: EmitterSurfaces,
    hinted: np.ndarray,
) -> np.ndarray:
    """(T,) float32 probability that each triangle emits.

    Args:
        shadings: of all pixels.
        white: (R,) pixels to the (R, 3) most that a surface of the gloss of theirs reflects.
        hinted: (T,) int8, 1 on triangles that emit in any case, -1 on those that do not, 0 elsewhere.
    """
    unit, units = surfaces.unit, int(surfaces.unit.max(initial=-1)) + 1
    seen = read_evidence(pixels, shadings, white, unit, surfaces.reach)
    evidence, samples = unit_evidence(seen, surfaces.error, units)
    alike = np.full(units, -1, np.int64)
    alike[unit] = surfaces.alike
    of_alike = _constancy(seen, alike, int(alike.max(initial=-1)) + 1, surfaces.spread)
    constant = np.append(np.maximum(of_alike, 0.0), 0.0)[alike]
    mean = np.where(samples > 0.0, evidence / np.maximum(samples, 1e-9), -np.inf)
    likely = np.flatnonzero(mean + constant > 0.0)
    lamp = np.full(units, -1, np.int64)
    lamp[likely] = _connected(room, surfaces, likely, samples)
    count = int(lamp.max(initial=-1)) + 1
    number, total = (np.bincount(lamp[likely], each[likely], count) for each in (samples, evidence))
    of_lamp = _constancy(seen, np.where(alike >= 0, -1, lamp), count, surfaces.spread)
    of_lamp[lamp[likely]] += constant[likely]
    total = total / (1.0 + number / surfaces.max_samples) + of_lamp
    odds = np.exp(-np.clip(total + logit(PRIOR), -50.0, 50.0))
    inside = np.flatnonzero(lamp[unit] >= 0)
    weights = room.areas, room.areas * surfaces.unseen
    area, close = (np.bincount(lamp[unit[inside]], each[inside], count) for each in weights)
    share = np.minimum(close / np.maximum(area, 1e-12) / MUCH_UNSEEN, 1.0)
    probability = 1.0 / (1.0 + odds + HIDDEN * share * np.exp(-np.clip(of_lamp, 0.0, 50.0)))
    judged = (samples > 0.0)[unit] | (hinted != 0)
    of_triangle = np.append(probability, 0.0)[lamp][unit]
    result = np.where(hinted == 0, of_triangle, (hinted > 0).astype(np.float64))
    around = component_means(room.areas, surfaces.component, result, judged)
    return np.where(judged, result, around).astype(np.float32)


@dataclass(frozen=True)
class PixelEvidence:
    """N pixels that see the mesh, view by view.

    Attributes:
        unit: (N,) int surface that each sees. view: (N,) int. pure: (N,) bool.
        weight: (N,) float32 information of `own`, 1 for pure pixels.
        own: (N, 3) float32 radiance of the surface, in units of the capture's median.
        low, high: (N,) float32 factors of `own` between which the true radiance lies.
        reflected: (N, 3) float32 most that the surface reflects.
        diffuse: (N,) float32 luminance of L_d.
    """

    unit: np.ndarray
    view: np.ndarray
    pure: np.ndarray
    weight: np.ndarray
    own: np.ndarray
    low: np.ndarray
    high: np.ndarray
    reflected: np.ndarray
    diffuse: np.ndarray


def read_evidence(
    pixels: PixelStore,
    shadings: ShadingStore,
    white: Callable[[np.ndarray], np.ndarray],
    unit: np.ndarray,
    reach: int,
) -> PixelEvidence:
    """All pixels with a known radiance.

    Args:
        white: (R,) pixels to the (R, 3) most that a surface of the gloss of theirs reflects.
        unit: (T,) int surface of each triangle.
        reach: largest distance in pixels between the surface that a pixel shows and the one that it hits.
    """
    found = []
    for index, view in enumerate(pixels.views):
        rows, size = pixels.rows(index), (view.height, view.width)
        triangle, own, weight = (np.asarray(a[rows]) for a in (pixels.triangle, pixels.own, pixels.weight))
        diffuse = np.asarray(shadings.diffuse[rows], np.float32)
        reflected = white(np.arange(rows.start, rows.stop))
        if reach:
            reflected = most_nearby(reflected, triangle >= 0, size, reach)
        error = standard_error(own, weight) / np.maximum(own.mean(axis=1), 1e-12)
        low = np.maximum(1.0 - error, 0.0)
        luminance = (np.asarray(pixels.radiance[rows]) @ LUMINANCE).reshape(size)
        brightest = maximum_filter(luminance, size=3, mode="nearest").reshape(-1)
        low *= spill_free_fraction(low * (own @ LUMINANCE), brightest) * (1.0 - NOISE)
        high = (1.0 + error) * (1.0 + NOISE)
        hit = np.flatnonzero((triangle >= 0) & (weight > 0.0))
        columns = weight, own, low, high, reflected, diffuse @ LUMINANCE
        of_view = [np.asarray(column[hit], np.float32) for column in columns]
        pure = np.asarray(pixels.pure[rows])[hit]
        found.append((unit[triangle[hit]], np.full(len(hit), index), pure, *of_view))
    return PixelEvidence(*(np.concatenate(column) for column in zip(*found, strict=True)))


def log_ratio(radiance: np.ndarray, reflected: np.ndarray) -> np.ndarray:
    """(N,) logarithm of the luminance of radiances (N, 3) over what reflection explains of it (N, 3).

    Where a channel is brighter than reflection, the others count as explained: a red lamp under white light
    may be as dark as a wall.
    """
    luminance = radiance @ LUMINANCE
    explained = np.where(
        (radiance > reflected).any(axis=1), np.minimum(radiance, reflected) @ LUMINANCE, reflected @ LUMINANCE
    )
    return np.asarray(np.log(np.maximum(luminance, 1e-6) / np.maximum(explained, 1e-6)))


def most_nearby(reflected: np.ndarray, hit: np.ndarray, size: tuple[int, int], reach: int) -> np.ndarray:
    """(n, 3) largest of reflected radiances (n, 3) within `reach` pixels that hit the mesh, in each channel.

    Args:
        hit: (n,) bool. size: (height, width) of the view.
    """
    image = np.where(hit[:, None], reflected, 0.0).reshape(*size, 3)
    width = 2 * reach + 1
    return np.asarray(maximum_filter(image, (width, width, 1), mode="nearest")).reshape(-1, 3)


def spill_free_fraction(luminance: np.ndarray, brightest: np.ndarray) -> np.ndarray:
    """(n,) lower bound of the share of a pure pixel's light that comes from its surface.

    Args:
        luminance: (n,) of the pixels.
        brightest: (n,) maximum in the neighbourhood, from which light may spill over.
    """
    remaining = (luminance - SPILL * brightest) / (1.0 - SPILL)
    return np.clip(remaining / np.maximum(luminance, 1e-12), 0.0, 1.0)


def unit_evidence(seen: PixelEvidence, error: float, units: int) -> tuple[np.ndarray, np.ndarray]:
    """(units,) sums of the logarithms of likelihood ratios, and of samples: at most one of each view.

    Args:
        error: relative, of what could be reflected by pure pixels.
    """
    errors = np.sqrt(error**2 + np.where(seen.pure, 0.0, RADIANCE_ERROR**2))
    low, high = (log_ratio(seen.own * each[:, None], seen.reflected) for each in (seen.low, seen.high))
    unit, _, pair = pairs_of(seen.unit, seen.view)
    count = np.bincount(pair, seen.weight)
    samples = count / (1.0 + count)
    mean = np.bincount(pair, log_evidence(low, high, errors) * seen.weight) / count
    return np.bincount(unit, mean * samples, units), np.bincount(unit, samples, units)


def log_evidence(low: np.ndarray, high: np.ndarray, error: np.ndarray) -> np.ndarray:
    """(N,) logarithm of the likelihood of emission over that of reflection.

    Both likelihoods are the probability of the interval that contains the pixel's radiance.

    Args:
        low, high: (N,) logarithms of radiance over the most that could be reflected (:func:`log_ratio`).
        error: (N,) relative standard error of what could be reflected.
    """
    # Student's density at 0.
    mode = gamma(0.5 * (DEGREES + 1.0)) / (np.sqrt(DEGREES * np.pi) * gamma(0.5 * DEGREES))

    def reflecting(x: np.ndarray) -> np.ndarray:
        above = (stdtr(DEGREES, np.maximum(x, 0.0) / error) - 0.5) * error / mode
        return np.asarray((np.exp(np.minimum(x, 0.0)) + above) / (1.0 + 0.5 * error / mode))

    def emitting(x: np.ndarray) -> np.ndarray:
        below = np.exp(DIM_POWER * np.minimum(x, 0.0)) / DIM_POWER
        return np.asarray((below + np.maximum(x, 0.0)) / (BRIGHTEST + 1.0 / DIM_POWER))

    ratio = (emitting(high) - emitting(low) + 1e-9) / (reflecting(high) - reflecting(low) + 1e-9)
    return np.asarray(np.log(ratio))


def constancy(
    radiance: np.ndarray, diffuse: np.ndarray, group: np.ndarray, groups: int, least: float
) -> np.ndarray:
    """(groups,) evidence by radiance that is constant where the light varies, or that follows the light.

    Radiance that varies by more than that of one lamp is no evidence for emission, however the light varies.

    Args:
        radiance, diffuse: (N,) logarithms. group: (N,) int from 0, negative for none.
        least: deviation of radiance over light that errors of the light make.
    """
    result = np.zeros(groups)
    for index, rows in enumerate(rows_of_groups(group, groups)):
        if len(rows):
            emits, reflects = (
                deviation(values - np.median(values), SPREAD)
                for values in (radiance[rows], radiance[rows] - diffuse[rows])
            )
            evidence = np.log(max(reflects, least) / max(emits, least))
            if evidence > 0.0:
                evidence = max(evidence - 0.5 * max((emits / ALIKE) ** 2 - 1.0, 0.0), 0.0)
            samples = len(rows) / ALIKE_PIXELS
            result[index] = evidence * samples / (1.0 + samples / ALIKE_SAMPLES)
    return result


def _constancy(seen: PixelEvidence, of_unit: np.ndarray, groups: int, least: float) -> np.ndarray:
    """(groups,) :func:`constancy` of the pure pixels of groups of units ((U,) int, negative for none)."""
    group = np.where(seen.pure, of_unit[seen.unit], -1)
    radiance, diffuse = (np.log(np.maximum(each, 1e-6)) for each in (seen.own @ LUMINANCE, seen.diffuse))
    return constancy(radiance, diffuse, group, groups, least)


def _connected(room: Room, surfaces: EmitterSurfaces, units: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(n,) int64 from 0: connected surface of each of the units (n,), within components.

    There may be gaps between patches of a scan, and unseen triangles between those of a modelled room.

    Args:
        samples: (U,) of all units, 0 where nothing is seen.
    """
    count, of_unit = len(units), np.zeros(len(samples), np.int64)
    of_unit[surfaces.unit] = surfaces.component
    if surfaces.gap:
        area = np.maximum(np.bincount(surfaces.unit, room.areas, len(samples)), 1e-12)
        weighted = room.vertices[room.triangles].mean(axis=1) * room.areas[:, None]
        centers = grouped_sums(weighted, surfaces.unit, len(samples)) / area[:, None]
        pairs = cKDTree(centers[units]).query_pairs(surfaces.gap, output_type="ndarray")
    else:
        units = np.append(units, np.flatnonzero(samples == 0.0))
        corners = weld(room.vertices)[room.triangles][units].reshape(-1)  # a unit is a triangle
        order = np.argsort(corners, kind="stable")
        same = np.flatnonzero(np.diff(corners[order]) == 0)
        pairs = np.stack([order[same], order[same + 1]], axis=1) // 3
    component = of_unit[units]
    pairs = pairs[component[pairs[:, 0]] == component[pairs[:, 1]]]
    return np.unique(graph_components(pairs, len(units))[:count], return_inverse=True)[1]


def brighter_than_white(pixels: PixelStore, shadings: ShadingStore) -> float:
    """Share of the mesh's pixels that are brighter than a white diffuse surface in the light that was baked.

    With the shadings of stage 1 it is the share of lamps and highlights, unless light comes from lamps that
    no photograph shows. Evenly spaced pixels stand for all.
    """
    rows = np.arange(0, len(pixels), max(1, len(pixels) // MAX_COMPARED))
    rows = rows[(np.asarray(pixels.weight[rows]) > 0.0) & (np.asarray(pixels.triangle[rows]) >= 0)]
    diffuse = np.asarray(shadings.diffuse[rows], np.float32) @ LUMINANCE
    return float(np.mean(np.asarray(pixels.own[rows]) @ LUMINANCE > BRIGHTER * diffuse)) if len(rows) else 0.0
