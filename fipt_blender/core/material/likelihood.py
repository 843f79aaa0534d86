"""How well each roughness, as dielectric or metal, explains the pixels of each group: robust log-likelihoods.

Base colours have a closed form for each candidate (projection.py). What then remains are errors of the
shadings, which neighbouring pixels and whole views share; docs/method.md states the model.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics.factorised import color_line, level_roughness
from ..pixels.grouped import grouped_means, numbered, pairs_of, rows_of_groups
from ..run.stage_settings import MaterialSettings
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
MAX_DEVIATIONS = 3.0


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
    settings: MaterialSettings,
) -> np.ndarray:
    """(S, groups) log-likelihood of each candidate relative to the group's best; 0 in groups without pixels.

    The pixels of a group in one view, n by their weight, count as n / (`pixels_per_sample` + n t² / s²)
    samples, where s² is the variance of their residuals: a view's shadings err by t in any direction, so many
    pixels of one view count as no more than s² / t² samples. t is `VIEW_SHARE` of what the means of the views
    show (:func:`view_errors`), at least `view_error`. A share `view_outliers` of the views is uninformative.

    Args:
        samples: N pixels; those without a group, or alone in their cell, are left out: anything fits these.
        light_cell: (N,) int from 0, cell of one slope on which the same light falls in all views.
        prior: (S,) probability of each of :func:`make_candidates`, for views that are uninformative.
    """
    candidates = make_candidates(samples.levels)
    used, light_cell = _comparable(samples, light_cell)
    if not len(used.rows):
        return np.zeros((len(prior), groups))
    used = replace(used, diffuse=_shared_light(used.diffuse, light_cell))
    cells = DeviceCells(used)
    variance, best = _residual_variance(cells, used, groups, settings.view_error)
    group, _, pair = pairs_of(used.group, used.view)
    pixels = np.maximum(np.bincount(pair, used.weight), 1e-6)
    means = np.bincount(pair, _residuals(used, best, variance) * used.weight) / pixels
    common = view_errors(means, pixels, group, variance, settings)
    errors = settings.pixels_per_sample + pixels * (common / variance)[group]

    degrees = settings.residual_degrees
    by_pixel = cells.log_densities(candidates, degrees * variance[used.group], degrees)
    result = np.stack([np.bincount(pair, row * used.weight) for row in by_pixel]) / errors
    by_view = np.log(with_outliers(result, settings.view_outliers, prior))
    total = np.stack([np.bincount(group, row, minlength=groups) for row in by_view])
    return total - total.max(axis=0)


def with_outliers(log_likelihood: np.ndarray, share: float, prior: np.ndarray) -> np.ndarray:
    """(S, N) likelihoods, relative to the best of each column, where a share of the columns is uninformative.

    Args:
        log_likelihood: (S, N). prior: (S,) probability of each candidate, for uninformative columns.
    """
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=0))
    return np.asarray((1.0 - share) * likelihood + share * (prior @ likelihood))


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
    return (0.5 * (diffuse + grouped_means(diffuse, cell)[cell])).astype(np.float32)


class DeviceCells:
    """Pixels on the device, cell by cell.

    A kernel has a lane for each pair of material and cell, which runs over the pixels of the cell: first for
    the least-squares base colour, then for the residuals that it leaves.
    """

    def __init__(self, samples: PixelSamples) -> None:
        # Cells of one size are side by side, so that neighbouring lanes end together.
        count = np.bincount(samples.cell)
        order = np.lexsort((samples.cell, count[samples.cell]))
        self._levels, self._count, self._rows = samples.levels, len(order), mi.UInt32(order.astype(np.uint32))
        self._first = mi.UInt32(np.append(0, np.cumsum(np.sort(count))).astype(np.uint32))
        columns = (samples.radiance, samples.diffuse, samples.square_weight)
        self._radiance, self._diffuse, self._weight = (_flat(values[order]) for values in columns)
        self._specular, self._order = _flat(samples.specular[order]), order

    def squares(self, place: np.ndarray, metallic: np.ndarray) -> np.ndarray:
        """(S, N) squared weighted residuals with materials (S,), mean over the channels."""
        return self._evaluated(place, metallic, mi.Float(0.0), 0.0)

    def log_densities(self, candidates: Candidates, scale: np.ndarray, degrees: float) -> np.ndarray:
        """(S, N) logarithm of Student's t-density of the residuals, up to a constant.

        Base colours are fitted twice, the second time with the weights of the t-distribution.

        Args:
            scale: (N,) degrees of freedom times the variance of the residuals.
        """
        scale_of_row = _flat(scale[self._order])
        return self._evaluated(candidates.place, candidates.metallic, scale_of_row, degrees)

    def _evaluated(
        self, place: np.ndarray, metallic: np.ndarray, scale: mi.Float, degrees: float
    ) -> np.ndarray:
        found = dr.zeros(mi.Float, len(place) * self._count)
        low = np.minimum(place.astype(np.int64), len(self._levels) - 2)
        material = mi.UInt32(low.astype(np.uint32)), _flat(place - low), _flat(metallic)
        self._evaluate(found, *material, scale, degrees)
        return np.array(found).reshape(len(place), self._count)

    @dr.syntax
    def _evaluate(
        self,
        found: mi.Float,
        lows: mi.UInt32,
        shares: mi.Float,
        metals: mi.Float,
        scales: mi.Float,
        degrees: float,
    ) -> None:
        """Write squares or, with `degrees` above 0, logarithms of densities of each material and pixel."""
        cells = dr.width(self._first) - 1
        lane = dr.arange(mi.UInt32, dr.width(lows) * cells)
        # Opaque: with literals, Dr.Jit would compile a kernel for each capture.
        cells, count = dr.opaque(mi.UInt32, cells), dr.opaque(mi.UInt32, self._count)
        number = lane // cells
        cell = lane - number * cells
        low = dr.gather(mi.UInt32, lows, number)
        share, metallic = (dr.gather(mi.Float, values, number) for values in (shares, metals))
        begin, end = dr.gather(mi.UInt32, self._first, cell), dr.gather(mi.UInt32, self._first, cell + 1)
        color = mi.Color3f(0.5)
        fits = 2 if degrees > 0.0 else 1
        for fit in range(fits):
            top, bottom = mi.Color3f(0.0), mi.Color3f(0.0)
            pixel = mi.UInt32(begin)
            while pixel < end:
                weight, slope, rest = self._line(pixel, low, share, metallic)
                if dr.hint(fit > 0, mode="scalar"):
                    squared = dr.mean(weight * dr.square(rest - color * slope))
                    weight /= dr.gather(mi.Float, scales, pixel) + squared
                top += weight * slope * rest
                bottom += weight * slope * slope
                pixel += 1
            color = dr.clip(top / dr.maximum(bottom, 1e-12), 0.0, 1.0)
        pixel = mi.UInt32(begin)
        while pixel < end:
            weight, slope, rest = self._line(pixel, low, share, metallic)
            value = dr.mean(weight * dr.square(rest - color * slope))
            if dr.hint(fits > 1, mode="scalar"):
                value = -0.5 * (degrees + 1.0) * dr.log(1.0 + value / dr.gather(mi.Float, scales, pixel))
            row = dr.gather(mi.UInt32, self._rows, pixel)
            dr.scatter(found, value, number * count + row)
            pixel += 1

    def _line(
        self, pixel: mi.UInt32, low: mi.UInt32, share: mi.Float, metallic: mi.Float
    ) -> tuple[mi.Color3f, mi.Color3f, mi.Color3f]:
        """Weight of the squared residuals of pixels, and slope and rest: these are slope a - rest (Eq. 8)."""
        radiance, diffuse, weight = (
            dr.gather(mi.Color3f, values, pixel) for values in (self._radiance, self._diffuse, self._weight)
        )
        at = (pixel * len(self._levels) + low) * 2
        s0, s1 = (
            dr.lerp(
                dr.gather(mi.Color3f, self._specular, at + term),
                dr.gather(mi.Color3f, self._specular, at + 2 + term),
                share,
            )
            for term in range(2)
        )
        slope, offset = color_line(diffuse, s0, s1, metallic)
        return weight, slope, radiance - offset


def _flat(values: np.ndarray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(values, np.float32).reshape(-1))


def _residual_variance(
    cells: DeviceCells, samples: PixelSamples, groups: int, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """(groups,) variance of the relative residuals with the best material, at least `least` squared.

    And (groups, 2) the place of that material among the levels, and its metallic.
    """
    materials = np.array(list(itertools.product(range(len(samples.levels)), (0.0, 1.0))))
    squared, group = cells.squares(*materials.T), samples.group
    median, best = np.full(groups, np.inf), np.zeros(groups, np.int64)
    for index, rows in enumerate(rows_of_groups(group, groups)):
        if len(rows):
            middle = len(rows) // 2
            medians = np.partition(squared[:, rows], middle, axis=1)[:, middle]
            best[index] = medians.argmin()
            median[index] = medians[best[index]]
    return np.maximum(median / MEDIAN_OF_SQUARE, least**2), materials[best]


def _residuals(samples: PixelSamples, best: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(N,) relative residuals, mean over the channels, with the best material (groups, 2) of each group.

    They are limited to `MAX_DEVIATIONS` standard deviations (variance: (groups,)).
    """
    place, metallic = best[samples.group].T
    s0, s1 = np.moveaxis(samples.specular[np.arange(len(place)), place.astype(np.int64)], 1, 0)
    slope, offset = color_line(samples.diffuse, s0, s1, metallic[:, None].astype(np.float32))
    color = fit_colors(samples.radiance, slope, offset, samples.square_weight, samples.cell)
    residual = samples.radiance - offset - color[samples.cell] * slope
    found = (residual * np.sqrt(residual_weight(samples.radiance))).mean(axis=1)
    most = MAX_DEVIATIONS * np.sqrt(variance[samples.group])
    return np.clip(found, -most, most)


def view_errors(
    means: np.ndarray, pixels: np.ndarray, group: np.ndarray, variance: np.ndarray, settings: MaterialSettings
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
