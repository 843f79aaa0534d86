# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well each roughness, as dielectric or metal, explains the pixels of each group: robust log-likelihoods.

Base colours have a closed form for each candidate (projection.py). What then remains are errors of the
shadings, which neighbouring pixels and whole views share; docs/method.md states the model.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from ..optics.factorised import color_line, level_roughness
from ..run.settings import Settings
from ..run.threads import in_threads
from ..scene.grouped import grouped_sums, numbered
from .pixel_samples import PixelSamples, residual_weight
from .projection import fit_colors

# Distance between the candidates' roughness, in baked levels: the posterior is wider than half of it.
STEP = 0.25
# Median of a squared standard normal variable: variances follow from medians, which outliers hardly change.
MEDIAN_OF_SQUARE = 0.4549
# Share of the error that the pixels of a view have in common which may look like another material. All of it
# would gain as much in some rooms and lose in others.
VIEW_SHARE = 0.5
# Residuals of a view's mean, in standard deviations: outliers are no error of the view.
MOST_DEVIATIONS = 3.0
# Pixels of which the materials are compared at a time.
BLOCK = 1 << 13


@dataclass(frozen=True)
class Candidates:
    """The materials that are compared: K of every metallic; the last dielectric, of roughness 1, is diffuse.

    Attributes:
        place: (S,) position of each among the baked levels.
        roughness, metallic: (S,) of each; first all dielectrics, then all metals.
    """

    place: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray


def make_candidates(levels: np.ndarray) -> Candidates:
    """Dielectrics and metals every `STEP` of the roughness `levels` (K,)."""
    place = np.arange(0.0, len(levels) - 1.0 + STEP, STEP)
    low = np.minimum(place.astype(np.int64), len(levels) - 2)
    roughness = level_roughness(place - low, levels[low], levels[low + 1])
    return Candidates(np.tile(place, 2), np.tile(roughness, 2), np.repeat([0.0, 1.0], len(place)))


def group_log_likelihoods(
    samples: PixelSamples,
    groups: int,
    light_cell: np.ndarray,
    prior: np.ndarray,
    settings: Settings,
) -> np.ndarray:
    """(S, groups) log-likelihood of each candidate relative to the group's best; 0 in groups without pixels.

    The pixels of a group in one view, n by their weight, count as n / (`pixels_per_sample` + n t² / s²)
    samples, where s² is the variance of their residuals: a view's shadings err by t in any direction, so many
    pixels of one view tell no more than s² / t² samples. t is `VIEW_SHARE` of what the means of the views
    show (:func:`view_errors`), at least `view_error`. A share `view_outliers` of the views tells nothing.

    Args:
        samples: N pixels; those without a group, or alone in their cell, are left out: anything fits these.
        light_cell: (N,) int from 0, cell of one slope on which the same light falls in all views.
        prior: (S,) probability of each of :func:`make_candidates`, for views that tell nothing.
    """
    candidates = make_candidates(samples.levels)
    used, light_cell = _comparable(samples, light_cell)
    if not len(used.rows):
        return np.zeros((len(prior), groups))
    used = replace(used, diffuse=_shared_light(used.diffuse, light_cell))
    blocks = _blocks(used)
    variance, best = _residual_variance(blocks, used.group, groups, settings.view_error)
    views = int(used.view.max()) + 1
    pairs, pair = np.unique(used.group.astype(np.int64) * views + used.view, return_inverse=True)
    group = pairs // views
    pixels = np.maximum(np.bincount(pair, used.weight), 1e-6)
    means = np.bincount(pair, _residuals(blocks, best, variance) * used.weight) / pixels
    common = view_errors(means, pixels, group, variance, settings)
    errors = settings.pixels_per_sample + pixels * (common / variance)[group]

    def densities(block: PixelSamples) -> tuple[PixelSamples, np.ndarray]:
        scale = (settings.residual_degrees * variance[block.group]).astype(np.float32)
        return block, _log_densities(block, candidates, scale, settings.residual_degrees)

    by_pixel = np.empty((len(prior), len(used.rows)))
    for block, found in in_threads(densities, blocks):
        by_pixel[:, block.rows] = found
    result = np.stack([np.bincount(pair, row) for row in by_pixel]) / errors
    likelihood = np.exp(result - result.max(axis=0))
    outliers = settings.view_outliers
    by_view = np.log((1.0 - outliers) * likelihood + outliers * (prior @ likelihood))
    total = np.stack([np.bincount(group, row, minlength=groups) for row in by_view])
    return total - total.max(axis=0)


def _comparable(samples: PixelSamples, light_cell: np.ndarray) -> tuple[PixelSamples, np.ndarray]:
    """The pixels with a group that share their cell with others, and their light cells.

    Cells are numbered by group, and `rows` from 0.
    """
    cell, light = (numbered([values, samples.group]) for values in (samples.cell, light_cell))
    kept = (samples.group >= 0) & (np.bincount(cell)[cell] > 1)
    cell, light = (np.unique(values[kept], return_inverse=True)[1] for values in (cell, light))
    return samples.take(kept, cell=cell, rows=np.arange(len(cell))), light


