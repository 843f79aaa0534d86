# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Roughness and metallic of each part, from how the appearance of its surface changes between views.

For each candidate pair, the base colours have a closed form (projection.py), and the residuals that remain
are its cost. The costs allow for the errors of the shadings: these are correlated within a view, a pixel's
own L_d is noisier than the mean over views, and the strength of a dielectric's gloss is fixed. candidates.py
derives roughness and metallic from the costs.

"Group" stands for a part, or for the group in its place where no parts are known (groups.py).
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from ..optics.factorised import color_line
from ..scene.grouped import grouped_median
from .candidates import IMPOSSIBLE_COST, choose_materials, roughness_log_prior, with_similar_groups
from .pixel_samples import PixelSamples
from .projection import cells_of_groups, fit_colors, residual_weight

# A surface is metal or not. Values in between would only reduce the 4 % of dielectrics where shadings are
# wrong.
METALLIC_CANDIDATES = (0.0, 1.0)
# Weight of |1 - sigma| + |m| (Eq. 17) in a candidate's cost, as a multiple of lambda_diffuse, the weight of
# the same term in training. It is the amount by which the cost of a specular surface must be below that of a
# diffuse one. The units differ: the cost here is a mean of log(1 + r^2 / s^2), where r is a pixel's relative
# residual and s^2 the median r^2 of the group's diffuse fit; the training loss is a squared difference of
# tone-mapped radiance.
DIFFUSE_FACTOR = 8.0
# Difference in cost at which one candidate is e times as likely as another, in a group of many pixels. Where
# two candidates are possible the group takes their mean: being half wrong costs a quarter, and the result
# does not flip from run to run.
COST_SCALE = 0.003
# About so many neighbouring pixels share their errors and count as one sample: the cost of a small group is
# less certain.
PIXELS_PER_SAMPLE = 6.0
# Number of standard errors by which a gain over the diffuse candidate is reduced. Not used where similar
# groups exist, which tell gloss from chance.
CAUTION = 0.35
# Gloss of a dielectric has a fixed strength. If gloss so many times as strong fits better still, it is an
# error of the shadings that looks like gloss.
OVERDONE_GLOSS = 2.5
# Distance between the roughness candidates, in levels.
STEP = 0.25


