# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The probability that a surface emits (after the paper's Sec. 4.4 "Emitter extraction").

Two hypotheses are compared for each unit (:mod:`.emitter_surfaces`). If it reflects, its radiance is a share,
uniform in [0, 1], of what a white surface of its gloss reflects there, with an error by Student's
t-distribution. If it emits, its radiance is of any order of magnitude above that, and rarely below. Lamps are
few, and each is connected and has one radiance. docs/method.md states the model.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import gamma, logit, stdtr  # scipy.stats takes half a second to import

from ..optics.lights import LUMINANCE
from ..parts.components import component_means, graph_components
from ..pixels.grouped import grouped_sums, pairs_of, rows_of_groups
from ..pixels.store import PixelStore
from ..robust import DEGREES, deviation
from ..surface.adjacency import weld
from ..surface.room import Room
from .baking import ShadingStore
from .emitter_surfaces import EmitterSurfaces
from .evidence import PixelEvidence, log_ratio, read_evidence

# Prior probability that a surface is a lamp, where pixels are brighter than a white surface.
PRIOR = 0.003
# Relative errors: of unmixed radiance beside its standard error, and of the radiance of photographs that are
# not HDR.
MIXED_ERROR, PHOTOGRAPH_ERROR = 0.3, 0.3
# Lamps are brighter than white surfaces by orders of magnitude, evenly on a logarithmic scale, most of them
# up to this logarithm; the density falls with this power of the radiance below.
BRIGHTEST, DIM_POWER = 7.0, 2.0
# Constant radiance in varying light: pixels per sample, most samples, spread due to noise alone, relative
# deviation of the radiance of one lamp, and how many of these deviations a part of a lamp may differ from it.
ALIKE_PIXELS, ALIKE_SAMPLES, ALIKE_SPREAD, ALIKE, MAX_OFF = 10.0, 30.0, 0.03, 0.05, 3.0
# The relative error of a lamp's light is so many times the error of positions over the distance, at most 1. A
# lamp lights what is less bright than itself by this factor.
PLACE_ERROR, LIT = 3.0, 2.0
# Where lamps may be close that nothing shows, one is likelier than the surface that it lights by HIDDEN, in
# full from this share of the directions on.
MUCH_UNSEEN, HIDDEN = 0.1, 2.0
ROUNDS = 4  # of lamps and what they light; more change nothing
POSSIBLE = 0.05  # least probability of lamps that are extended to adjacent units, and that light others
CHUNK = 256  # lit units at a time


def emission_probability(
    room: Room,
    pixels: PixelStore,
    shadings: ShadingStore,
    white: Callable[[np.ndarray], np.ndarray],
    surfaces: EmitterSurfaces,
    hinted: np.ndarray,
    baked: np.ndarray,
    hdr: bool,
) -> np.ndarray:
    """(T,) float32 probability that each triangle emits.

    Args:
        shadings: of all pixels.
        white: (R,) pixels to the (R, 3) most that a surface of the gloss of theirs reflects.
        hinted: (T,) int8, 1 on triangles that emit in any case, -1 on those that do not, 0 elsewhere.
        baked: (T,) bool, lamps whose own radiance was baked into the shadings, instead of that of voxels.
        hdr: whether all photographs are HDR; in others, clipped lamps look constant in any case.
    """
    seen = read_evidence(pixels, shadings, white, surfaces.unit, surfaces.reach)
    lamps = _Lamps(room, surfaces, seen, hdr)
    probability = lamps.probability(baked)
    judged = (lamps.samples > 0.0)[surfaces.unit] | (hinted != 0)
    result = np.where(hinted == 0, probability[surfaces.unit], (hinted > 0).astype(np.float64))
    around = component_means(room.areas, surfaces.component, result, judged)
    return np.where(judged, result, around).astype(np.float32)


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
                deviation(values - np.median(values), ALIKE_SPREAD)
                for values in (radiance[rows], radiance[rows] - diffuse[rows])
            )
            evidence = np.log(max(reflects, least) / max(emits, least))
            if evidence > 0.0:
                evidence = max(evidence - 0.5 * max((emits / ALIKE) ** 2 - 1.0, 0.0), 0.0)
            samples = len(rows) / ALIKE_PIXELS
            result[index] = evidence * samples / (1.0 + samples / ALIKE_SAMPLES)
    return result


