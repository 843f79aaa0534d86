# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How rough and how metallic each part is, told by how its surface changes from view to view.

Each candidate pair has a closed form for the base colours (projection.py). What is left unexplained decides,
with what is known of the shadings' errors: they are alike within a view, L_d is noisier than its neighbours
from other views, and a dielectric's gloss has a strength of its own.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from .projection import DARK, cells_of_parts, fit_colors, line

# A part is metal or not. Values between would only lower the 4 % of dielectrics where shadings are wrong.
METALLIC_CANDIDATES = (0.0, 1.0)
# How much the robust cost of a specular surface must be below that of a diffuse one: the l_d of Eq. 14.
DIFFUSE_PRIOR = 0.004
# Gain at which one candidate is e times as likely as another, where pixels are many. Where both are possible
# the part takes the mean of both: half wrong costs a quarter, and a part does not flip from run to run.
EVIDENCE = 0.003
# About so many neighbouring pixels share their errors and are one sample: small parts' evidence counts less.
PIXELS_OF_SAMPLE = 6.0
LEAST_LIKELY = 0.1
# Standard errors by which a gain over the diffuse candidate is discounted; kin, where there are any, tell
# gloss from chance.
CAUTION = 0.35
# The gloss of a dielectric has a fixed strength. Where so many times as much explains a part still better, it
# is an error of the shadings that looks like gloss.
OVERDONE_GLOSS = 2.5
IMPOSSIBLE = 100.0
# Step between levels at which roughness is tried.
STEP = 0.25
# How far apart two parts' roughness counts as alike, the least log-likelihood of unusual ones, and rounds in
# which parts learn of each other.
ROUGHNESS_WIDTH = 0.1
LEAST_USUAL = -3.0
ROUNDS = 5
# Kin (groups.py) learn of each other in so many rounds, the least log-likelihood among them is this, and any
# other material is as likely as a share of a group like the room's middle one.
KIN_ROUNDS = 20
LEAST_KIN = -6.0
STRANGER = 0.1
# What differs between kin of one material are errors of the shadings, alike over a whole piece. So they are
# larger than its pixels tell, so many times, and a large piece is heard like one of about so many pixels.
KIN_ERROR = 1.5
KIN_PIXELS = 300.0