def group_materials(
    samples: PixelSamples,
    light_cell: np.ndarray,
    lambda_diffuse: float,
    similarity: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Roughness and metallic of each group: those with which its cells look most alike in all views.

    Each candidate is fitted with the pixel's own L_d and with the mean L_d over all views of its light cell,
    and the higher cost counts. The former is noisy and, near lamps, has errors that whole views share; the
    latter blurs folds and shadows.

    Args:
        samples: N pixels; radiance and shadings are best averaged over small windows
            (:func:`.pixel_samples.window_means`), because sharp lobes are noisier than wide ones. Cells are
            large enough that several views see them; pixels without a group are ignored.
        light_cell: (N,) int from 0, cell of one slope on which the same light falls.
        lambda_diffuse: the setting, weight of l_d in training (Eq. 17).
        similarity: (groups, groups) prior probability that two groups are of one material
            (:func:`.groups.similarity`); None where each group is known to be one material of its own.

    Returns:
        (groups,) float32 each.
    """
    group, levels = samples.group, samples.levels
    groups = int(group.max(initial=-1)) + 1
    if not groups:
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    mean_diffuse = _means(samples.diffuse, cells_of_groups(light_cell, group))
    caution = CAUTION if similarity is None else 0.0
    fits = [
        _CandidateFit(replace(samples, diffuse=light), caution) for light in (samples.diffuse, mean_diffuse)
    ]

    def cost_of(specular: np.ndarray, metallic: float) -> np.ndarray:
        """(groups,) cost with specular shadings (N, 2, 3), the higher of the two fits; each has a thread."""
        with ThreadPoolExecutor(len(fits)) as threads:
            return np.max(list(threads.map(lambda fit: fit.cost(specular, metallic), fits)), axis=0)

    diffuse_weight = DIFFUSE_FACTOR * lambda_diffuse
    places = np.arange(0.0, len(levels) - 1.0 + STEP, STEP)
    roughness = np.interp(places, np.arange(len(levels)), levels)
    costs = np.empty((len(METALLIC_CANDIDATES), len(places), groups))
    for k, place in enumerate(places):
        specular = _between_levels(samples.specular, np.full(len(group), place))
        for j, metallic in enumerate(METALLIC_CANDIDATES):
            costs[j, k] = cost_of(specular, metallic) + diffuse_weight * ((1.0 - roughness[k]) + metallic)
    costs[0, -1] = IMPOSSIBLE_COST  # the diffuse candidate, with which the others are compared
    count = fits[0].count
    scale = COST_SCALE + PIXELS_PER_SAMPLE / count.clip(1)
    log_prior = roughness_log_prior(costs, roughness, scale)
    best = (costs[0] - scale * log_prior[:, None]).argmin(axis=0)
    specular = _between_levels(samples.specular, places[best][np.maximum(group, 0)])
    roughest = samples.specular[:, -1]
    overdone = cost_of(roughest + OVERDONE_GLOSS * (specular - roughest), 0.0) < cost_of(specular, 0.0)
    costs[0, :, overdone] = np.maximum(costs[0, :, overdone], 0.0)  # at most as likely as none
    if similarity is not None:
        costs = with_similar_groups(costs, roughness, scale, count, similarity)
    return choose_materials(costs, roughness, scale)


def _between_levels(specular: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(N, 2, 3) L_s0 and L_s1 at places (N,) among the levels of `specular` (N, K, 2, 3): Eq. 8."""
    low = np.minimum(place.astype(int), specular.shape[1] - 2)
    share = (place - low).astype(np.float32)[:, None, None]
    rows = np.arange(len(place))
    return (1.0 - share) * specular[rows, low] + share * specular[rows, low + 1]


def _means(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(N, 3) float32 for each row of values (N, 3) the mean of all rows with its index (N,)."""
    count = np.bincount(index)
    means = [np.bincount(index, column) / np.maximum(count, 1) for column in values.T]
    return np.stack(means, axis=1)[index].astype(np.float32)


class _CandidateFit:
    """How well candidates explain the pixels of each group, compared with a diffuse surface.

    Attributes:
        count: (groups,) number of pixels used: those with a group that do not have their cell to themselves.
    """

    def __init__(self, samples: PixelSamples, caution: float) -> None:
        self._radiance, self._diffuse, self._caution = samples.radiance, samples.diffuse, caution
        self._cell = cells_of_groups(samples.cell, samples.group)
        shared = np.bincount(self._cell)[self._cell] > 1  # any candidate fits a cell of one pixel
        self._used = (samples.group >= 0) & shared
        self._groups = int(samples.group.max()) + 1
        self._views = int(samples.view.max(initial=-1)) + 1
        self._group = samples.group[self._used]
        self._group_view = self._group.astype(np.int64) * self._views + samples.view[self._used]
        self._pixels = self._sums(np.ones(len(self._group)))
        self.count = self._pixels.sum(axis=1)
        self._weight = residual_weight(samples.radiance)
        self._diffuse_fit = self._fit(samples.specular[:, -1], 0.0)
        squared = self._squared(self._diffuse_fit)
        scale = np.maximum(grouped_median(squared, self._group, self._groups, "high"), 1e-12)
        self._scale = scale[self._group]
        self._diffuse_cost = np.log1p(squared / self._scale)

    def _fit(self, specular: np.ndarray, metallic: float) -> np.ndarray:
        """(N, 3) radiance of a candidate with the best base colours."""
        slope, offset = color_line(self._diffuse, specular[:, 0], specular[:, 1], metallic)
        color = fit_colors(self._radiance, slope, offset, self._weight, self._cell)
        return offset + color[self._cell] * slope

    def _squared(self, fitted: np.ndarray) -> np.ndarray:
        """(n,) squared relative residual of the used pixels."""
        return ((self._radiance - fitted) ** 2 * self._weight).mean(axis=1)[self._used]

    def cost(self, specular: np.ndarray, metallic: float) -> np.ndarray:
        """(groups,) mean robust cost of a candidate minus the diffuse one's, plus `caution` standard errors.

        Errors of the shadings are correlated within a view, so the views are the independent samples. There
        are two upper bounds of a gain's standard error, and the lower one counts: the spread of the gains
        over the views, which also contains how much gloss each view shows, and the pull of each view's
        residuals on the strength of the gloss, which ignores that the cost is robust.

        Args:
            specular: (N, 2, 3) L_s0 and L_s1 of the candidate.
        """
        fitted = self._fit(specular, metallic)
        squared = self._squared(fitted)
        # Cauchy's cost: some of the pixels (edges, stray shadings) never follow the model.
        gains = self._sums(np.log1p(squared / self._scale) - self._diffuse_cost)
        gain = gains.sum(axis=1)
        deviation = gains - self._pixels * (gain / self.count.clip(1))[:, None]
        gloss, residual = fitted - self._diffuse_fit, self._radiance - fitted
        weight = 2.0 / (self._scale + squared)
        pull = self._sums(weight * (self._weight * gloss * residual).mean(axis=1)[self._used])
        curvature = self._sums(weight * (self._weight * gloss * gloss).mean(axis=1)[self._used])
        strength = pull.sum(axis=1) / np.maximum(curvature.sum(axis=1), 1e-12)
        error = np.minimum(
            _root_sum_of_squares(pull - strength[:, None] * curvature), _root_sum_of_squares(deviation)
        )
        return (gain + self._caution * error) / self.count.clip(1)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """(groups, views) sums of values (n,) of the used pixels."""
        size = self._groups * self._views
        return np.bincount(self._group_view, values, minlength=size).reshape(self._groups, self._views)


def _root_sum_of_squares(values: np.ndarray) -> np.ndarray:
    """(groups,) over the views of values (groups, views)."""
    return np.sqrt((values**2).sum(axis=1))