def _shared_light(diffuse: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """(N, 3) mean of each pixel's own L_d (N, 3) and that of all pixels of its light cell (N,).

    The same light falls on a cell in all views. A pixel's own L_d has errors that its view shares; the mean
    over views blurs folds and shadows. Neither error is known to be the smaller one.
    """
    means = grouped_sums(diffuse, cell) / np.bincount(cell)[:, None]
    return (0.5 * (diffuse + means[cell])).astype(np.float32)


def _lines(samples: PixelSamples, place: float, metallic: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) slope and offset of the rendering, slope a + offset, at a place among the levels (Eq. 8)."""
    low = min(int(place), len(samples.levels) - 2)
    share = np.float32(place - low)
    specular = (1.0 - share) * samples.specular[:, low] + share * samples.specular[:, low + 1]
    return color_line(samples.diffuse, specular[:, 0], specular[:, 1], np.float32(metallic))


def _blocks(samples: PixelSamples) -> list[PixelSamples]:
    """All pixels in blocks of complete cells, few enough for their arrays to stay in the processor's cache.

    Cells are numbered within a block, and the pixels of a cell keep their order.
    """
    order = np.argsort(samples.cell, kind="stable")
    first = np.searchsorted(samples.cell[order], np.arange(int(samples.cell[order[-1]]) + 1))
    begins = first[np.unique(np.searchsorted(first, np.arange(0, len(order), BLOCK), side="right") - 1)]
    cell = samples.cell
    return [samples.take(rows, cell=cell[rows] - cell[rows[0]]) for rows in np.split(order, begins[1:])]


def _squared(
    samples: PixelSamples, lines: tuple[np.ndarray, np.ndarray], robust: np.ndarray | None
) -> np.ndarray:
    """(n,) squared weighted residuals, mean over the channels, with the least-squares base colours.

    Args:
        lines: slope and offset (:func:`_lines`).
        robust: (n,) factors of the weights for the base colours; None for 1.
    """
    weight = samples.square_weight
    slope, offset = lines
    color_weight = weight if robust is None else weight * robust[:, None]
    color = fit_colors(samples.radiance, slope, offset, color_weight, samples.cell).astype(np.float32)
    residual = samples.radiance - offset - color[samples.cell] * slope
    return np.einsum("nc,nc,nc->n", residual, residual, weight) / np.float32(3.0)


def _residual_variance(
    blocks: list[PixelSamples], group: np.ndarray, groups: int, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """(groups,) variance of the relative residuals with the best material, at least `least` squared.

    And (groups, 2) the place of that material among the levels, and its metallic.

    Args:
        group: (N,) of all pixels.
    """
    materials = list(itertools.product(range(len(blocks[0].levels)), (0.0, 1.0)))

    def squares(block: PixelSamples) -> tuple[PixelSamples, np.ndarray]:
        lines = (_lines(block, *material) for material in materials)
        return block, np.stack([_squared(block, line, None) for line in lines])

    squared = np.empty((len(materials), len(group)), np.float32)
    for block, found in in_threads(squares, blocks):
        squared[:, block.rows] = found
    median, best = np.full(groups, np.inf), np.zeros(groups, np.int64)
    order = np.argsort(group, kind="stable")
    for index, rows in enumerate(np.split(order, np.searchsorted(group[order], np.arange(1, groups)))):
        if len(rows):
            middle = len(rows) // 2
            medians = np.partition(squared[:, rows], middle, axis=1)[:, middle]
            best[index] = medians.argmin()
            median[index] = medians[best[index]]
    return np.maximum(median / MEDIAN_OF_SQUARE, least**2), np.array(materials)[best]


def _residuals(blocks: list[PixelSamples], best: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(N,) relative residuals, mean over the channels, with the best material (groups, 2) of each group.

    They are limited to `MOST_DEVIATIONS` standard deviations (variance: (groups,)).
    """

    def residuals(block: PixelSamples) -> tuple[PixelSamples, np.ndarray]:
        place, metallic = best[block.group].T
        s0, s1 = np.moveaxis(block.specular[np.arange(len(place)), place.astype(np.int64)], 1, 0)
        slope, offset = color_line(block.diffuse, s0, s1, metallic[:, None].astype(np.float32))
        color = fit_colors(block.radiance, slope, offset, block.square_weight, block.cell)
        residual = block.radiance - offset - color[block.cell] * slope
        return block, (residual * np.sqrt(residual_weight(block.radiance))).mean(axis=1)

    result = np.empty(sum(len(block.rows) for block in blocks))
    for block, found in in_threads(residuals, blocks):
        most = MOST_DEVIATIONS * np.sqrt(variance[block.group])
        result[block.rows] = np.clip(found, -most, most)
    return result


def view_errors(
    means: np.ndarray, pixels: np.ndarray, group: np.ndarray, variance: np.ndarray, settings: Settings
) -> np.ndarray:
    """(groups,) variance of the error that the pixels of a group have in common in one view.

    The means of the views have this variance and p s² / n, which is subtracted.

    Args:
        means: (P,) mean residual of each group in each view. pixels: (P,) their sum of weights n.
        group: (P,) of each.
        variance: (groups,) s².
    """
    samples = pixels / settings.pixels_per_sample
    weight = samples / (1.0 + samples)
    excess = np.bincount(group, weight * (means**2 - variance[group] / samples), minlength=len(variance))
    total = np.bincount(group, weight, minlength=len(variance))
    found = VIEW_SHARE**2 * excess / np.maximum(total, 1e-9)
    return np.maximum(found, settings.view_error**2)


def _log_densities(
    samples: PixelSamples, candidates: Candidates, scale: np.ndarray, degrees: float
) -> np.ndarray:
    """(S, n) logarithm of Student's t-density of the residuals, up to a constant, times the pixels' weights.

    Base colours are fitted twice, the second time with the weights of the t-distribution.

    Args:
        scale: (n,) float32 degrees of freedom times the variance of the residuals.
    """
    result = np.empty((len(candidates.place), len(scale)))
    for row, place, metallic in zip(result, candidates.place, candidates.metallic, strict=True):
        lines = _lines(samples, place, metallic)
        robust = 1.0 / (scale + _squared(samples, lines, None))
        squared = _squared(samples, lines, robust)
        # Mixed pixels tell less.
        row[:] = -0.5 * (degrees + 1.0) * np.log1p(squared / scale) * samples.weight
    return result