class _Lamps:
    """The evidence of a room's units, and the lamps that they form; arguments as above.

    Attributes:
        evidence, samples: (U,) sums of the logarithms of likelihood ratios, and the number of independent
            samples that the pixels of each unit are equivalent to.
    """

    def __init__(self, room: Room, surfaces: EmitterSurfaces, seen: PixelEvidence, hdr: bool) -> None:
        self.surfaces, self.seen, self.hdr = surfaces, seen, hdr
        self.units = int(surfaces.unit.max(initial=-1)) + 1
        self.component = np.zeros(self.units, np.int64)
        self.component[surfaces.unit] = surfaces.component
        self.area = np.bincount(surfaces.unit, room.areas, self.units)
        weight = np.maximum(self.area, 1e-12)[:, None]
        centers = room.vertices[room.triangles].mean(axis=1) * room.areas[:, None]
        self.centers = grouped_sums(centers, surfaces.unit, self.units) / weight
        normals = grouped_sums(room.normals * room.areas[:, None], surfaces.unit, self.units)
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        self.luminance = seen.own @ LUMINANCE
        count = np.maximum(np.bincount(seen.unit, minlength=self.units), 1)
        self.radiance = np.bincount(seen.unit, self.luminance, self.units) / count
        unseen = 0.0 if surfaces.unseen is None else surfaces.unseen
        self.unseen = np.bincount(surfaces.unit, unseen * room.areas, self.units)
        self.corners = None if surfaces.place else weld(room.vertices)[room.triangles]
        self.evidence, self.samples = self._sums(np.arange(len(seen.unit)), np.zeros(self.units))

    @property
    def mean(self) -> np.ndarray:
        """(U,) evidence of a sample; minus infinity without any."""
        return np.where(self.samples > 0.0, self.evidence / np.maximum(self.samples, 1e-9), -np.inf)

    def probability(self, baked: np.ndarray) -> np.ndarray:
        """(U,) of each unit; `baked`: as of :func:`emission_probability`."""
        of_part = self._constant_parts()
        lamp, of_lamp = self._lamps(of_part)
        lit_by_bake = np.bincount(self.surfaces.unit, baked * 1.0, self.units) > 0.0
        for _ in range(ROUNDS - 1 if self.surfaces.place else 0):
            added = self._added_light(np.append(of_lamp, 0.0)[lamp], lit_by_bake)
            lit = added > 0.0
            evidence, samples = self._sums(np.flatnonzero(lit[self.seen.unit]), added)
            self.evidence[lit], self.samples[lit] = evidence[lit], samples[lit]
            lamp, of_lamp = self._lamps(of_part)
        return self._extended(lamp, of_lamp)

    def _sums(self, rows: np.ndarray, added: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evidence and samples of the pixels `rows` (R,) if light of (U,) luminance is added to their units.

        However many pixels of one view show a unit, they are one sample at most.
        """
        seen, unit = self.seen, self.seen.unit[rows]
        error = np.full(len(rows), self.surfaces.shading_error**2)
        error += self.surfaces.light_error**2
        error += np.where(seen.pure[rows], 0.0, MIXED_ERROR**2) + (0.0 if self.hdr else PHOTOGRAPH_ERROR**2)
        own, reflected = seen.own[rows], seen.reflected[rows] + added[unit, None]
        low, high = (log_ratio(own * factor[rows, None], reflected) for factor in (seen.low, seen.high))
        evidence = log_evidence(low, high, np.sqrt(error))
        unit, _, pair = pairs_of(unit, seen.view[rows])
        weight = seen.weight[rows]
        count = np.bincount(pair, weight)
        samples = count / (1.0 + count)
        mean = np.bincount(pair, evidence * weight) / count
        return np.bincount(unit, mean * samples, self.units), np.bincount(unit, samples, self.units)

    def _constancy(self, group_of_unit: np.ndarray, groups: int) -> np.ndarray:
        """(groups,) :func:`constancy` of the pure pixels of groups of units ((U,) int, negative for none)."""
        if not self.hdr:
            return np.zeros(groups)
        group = np.where(self.seen.pure, group_of_unit[self.seen.unit], -1)
        radiance, diffuse = (np.log(np.maximum(a, 1e-6)) for a in (self.luminance, self.seen.diffuse))
        return constancy(radiance, diffuse, group, groups, self.surfaces.spread)

    def _constant_parts(self) -> np.ndarray | None:
        """(U,) evidence by the constant radiance of known parts; None without parts."""
        part = self.surfaces.part
        if part is None:
            return None
        of_unit = np.full(self.units, -1, np.int64)
        of_unit[self.surfaces.unit] = part
        found = np.maximum(self._constancy(of_unit, int(part.max(initial=-1)) + 1), 0.0)
        return np.append(found, 0.0)[of_unit]

    def _lamps(self, of_part: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(U,) lamp that each unit belongs to if it emits, -1 without, and the probability of each lamp."""
        constant = np.zeros(self.units) if of_part is None else of_part
        units = np.flatnonzero(self.mean + constant > 0.0)
        lamp = np.full(self.units, -1, np.int64)
        lamp[units] = self._connected(units)
        count = int(lamp.max(initial=-1)) + 1
        samples, evidence = (
            np.bincount(lamp[units], each[units], count) for each in (self.samples, self.evidence)
        )
        constant = np.zeros(count)
        if of_part is None:
            constant = self._constancy(lamp, count)
        else:
            constant[lamp[units]] = of_part[units]
        total = evidence / (1.0 + samples / self.surfaces.most_samples) + constant
        odds = np.exp(-np.clip(total + logit(PRIOR), -50.0, 50.0))
        if self.surfaces.unseen is not None:  # what a hidden lamp lights is not of one radiance, either
            area, close = (np.bincount(lamp[units], a[units], count) for a in (self.area, self.unseen))
            share = close / np.maximum(area, 1e-12)
            odds += HIDDEN * np.minimum(share / MUCH_UNSEEN, 1.0) * np.exp(-np.clip(constant, 0.0, 50.0))
        return lamp, 1.0 / (1.0 + odds)

    def _connected(self, units: np.ndarray) -> np.ndarray:
        """(n,) int64 from 0: connected surface of each of the units (n,).

        There may be gaps between patches of a scan, and unseen triangles between those of a modelled room.
        """
        count = len(units)
        if self.corners is None:
            tree = cKDTree(self.centers[units])
            pairs = tree.query_pairs(self.surfaces.gap, output_type="ndarray")
        else:
            units = np.append(units, np.flatnonzero(self.samples == 0.0))
            corners = self.corners[units]  # a unit is a triangle
            order = np.argsort(corners.reshape(-1), kind="stable")
            same = np.flatnonzero(np.diff(corners.reshape(-1)[order]) == 0)
            pairs = np.stack([order[same], order[same + 1]], axis=1) // 3
        component = self.component[units]
        pairs = pairs[component[pairs[:, 0]] == component[pairs[:, 1]]]
        return np.unique(graph_components(pairs, len(units))[:count], return_inverse=True)[1]

    def _extended(self, lamp: np.ndarray, of_lamp: np.ndarray) -> np.ndarray:
        """(U,) probability, with lamps extended over adjacent units of the same radiance."""
        result = np.append(of_lamp, 0.0)[lamp]
        for index in np.flatnonzero(of_lamp > POSSIBLE) if self.hdr else ():
            core = lamp == index
            radiance = np.median(self.radiance[core])
            off = np.log(np.maximum(self.radiance, 1e-12) / radiance) / ALIKE
            alike = np.exp(-0.5 * off**2) / (ALIKE * np.sqrt(2.0 * np.pi))
            known = self.mean + np.log(0.5 + 0.5 * alike * (BRIGHTEST + 1.0 / DIM_POWER))
            of_surface = self.component == self.component[np.argmax(core)]
            units = np.flatnonzero(core | ((known > 0.0) & of_surface & (np.abs(off) < MAX_OFF)))
            surface = self._connected(units)
            touching = units[np.isin(surface, surface[core[units]])]
            result[touching] = np.maximum(result[touching], of_lamp[index])
        return result

    def _added_light(self, probability: np.ndarray, baked: np.ndarray) -> np.ndarray:
        """(U,) luminance of brighter lamps that the shadings may lack.

        For lamps whose radiance was baked it is the error due to their position, for others all their light.
        """
        edge, added = self.surfaces.place, np.zeros(self.units)
        units = np.flatnonzero(probability > POSSIBLE)
        power = (probability * self.area * self.radiance)[units]
        for start in range(0, len(units), CHUNK):
            lit = units[start : start + CHUNK]
            toward = self.centers[units][None] - self.centers[lit][:, None]
            squared = np.maximum((toward**2).sum(axis=2), edge**2)
            distance = np.sqrt(squared)
            least = np.minimum(edge / distance, 1.0)
            arriving, leaving = (
                np.maximum(np.einsum("ijk,ijk->ij", toward, normals) / distance, least)
                for normals in (
                    np.broadcast_to(self.normals[lit][:, None], toward.shape),
                    np.broadcast_to(-self.normals[units][None], toward.shape),
                )
            )
            doubt = leaving * np.minimum(PLACE_ERROR * edge / distance, 1.0)
            share = np.where(baked[units], doubt, 1.0)
            brighter = self.radiance[units] > LIT * self.radiance[lit, None]
            added[lit] = (brighter * share * arriving / squared) @ power / np.pi
        return added
