# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Roughness and metallic of each group of pixels: a mixture over materials with a prior learnt from the room.

A group stands for a part, or for the surfaces in its place where no parts are known (groups.py). Each has one
of the materials of :func:`.likelihood.make_candidates`. The priors are nested: all materials, the room, and
the groups of one class and colour (Dirichlet distributions); expectation maximisation finds them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.settings import Settings
from .confidence import UNIFORM_DEVIATION
from .hints import KnownMaterials
from .likelihood import Candidates, group_log_likelihoods, make_candidates
from .pixel_samples import PixelSamples

# Standard deviation of the kernel by which the roughness of one group makes similar values likely for others:
# errors of the shadings shift the roughness of groups of one material by about so much.
ROUGHNESS_WIDTH = 0.05
# Iterations of the expectation maximisation; it changes posterior means by less than 0.01 after ten.
ITERATIONS = 20


@dataclass(frozen=True)
class GroupMaterials:
    """Posterior mean of each of G groups, and its standard deviation; (G,) float32 each."""

    roughness: np.ndarray
    metallic: np.ndarray
    roughness_error: np.ndarray
    metallic_error: np.ndarray

    def padded(self, groups: int) -> GroupMaterials:
        """So many groups: those without a sampled pixel, at the end, are diffuse."""
        missing = max(groups - len(self.roughness), 0)
        filling = (1.0, 0.0, UNIFORM_DEVIATION, UNIFORM_DEVIATION)
        values = (self.roughness, self.metallic, self.roughness_error, self.metallic_error)
        return GroupMaterials(
            *(np.pad(of, (0, missing), constant_values=to) for of, to in zip(values, filling, strict=True))
        )

    def within(self, known: KnownMaterials) -> GroupMaterials:
        """With values within what is known, the same in groups of one material."""
        moments = []
        for mean, error, bounds in (
            (self.roughness, self.roughness_error, known.roughness),
            (self.metallic, self.metallic_error, known.metallic),
        ):
            low, high = bounds.T.astype(np.float32)
            mean, error = mean[known.same], error[known.same]
            moments.append((np.clip(mean, low, high), np.minimum(error, (high - low) * UNIFORM_DEVIATION)))
        (roughness, roughness_error), (metallic, metallic_error) = moments
        return GroupMaterials(roughness, metallic, roughness_error, metallic_error)


def infer_materials(
    samples: PixelSamples,
    light_cell: np.ndarray,
    settings: Settings,
    similarity: np.ndarray | None = None,
    known: KnownMaterials | None = None,
) -> GroupMaterials:
    """Roughness and metallic of each group: those with which its cells look most alike in all views.

    Args:
        samples: N pixels; radiance and shadings are best averaged over small windows
            (:func:`.pixel_samples.window_means`), because sharp lobes are noisier than wide ones. Cells are
            large enough that several views see them; pixels without a group are ignored.
        light_cell: (N,) int from 0, cell of one slope on which the same light falls.
        settings: `residual_degrees`, `pixels_per_sample`, `view_error`, `view_outliers`, `prior_weight`.
        similarity: (groups, groups) prior probability that two groups are of one material
            (:func:`.groups.similarity`); None where each group is known to be one material of its own.
        known: what is known of the groups, of all that have pixels at least; None for nothing.
    """
    candidates = make_candidates(samples.levels)
    broad = broad_prior(candidates)
    likelihood = group_log_likelihoods(samples, light_cell, broad, settings)
    if known is None:
        posterior = group_posterior(likelihood, candidates, broad, settings.prior_weight, similarity)
    else:
        known = known.first(likelihood.shape[1])
        posterior = _known_posterior(likelihood, candidates, settings.prior_weight, similarity, known)
    moments = []
    for values in (candidates.roughness, candidates.metallic):
        mean = values @ posterior
        moments.append((mean, np.sqrt(np.maximum(values**2 @ posterior - mean**2, 0.0))))
    (roughness, roughness_error), (metallic, metallic_error) = moments
    result = roughness, metallic, roughness_error, metallic_error
    return GroupMaterials(*(values.astype(np.float32) for values in result))


def _known_posterior(
    log_likelihood: np.ndarray,
    candidates: Candidates,
    weight: float,
    similarity: np.ndarray | None,
    known: KnownMaterials,
) -> np.ndarray:
    """:func:`group_posterior` where something is known: groups of one material count as one."""
    lowest, member = np.unique(known.same, return_inverse=True)
    joint = np.zeros((len(log_likelihood), len(lowest)))
    np.add.at(joint.T, member.reshape(-1), log_likelihood.T)
    alike = None if similarity is None else similarity[np.ix_(lowest, lowest)]
    allowed = known.allows(candidates.roughness, candidates.metallic)[:, lowest]
    broad = broad_prior(candidates)
    return group_posterior(joint, candidates, broad, weight, alike, allowed)[:, member.reshape(-1)]


def broad_prior(candidates: Candidates) -> np.ndarray:
    """(S,) prior before anything of a room is known: diffuse, or anything else, with equal probability."""
    half = len(candidates.roughness) // 2
    prior = 0.25 * np.tile(np.gradient(candidates.roughness[:half]), 2) / np.ptp(candidates.roughness)
    prior[half - 1] += 0.5
    return prior / prior.sum()


def group_posterior(
    log_likelihood: np.ndarray,
    candidates: Candidates,
    broad: np.ndarray,
    weight: float,
    similarity: np.ndarray | None = None,
    allowed: np.ndarray | None = None,
) -> np.ndarray:
    """(S, groups) probability of each candidate.

    Args:
        log_likelihood: (S, groups); all 0 in groups that no pixel shows, which do not count for the room.
        broad: (S,) prior of the room's distribution.
        weight: of a prior, as a number of groups.
        similarity: as in :func:`infer_materials`.
        allowed: (S, groups) bool, candidates that are possible, one at least of each group; None for all.
    """
    shown = (log_likelihood != 0.0).any(axis=0)
    if allowed is not None:
        log_likelihood = np.where(allowed, log_likelihood, -np.inf)
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=0))
    kernel = _kernel(candidates)
    others = None
    if similarity is not None:
        others = similarity * shown
        np.fill_diagonal(others, 0.0)  # a group's own pixels are its likelihood
    prior = np.repeat(broad[:, None], len(shown), axis=1)
    for _ in range(ITERATIONS):
        posterior = likelihood * prior
        posterior /= posterior.sum(axis=0)
        counts = kernel @ posterior
        room = (counts @ shown + weight * broad) / (shown.sum() + weight)
        prior = np.repeat(room[:, None], len(shown), axis=1)
        if others is not None:
            prior = (counts @ others.T + weight * prior) / (others.sum(axis=1) + weight)
    posterior = likelihood * prior
    return posterior / posterior.sum(axis=0)


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
