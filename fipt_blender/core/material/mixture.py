"""Roughness and metallic of each group of pixels: a mixture over materials with a prior learnt from the room.

A group stands for a part, or for the surfaces in its place where no parts are known (groups.py). Each has one
of the materials of :func:`.likelihood.make_candidates`. The priors are nested: all materials, the room, and
the groups of one class and colour (Dirichlet distributions); expectation maximisation finds them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from ..pixels.grouped import rows_of_groups
from ..run.stage_settings import MaterialSettings
from .confidence import UNIFORM_DEVIATION
from .groups import SIMILAR_COLOR, TELLING_PIXELS, stops
from .hints import KnownMaterials
from .likelihood import Candidates, group_log_likelihoods, make_candidates
from .pixel_samples import PixelSamples
from .projection import fit_colors

# Standard deviation of the kernel by which the roughness of one group makes similar values likely for others:
# errors of the shadings shift the roughness of groups of one material by about so much.
ROUGHNESS_WIDTH = 0.05
# Logarithm of the prior odds that regions of different colour on one surface have one gloss: most are
# patterns.
SAME_SURFACE = 5.0
# Iterations of the expectation maximisation; it changes posterior means by less than 0.01 after ten.
ITERATIONS = 20


@dataclass(frozen=True)
class GroupMaterials:
    """Roughness and metallic of each of G groups.

    Attributes:
        mean: (G, 2) float32 posterior mean.
        error: (G, 2) float32 posterior standard deviation.
    """

    mean: np.ndarray
    error: np.ndarray

    @property
    def of_pixels(self) -> np.ndarray:
        """(G + 1, 2) the means; the last row, at -1, is of pixels without a group, which are diffuse."""
        return np.append(self.mean, [[1.0, 0.0]], axis=0)


def infer_materials(
    samples: PixelSamples,
    groups: int,
    light_cell: np.ndarray,
    settings: MaterialSettings,
    places: np.ndarray | None = None,
    known: KnownMaterials | None = None,
) -> GroupMaterials:
    """Roughness and metallic of each group: those with which its cells look most alike in all views.

    Args:
        samples: N pixels; radiance and shadings are best averaged over small windows
            (:func:`.pixel_samples.window_means`), because sharp lobes are noisier than wide ones. Cells are
            large enough that several views see them; pixels without a group are ignored.
        groups: their number; those without pixels have the room's distribution.
        light_cell: (N,) int from 0, cell of one slope on which the same light falls.
        settings: `residual_degrees`, `pixels_per_sample`, `view_error`, `view_outliers`, `prior_weight`.
        places: (2, groups) int, of each group its semantic class (a constant where there is none) and the
            surface of which it is a region; None where each group is known to be one material of its own.
        known: what is known of the groups; None for nothing.
    """
    candidates = make_candidates(samples.levels)
    broad = broad_prior(candidates)
    known = known or KnownMaterials.none(groups)
    found = group_log_likelihoods(samples, groups, light_cell, broad, settings)
    same = known.same if places is None else joined_groups(found, broad, places[1], known.same)
    # Groups of one material count as one.
    lowest, member = np.unique(same, return_inverse=True)
    likelihood = np.zeros((len(broad), len(lowest)))
    np.add.at(likelihood.T, member.reshape(-1), found.T)
    alike = None
    if places is not None:
        grouped = np.flatnonzero(samples.group >= 0)
        joined = samples.take(grouped, group=member.reshape(-1)[samples.group[grouped]])
        alike = similarity(joined, places[0, lowest])
    allowed = known.allows(candidates.roughness, candidates.metallic)[:, lowest]
    prior = Prior(broad, settings.prior_weight, alike)
    posterior = group_posterior(likelihood, candidates, prior, allowed)
    values = np.stack([candidates.roughness, candidates.metallic])
    mean = (values @ posterior).T
    error = np.sqrt(np.maximum((values**2 @ posterior).T - mean**2, 0.0))
    mean, error = mean[member.reshape(-1)], error[member.reshape(-1)]
    # The candidates next to a narrow range are allowed, too.
    low, high = np.stack([known.roughness, known.metallic], axis=1).transpose(2, 0, 1)
    mean, error = np.clip(mean, low, high), np.minimum(error, (high - low) * UNIFORM_DEVIATION)
    return GroupMaterials(mean.astype(np.float32), error.astype(np.float32))


def broad_prior(candidates: Candidates) -> np.ndarray:
    """(S,) prior before anything of a room is known: diffuse, or anything else, with equal probability."""
    half = len(candidates.roughness) // 2
    prior = 0.25 * np.tile(np.gradient(candidates.roughness[:half]), 2) / np.ptp(candidates.roughness)
    prior[half - 1] += 0.5
    return prior / prior.sum()


@dataclass(frozen=True)
class Prior:
    """What a group's material is expected to be before its pixels are looked at.

    Attributes:
        broad: (S,) prior of the room's distribution.
        weight: of a prior, as a number of groups.
        similarity: (groups, groups) of :func:`similarity`; None where groups are not alike.
    """

    broad: np.ndarray
    weight: float
    similarity: np.ndarray | None = None


def group_posterior(
    log_likelihood: np.ndarray,
    candidates: Candidates,
    prior: Prior,
    allowed: np.ndarray | bool = True,
) -> np.ndarray:
    """(S, groups) probability of each candidate.

    Args:
        log_likelihood: (S, groups); all 0 in groups that no pixel shows, which do not count for the room.
        allowed: (S, groups) bool, candidates that are possible, one at least of each group; True for all.
    """
    broad, weight = prior.broad, prior.weight
    shown = (log_likelihood != 0.0).any(axis=0)
    log_likelihood = np.where(allowed, log_likelihood, -np.inf)
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=0))
    kernel = _kernel(candidates)
    others = None
    if prior.similarity is not None:
        others = prior.similarity * shown
        np.fill_diagonal(others, 0.0)  # a group's own pixels are its likelihood
    expected = np.repeat(broad[:, None], len(shown), axis=1)
    for _ in range(ITERATIONS):
        posterior = likelihood * expected
        posterior /= posterior.sum(axis=0)
        counts = kernel @ posterior
        room = (counts @ shown + weight * broad) / (shown.sum() + weight)
        expected = np.repeat(room[:, None], len(shown), axis=1)
        if others is not None:
            expected = (counts @ others.T + weight * expected) / (others.sum(axis=1) + weight)
    posterior = likelihood * expected
    return posterior / posterior.sum(axis=0)


def joined_groups(
    log_likelihood: np.ndarray, prior: np.ndarray, surface: np.ndarray, same: np.ndarray
) -> np.ndarray:
    """(G,) int as `same` (G,), the lowest group that has the same material, with groups of a surface joined.

    Two groups join as long as one gloss is more probable than two, the most probable ones first.

    Args:
        log_likelihood: (S, G). prior: (S,). surface: (G,) int.
    """
    result, log_prior = same.copy(), np.log(prior)
    for members in rows_of_groups(surface, int(surface.max(initial=-1)) + 1):
        rows = np.unique(same[members])
        if len(rows) < 2:
            continue
        joint = log_likelihood[:, rows].T + log_prior
        evidence = logsumexp(joint, axis=1)
        odds = np.array([_odds(joint, evidence, log_prior, row) for row in range(len(rows))])
        while odds.max() > 0.0:
            one, other = sorted(map(int, np.unravel_index(odds.argmax(), odds.shape)))
            result[np.isin(result, rows[other])] = rows[one]
            joint[one] += joint[other] - log_prior
            evidence[one], evidence[other] = logsumexp(joint[one]), np.inf
            odds[other], odds[:, other] = -np.inf, -np.inf
            odds[one] = odds[:, one] = _odds(joint, evidence, log_prior, one)
    return result


def _odds(joint: np.ndarray, evidence: np.ndarray, log_prior: np.ndarray, row: int) -> np.ndarray:
    """(G,) logarithm of the posterior odds that group `row` and each other one have one gloss.

    Args:
        joint: (G, S) logarithm of prior times likelihood. evidence: (G,) of its sum. log_prior: (S,).
    """
    odds = logsumexp(joint + joint[row] - log_prior, axis=1) - evidence - evidence[row] + SAME_SURFACE
    odds[row] = -np.inf
    return np.asarray(odds)


def similarity(samples: PixelSamples, label: np.ndarray) -> np.ndarray:
    """(G, G) weight of groups (columns) in what each group is expected to be: of one class and base colour.

    Args:
        samples: pixels of G groups, all with one. label: (G,) int semantic class of each.
    """
    group, offset = samples.group, np.zeros_like(samples.diffuse)
    color, pixels = np.zeros((len(label), 3)), np.bincount(group, samples.weight, minlength=len(label))
    found = fit_colors(samples.radiance, samples.diffuse, offset, samples.square_weight, group)
    color[: len(found)] = found
    squared = sum((column[:, None] - column) ** 2 for column in stops(color).T) / 3.0
    alike = np.exp(-0.5 * squared / SIMILAR_COLOR**2) * (label[:, None] == label)
    return np.asarray(alike * np.minimum(pixels / TELLING_PIXELS, 1.0))


def _kernel(candidates: Candidates) -> np.ndarray:
    """(S, S) share of a group's material (column) that counts for each material (row) in the others' prior.

    Similar roughness of the same metallic is one material; diffuse is only diffuse.
    """
    difference = candidates.roughness[:, None] - candidates.roughness
    kernel = np.exp(-0.5 * (difference / ROUGHNESS_WIDTH) ** 2)
    kernel *= candidates.metallic[:, None] == candidates.metallic
    diffuse = len(candidates.roughness) // 2 - 1
    kernel[:, diffuse] = np.arange(len(kernel)) == diffuse
    return kernel / kernel.sum(axis=0)
