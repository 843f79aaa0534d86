# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Roughness and metallic of each group from the costs of candidates (gloss.py), by empirical Bayes.

Costs are those of dielectrics and metals of K roughnesses minus that of a diffuse surface, (2, K, groups); a
candidate whose cost is lower by `scale` is e times as likely. Priors are learnt from the other groups of the
room.
"""

from __future__ import annotations

import numpy as np

# Cost of the diffuse surface in the array of costs: it is what the others are compared with.
IMPOSSIBLE_COST = 100.0
# Probabilities below this, and above one minus this, count as 0 and 1.
LEAST_PROBABILITY = 0.1
# Standard deviation of the kernel by which the roughness of one group supports similar values.
ROUGHNESS_WIDTH = 0.1
# Prior over the room's roughness: lowest log-probability relative to the mode, and iterations.
LEAST_LOG_PRIOR = -3.0
ITERATIONS = 5
# Prior among similar groups: the same, and the weight of a uniform prior over materials, as a multiple of the
# weight of a group of median size.
SIMILAR_LEAST_LOG_PRIOR = -6.0
SIMILAR_ITERATIONS = 20
UNIFORM_WEIGHT = 0.1
# Groups of one material differ by errors of the shadings that all pixels of a group share. These errors are
# SIMILAR_ERROR times as large as its pixels suggest, and the weight of a group is at most that of
# SIMILAR_PIXELS pixels.
SIMILAR_ERROR = 1.5
SIMILAR_PIXELS = 300.0


def choose_materials(
    costs: np.ndarray, roughness: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(groups,) float32 roughness and metallic: means over the best candidates, weighted by probability.

    Args:
        costs: (2, K, groups) of dielectrics and metals above the diffuse surface's.
        roughness: (K,) of the candidates.
        scale: (groups,) difference of costs at which one of two candidates is e times as likely.
    """
    log_prior = roughness_log_prior(costs, roughness, scale)
    best = (costs - scale * log_prior[None, :, None]).argmin(axis=1)
    lowest = np.take_along_axis(costs, best[:, None], axis=1)[:, 0]
    metallic = _probability(lowest[1] - lowest[0], scale)
    glossy = _probability(lowest.min(axis=0), scale)
    best_roughness = roughness[np.where(lowest[1] < lowest[0], best[1], best[0])]
    return (1.0 - glossy * (1.0 - best_roughness)).astype(np.float32), (glossy * metallic).astype(np.float32)


def roughness_log_prior(costs: np.ndarray, roughness: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(K,) log-density of roughness among the room's glossy groups, relative to its mode.

    A group whose gloss is certain but blurred by errors of the shadings, or too small to determine its
    roughness, takes a roughness that other groups have. Whether it is glossy is decided by its own pixels.

    Args:
        costs, roughness, scale: as in :func:`choose_materials`.
    """
    width, kernel = np.gradient(roughness), _kernel(roughness)
    glossy = 1.0 / (1.0 + np.exp((costs.min(axis=(0, 1)) / scale).clip(-50.0, 50.0)))
    likelihood = np.exp(-((costs - costs.min(axis=(0, 1))) / scale).clip(0.0, 50.0)).sum(axis=0)
    log_prior = np.zeros(len(roughness))
    for _ in range(ITERATIONS):
        posterior = likelihood * np.exp(log_prior)[:, None]
        posterior *= glossy / posterior.sum(axis=0)
        density = (kernel @ posterior.sum(axis=1)) / width + 1.0  # one further group, uniformly distributed
        log_prior = np.log(density / density.max()).clip(LEAST_LOG_PRIOR, 0.0)
    return log_prior


def _kernel(roughness: np.ndarray) -> np.ndarray:
    """(K, K) weight with which a group of one roughness (column) supports the others (rows)."""
    kernel = np.exp(-0.5 * ((roughness[:, None] - roughness) / ROUGHNESS_WIDTH) ** 2)
    return kernel / kernel.sum(axis=0)


def with_similar_groups(
    costs: np.ndarray, roughness: np.ndarray, scale: np.ndarray, count: np.ndarray, similarity: np.ndarray
) -> np.ndarray:
    """Costs with the log-prior that similar groups give; arguments as in :func:`choose_materials`.

    Groups of one class and colour are likely of one material, and the clear ones determine the prior of the
    others. A group keeps a different material if its own pixels are clear. Whether it is metal is decided by
    them alone: on dark surfaces that is hard to tell, and the prior would make a faint guess certain.

    Args:
        count: (groups,) number of pixels of each.
        similarity: (groups, groups) prior probability that two are of one material.
    """
    scale = SIMILAR_ERROR * scale
    pixel_weight = count / (1.0 + count / SIMILAR_PIXELS)
    weight = similarity * pixel_weight
    np.fill_diagonal(weight, 0.0)  # a group's own pixels are its likelihood
    width, kernel = np.gradient(roughness), _kernel(roughness)
    width /= width.sum()
    # States: diffuse, or glossy with each roughness.
    state_costs = np.concatenate([np.zeros((1, len(count))), costs.min(axis=0)])
    likelihood = np.exp(-((state_costs - state_costs.min(axis=0)) / scale).clip(0.0, 60.0))
    uniform = np.concatenate([[0.5], 0.5 * width])[:, None]
    uniform_weight = UNIFORM_WEIGHT * max(float(np.median(pixel_weight)), 1.0)
    prior = np.repeat(uniform, len(count), axis=1)
    for _ in range(SIMILAR_ITERATIONS):
        posterior = likelihood * prior
        posterior /= posterior.sum(axis=0)
        posterior[1:] = kernel @ posterior[1:]
        prior = (posterior @ weight.T + uniform_weight * uniform) / (weight.sum(axis=1) + uniform_weight)
    # The mode of the glossy states gets their total probability: the density only tells which roughness.
    density = prior[1:] / width[:, None]
    density *= prior[1:].sum(axis=0) / density.max(axis=0)
    log_prior = np.log(np.concatenate([prior[:1], density]))
    log_prior = (log_prior - log_prior.max(axis=0)).clip(SIMILAR_LEAST_LOG_PRIOR)
    result = costs - scale * (log_prior[1:] - log_prior[0])
    result[0, -1] = IMPOSSIBLE_COST
    return result


def _probability(cost: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(groups,) probability of a candidate of so much higher cost than another; 0 or 1 if clear."""
    probability = 1.0 / (1.0 + np.exp((cost / scale).clip(-50.0, 50.0)))
    probability = np.where(probability < LEAST_PROBABILITY, 0.0, probability)
    return np.where(probability > 1.0 - LEAST_PROBABILITY, 1.0, probability)