def part_materials(
    radiance: np.ndarray,
    diffuse: np.ndarray,
    specular: np.ndarray,
    levels: np.ndarray,
    cell: np.ndarray,
    spot: np.ndarray,
    part: np.ndarray,
    view: np.ndarray,
    kin: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Roughness and metallic of each part: those with which its surface cells look most alike in all views.

    Gloss must show with each pixel's own L_d as well as with the mean over all views of its spot. The one is
    noisy, and alike over whole views where lamps are near; the other blurs folds and shadows.

    Args:
        radiance: (N, 3) photographed radiance, in units of the capture's median.
        diffuse: (N, 3) L_d.
        specular: (N, K, 2, 3) L_s0 and L_s1 at `levels`. All three are best smoothed over neighbours of one
            part (:func:`projection.window_means`): sharp lobes carry more noise than wide ones.
        levels: (K,) roughness.
        cell: (N,) int piece of surface of one base colour, large enough that several views see it.
        spot: (N,) int piece of surface that the same light falls on, at the same slope.
        part: (N,) int part of each pixel, negative without: those are passed over.
        view: (N,) int view of each pixel.
        kin: (parts, parts) how likely two parts are of one material beforehand (:func:`groups.kinship`); None
            where each part is known to be one of its own.

    Returns:
        (parts,) float32 each.
    """
    parts = int(part.max(initial=-1)) + 1
    if not parts:
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    lights = (diffuse, _means(diffuse, cells_of_parts(spot, part)))
    caution = CAUTION if kin is None else 0.0
    trials = [_Trial(radiance, light, specular[:, -1], cell, part, view, caution) for light in lights]

    def weigh(value: np.ndarray, metallic: float) -> np.ndarray:
        """(parts,) cost of specular shading (N, 2, 3), the worse of the two ways; each has a thread."""
        with ThreadPoolExecutor(len(trials)) as threads:
            return np.max(list(threads.map(lambda trial: trial.cost(value, metallic), trials)), axis=0)

    places = np.arange(0.0, len(levels) - 1.0 + STEP, STEP)
    roughness = np.interp(places, np.arange(len(levels)), levels)
    costs = np.empty((len(METALLIC_CANDIDATES), len(places), parts))
    for k, place in enumerate(places):
        value = _between(specular, np.full(len(part), place))
        for j, metallic in enumerate(METALLIC_CANDIDATES):
            costs[j, k] = weigh(value, metallic) + DIFFUSE_PRIOR * ((1.0 - roughness[k]) + metallic)
    costs[0, -1] = IMPOSSIBLE  # the diffuse surface itself, with which all are compared
    scale = EVIDENCE + PIXELS_OF_SAMPLE / trials[0].count.clip(1)
    best = (costs[0] - scale * _usual_roughness(costs, roughness, scale)[:, None]).argmin(axis=0)
    value = _between(specular, places[best][np.maximum(part, 0)])
    more = weigh(specular[:, -1] + OVERDONE_GLOSS * (value - specular[:, -1]), 0.0)
    overdone = more < weigh(value, 0.0)
    costs[0, :, overdone] = np.maximum(costs[0, :, overdone], 0.0)  # even odds at best
    if kin is not None:
        costs = _as_kin_say(costs, roughness, scale, trials[0].count, kin)
    return _chosen(costs, roughness, scale)


def _chosen(costs: np.ndarray, roughness: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(parts,) float32 roughness and metallic each.

    Args:
        costs: (2, K, parts) of dielectrics and metals above the diffuse surface's.
        roughness: (K,) of the candidates.
        scale: (parts,) difference of costs at which one of two is e times as likely.
    """
    usual = _usual_roughness(costs, roughness, scale)
    best = (costs - scale * usual[None, :, None]).argmin(axis=1)
    lowest = np.take_along_axis(costs, best[:, None], axis=1)[:, 0]
    metallic = _likely(lowest[1] - lowest[0], scale)
    glossy = _likely(lowest.min(axis=0), scale)
    found = roughness[np.where(lowest[1] < lowest[0], best[1], best[0])]
    return (1.0 - glossy * (1.0 - found)).astype(np.float32), (glossy * metallic).astype(np.float32)


def _usual_roughness(costs: np.ndarray, roughness: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(K,) log of how usual each roughness is among the room's glossy parts, at most 0; arguments as above.

    A part whose gloss is plain but blurred by the shadings' errors, or too small to tell, takes a roughness
    that others have (empirical Bayes). Whether it is glossy at all is left to its own pixels.
    """
    width, kernel = np.gradient(roughness), _kernel(roughness)
    glossy = 1.0 / (1.0 + np.exp((costs.min(axis=(0, 1)) / scale).clip(-50.0, 50.0)))
    likelihood = np.exp(-((costs - costs.min(axis=(0, 1))) / scale).clip(0.0, 50.0)).sum(axis=0)
    usual = np.zeros(len(roughness))
    for _ in range(ROUNDS):
        share = likelihood * np.exp(usual)[:, None]
        share *= glossy / share.sum(axis=0)
        density = (kernel @ share.sum(axis=1)) / width + 1.0  # as if one part more had any roughness
        usual = np.log(density / density.max()).clip(LEAST_USUAL, 0.0)
    return usual


def _kernel(roughness: np.ndarray) -> np.ndarray:
    """(K, K) by which a part of one roughness (column) speaks for others like it (rows)."""
    kernel = np.exp(-0.5 * ((roughness[:, None] - roughness) / ROUGHNESS_WIDTH) ** 2)
    return kernel / kernel.sum(axis=0)


def _as_kin_say(
    costs: np.ndarray, roughness: np.ndarray, scale: np.ndarray, count: np.ndarray, kin: np.ndarray
) -> np.ndarray:
    """Costs with what a part's kin say added, in the scale of its own; arguments as in :func:`_chosen`.

    Pieces of one class and colour are likely of one material, which those that show it plainly tell to the
    others (empirical Bayes). A part keeps a material of its own where its pixels are clear, and whether it is
    metal is left to them: of dark surfaces that is hard to tell, and kin would make a fact of a faint guess.

    Args:
        count: (parts,) pixels that speak for each.
        kin: (parts, parts) kinship.
    """
    scale = KIN_ERROR * scale
    voice = count / (1.0 + count / KIN_PIXELS)
    weight = kin * voice
    np.fill_diagonal(weight, 0.0)  # what it says itself is in its costs
    width, kernel = np.gradient(roughness), _kernel(roughness)
    width /= width.sum()
    # Diffuse, or of each roughness.
    states = np.concatenate([np.zeros((1, len(count))), costs.min(axis=0)])
    likelihood = np.exp(-((states - states.min(axis=0)) / scale).clip(0.0, 60.0))
    any_material = np.concatenate([[0.5], 0.5 * width])[:, None]
    strangers = STRANGER * max(float(np.median(voice)), 1.0)
    prior = np.repeat(any_material, len(count), axis=1)
    for _ in range(KIN_ROUNDS):
        share = likelihood * prior
        share /= share.sum(axis=0)
        share[1:] = kernel @ share[1:]
        prior = (share @ weight.T + strangers * any_material) / (weight.sum(axis=1) + strangers)
    # A gloss is as usual as all of its roughness together; which one, the density tells.
    density = prior[1:] / width[:, None]
    density *= prior[1:].sum(axis=0) / density.max(axis=0)
    usual = np.log(np.concatenate([prior[:1], density]))
    usual = (usual - usual.max(axis=0)).clip(LEAST_KIN)
    told = costs - scale * (usual[1:] - usual[0])
    told[0, -1] = IMPOSSIBLE
    return told


def _likely(cost: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(parts,) how likely a candidate is that costs so much more than another; 0 or 1 where that is clear."""
    likely = 1.0 / (1.0 + np.exp((cost / scale).clip(-50.0, 50.0)))
    likely = np.where(likely < LEAST_LIKELY, 0.0, likely)
    return np.where(likely > 1.0 - LEAST_LIKELY, 1.0, likely)


def _between(specular: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(N, 2, 3) L_s0 and L_s1 at places (N,) among the levels of `specular` (N, K, 2, 3)."""
    low = np.minimum(place.astype(int), specular.shape[1] - 2)
    share = (place - low).astype(np.float32)[:, None, None]
    rows = np.arange(len(place))
    return (1.0 - share) * specular[rows, low] + share * specular[rows, low + 1]


def _means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(N, 3) mean over each pixel's group."""
    count = np.bincount(group)
    means = [np.bincount(group, column) / np.maximum(count, 1) for column in values.T]
    return np.stack(means, axis=1)[group].astype(np.float32)


class _Trial:
    """How well candidates explain the parts' pixels, against a diffuse surface.

    Attributes:
        count: (parts,) pixels that say something.
    """

    def __init__(
        self,
        radiance: np.ndarray,
        diffuse: np.ndarray,
        roughest: np.ndarray,
        cell: np.ndarray,
        part: np.ndarray,
        view: np.ndarray,
        caution: float,
    ) -> None:
        self._radiance, self._diffuse, self._caution = radiance, diffuse, caution
        self._cell = cells_of_parts(cell, part)
        shared = np.bincount(self._cell)[self._cell] > 1  # a cell of one pixel fits everything
        self._counted = (part >= 0) & shared
        self._parts, self._views = int(part.max()) + 1, int(view.max(initial=-1)) + 1
        self._part = part[self._counted]
        self._group = self._part.astype(np.int64) * self._views + view[self._counted]
        self._pixels = self._sums(np.ones(len(self._part)))
        self.count = self._pixels.sum(axis=1)
        self._weight = 1.0 / (radiance + DARK) ** 2
        self._flat = self._fitted(roughest, 0.0)
        squared = self._squared(self._flat)
        self._scale = _median_by(self._part, squared, self._parts)[self._part]
        self._first = np.log1p(squared / self._scale)

    def _fitted(self, specular: np.ndarray, metallic: float) -> np.ndarray:
        """(N, 3) radiance of a candidate with the best base colours."""
        slope, offset = line(self._diffuse, specular, metallic)
        color = fit_colors(self._radiance, slope, offset, self._weight, self._cell)
        return offset + color[self._cell] * slope

    def _squared(self, fitted: np.ndarray) -> np.ndarray:
        """(n,) squared residual of the pixels that count, relative to their radiance."""
        return ((self._radiance - fitted) ** 2 * self._weight).mean(axis=1)[self._counted]

    def cost(self, specular: np.ndarray, metallic: float) -> np.ndarray:
        """(parts,) mean robust cost of a candidate above the diffuse one's, plus `caution` standard errors.

        Errors of shadings are alike all over a view, so the views are the independent samples. Both the
        spread of their gains and their residuals' pull on the gloss bound a gain's error from above: the one
        also spreads by how much gloss a view shows, the other forgets that the cost is robust.
        """
        fitted = self._fitted(specular, metallic)
        squared = self._squared(fitted)
        # Cauchy's cost: a part of the pixels (edges, stray shadings) never follows the model.
        gains = self._sums(np.log1p(squared / self._scale) - self._first)
        gain = gains.sum(axis=1)
        spread = gains - self._pixels * (gain / self.count.clip(1))[:, None]
        gloss, residual = fitted - self._flat, self._radiance - fitted
        weight = 2.0 / (self._scale + squared)
        pull = self._sums(weight * (self._weight * gloss * residual).mean(axis=1)[self._counted])
        hold = self._sums(weight * (self._weight * gloss * gloss).mean(axis=1)[self._counted])
        more = pull.sum(axis=1) / np.maximum(hold.sum(axis=1), 1e-12)
        error = np.minimum(_root_sum(pull - more[:, None] * hold), _root_sum(spread))
        return (gain + self._caution * error) / self.count.clip(1)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """(parts, views) sums of values (n,) of the pixels that count."""
        size = self._parts * self._views
        return np.bincount(self._group, values, minlength=size).reshape(self._parts, self._views)


def _root_sum(values: np.ndarray) -> np.ndarray:
    """(parts,) root of the sum of squares over views of values (parts, views)."""
    return np.sqrt((values**2).sum(axis=1))


def _median_by(group: np.ndarray, values: np.ndarray, groups: int) -> np.ndarray:
    """(groups,) median of the values of each group; 1 for empty groups."""
    order = np.lexsort((values, group))
    count = np.bincount(group, minlength=groups)
    first = np.cumsum(count) - count
    middle = np.minimum(first + count // 2, max(len(values) - 1, 0))
    medians = values[order][middle] if len(values) else np.ones(groups)
    return np.where(count > 0, np.maximum(medians, 1e-12), 1.0)
