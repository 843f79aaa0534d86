"""Radiometric adjustment: the shape of the response, the gains of all views and vignetting, from surface
points that several views see.

The logarithm of the light of a code is that of the point's radiance, of the view's gain in this channel and
of the lens's share of light. The points are eliminated; what remains is linear, and is solved by least
squares with the weights of Student's t-distribution, to which highlights and wrong geometry are outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags

from ..capture.encoded import CLIPPED_CODE
from ..robust import LEAST_VIEWS, deviation, student_weights
from .response import COMPONENTS, LEVELS, LOWEST_CODE, Basis, interpolated, slope

FALLOFF_TERMS = 2  # r² and r⁴ of the logarithm of the share of light
# Standard deviations of what is not known: of a gain (in contrasts, thus broad), of a term of the falloff.
_GAIN_DEVIATION, _FALLOFF_DEVIATION = 3.0, 0.1
# Standard deviation of a code of a small calm area: rounding, JPEG, noise.
CODE_NOISE = 1.0
_FIRST_NOISE, _MIN_NOISE = 0.02, 2e-3  # of the logarithm of radiance, in contrasts
# Neighbouring points share the errors of the model (gloss, mesh): about so many rows count as one.
ROWS_PER_SAMPLE = 10.0


@dataclass(frozen=True, eq=False)
class Samples:
    """Codes of surface points: N samples, each of one point in one view.

    Attributes:
        point: (N,) int number of the point, from 0.
        cluster: (N,) int number of a larger neighbourhood, whose errors are alike, from 0.
        view: (N,) int.
        radius: (N,) distance from the image's centre; 1 in the corner.
        codes: (N, 3) mean codes, 0 to 255.
    """

    point: np.ndarray
    cluster: np.ndarray
    view: np.ndarray
    radius: np.ndarray
    codes: np.ndarray


@dataclass(frozen=True, eq=False)
class Adjustment:
    """What the points determine, in units of the response's contrast.

    Attributes:
        shape: (256,) of the response.
        weights: (COMPONENTS,) of the basis.
        log_gains: (V, 3) of each view and channel; their mean over the photographs is 0.
        falloff: (FALLOFF_TERMS,) of the logarithm of the share of light.
        covariance: (P, P) of the weights, the falloff and the gains (view by view), in this order.
        noise: standard deviation of a sample beside that of its code.
        shared: (V,) number of samples by which each view's photograph is compared.
        outliers: (V,) share of these that do not agree, by more than three standard deviations.
    """

    shape: np.ndarray
    weights: np.ndarray
    log_gains: np.ndarray
    falloff: np.ndarray
    covariance: np.ndarray
    noise: float
    shared: np.ndarray
    outliers: np.ndarray


def adjust(samples: Samples, photograph: np.ndarray, basis: Basis) -> Adjustment:
    """The adjustment of views that took their photographs with one camera.

    Gauss-Newton on the codes: each iteration predicts the codes from what the one before has found, and
    expands the model at these. At the photographed codes, whose noise would be in both sides of the
    equations, the shape would be flattened where most codes lie.

    Args:
        photograph: (V,) int of each view, from 0; views of one photograph have one gain. Those without
            samples get the mean gain.
    """
    rows, photographs = _Rows.of(samples, photograph), int(photograph.max()) + 1
    typical = slope(basis.mean, np.arange(LEVELS))
    shape, predicted = basis.shape(np.zeros(COMPONENTS)), rows.code
    noise = _FIRST_NOISE
    error, spread = np.zeros(len(rows.code)), np.ones(len(rows.code))
    for iteration in range(10):
        system = _System.of(rows, photographs, basis, shape, predicted)
        # A relative error of radiance, in codes by the typical slope: the found one would favor flat shapes.
        spread = np.sqrt(CODE_NOISE**2 + (noise / interpolated(typical, predicted)) ** 2)
        ratio = (error / spread) ** 2 if iteration else np.ones(len(error))
        precision = student_weights(ratio) / (system.slope * spread) ** 2 / ROWS_PER_SAMPLE
        solution, normal, expected = system.solve(precision)
        shape = basis.shape(solution[:COMPONENTS])
        predicted = np.interp(expected, shape, np.arange(LEVELS))
        error = rows.code - predicted
        noise = _model_noise(error, interpolated(typical, predicted))
    covariance = system.covariance(normal, precision, system.slope * error)
    count = np.bincount(rows.view, minlength=photographs)
    far = np.bincount(rows.view, np.abs(error) > 3.0 * spread, photographs)
    first = COMPONENTS + FALLOFF_TERMS
    gains = solution[first:].reshape(photographs, 3)
    own = (first + 3 * photograph[:, None] + np.arange(3)).ravel()  # the unknowns of each view
    order = np.concatenate([np.arange(first), own])
    return Adjustment(
        shape,
        solution[:COMPONENTS],
        (gains - gains.mean(axis=0))[photograph],
        solution[COMPONENTS:first],
        covariance[np.ix_(order, order)],
        noise,
        count[photograph],
        (far / np.maximum(count, 1))[photograph],
    )


def _model_noise(error: np.ndarray, slopes: np.ndarray) -> float:
    """Standard deviation of log radiance beside the noise of codes, from errors of codes (R,), robustly."""
    if not len(error):
        return _FIRST_NOISE
    spread = deviation(error * slopes)
    return float(np.sqrt(max(spread**2 - float(np.median(CODE_NOISE * slopes)) ** 2, _MIN_NOISE**2)))


def usable(codes: np.ndarray) -> np.ndarray:
    """Whether codes say how bright a point is."""
    return (codes >= LOWEST_CODE) & (codes < CLIPPED_CODE)


def falloff_terms(radius: np.ndarray, terms: int = FALLOFF_TERMS) -> np.ndarray:
    """(N, terms) even powers of radii (N,)."""
    return np.stack([radius ** (2 * power) for power in range(1, terms + 1)], axis=-1)


@dataclass(frozen=True, eq=False)
class _Rows:
    """R usable codes of points that enough views see in the same channel.

    Attributes:
        member, cluster: (R, C) and (R, G) which point and channel, and which cluster, each belongs to.
        code, view, channel: (R,); `view` is the number of its photograph.
        falloff: (R, FALLOFF_TERMS) powers of the distance from the image's centre.
    """

    member: csr_matrix
    cluster: csr_matrix
    code: np.ndarray
    view: np.ndarray
    channel: np.ndarray
    falloff: np.ndarray

    @classmethod
    def of(cls, samples: Samples, photograph: np.ndarray) -> _Rows:
        """The rows of some samples; (V,) int photograph of each view."""
        points = int(samples.point.max(initial=-1)) + 1
        row, channel = np.nonzero(usable(samples.codes))
        member = samples.point[row] * 3 + channel
        shared = np.bincount(member, minlength=points * 3)[member] >= LEAST_VIEWS
        row, channel, member = row[shared], channel[shared], member[shared]
        return cls(
            _indicator(member),
            _indicator(samples.cluster[row]),
            samples.codes[row, channel].astype(np.float64),
            photograph[samples.view[row]],
            channel,
            falloff_terms(samples.radius[row]),
        )


@dataclass(frozen=True, eq=False)
class _System:
    """The model of the rows, expanded at predicted codes.

    Attributes:
        rows: R of them.
        design: (R, P) of the unknowns.
        target: (R,) what they shall explain, together with the points.
        slope: (R,) of the shape at the predicted codes.
        prior: (P,) precision of the unknowns, whose expectation is 0.
    """

    rows: _Rows
    design: csr_matrix
    target: np.ndarray
    slope: np.ndarray
    prior: np.ndarray

    @classmethod
    def of(cls, rows: _Rows, views: int, basis: Basis, shape: np.ndarray, predicted: np.ndarray) -> _System:
        """The system at a shape (256,) and predicted codes (R,)."""
        dense = np.stack([interpolated(component, predicted) for component in basis.components], axis=1)
        dense = np.concatenate([dense, -rows.falloff], axis=1)
        count, fixed = dense.shape
        columns = fixed + 3 * views
        place = np.concatenate(
            [np.tile(np.arange(fixed), (count, 1)), (fixed + rows.view * 3 + rows.channel)[:, None]], 1
        )
        values = np.concatenate([dense, np.full((count, 1), -1.0)], axis=1)
        starts = np.arange(count + 1) * (fixed + 1)
        design = csr_matrix((values.ravel(), place.ravel(), starts), (count, columns))
        prior = np.concatenate(
            [
                np.ones(COMPONENTS),
                np.full(FALLOFF_TERMS, _FALLOFF_DEVIATION**-2),
                np.full(3 * views, _GAIN_DEVIATION**-2),
            ]
        )
        slopes, mean = slope(shape, predicted), interpolated(basis.mean, predicted)
        return cls(rows, design, -mean - slopes * (rows.code - predicted), slopes, prior)

    @property
    def columns(self) -> int:
        """Number of unknowns."""
        return int(self.design.shape[1])

    def solve(self, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The unknowns with these precisions (R,) of the rows.

        Returns:
            (P,) unknowns, (P, P) normal matrix, and (R,) expected logarithm of light, in contrasts.
        """
        member = self.rows.member
        weighted = diags(precision) @ self.design
        total = np.maximum(member.T @ precision, 1e-12)
        sums = member.T @ weighted
        target_sums = member.T @ (precision * self.target)
        normal = (self.design.T @ weighted - sums.T @ diags(1.0 / total) @ sums).toarray()
        right = weighted.T @ self.target - sums.T @ (target_sums / total)
        normal += np.diag(self.prior)
        solution = np.linalg.solve(normal, right)
        left = self.target - self.design @ solution
        mean = member @ ((member.T @ (precision * left)) / total)
        # The light is the point's (with the opposite sign, as all unknowns), the view's and the lens's.
        found = solution.copy()
        found[:COMPONENTS] = 0.0
        return solution, normal, -(self.design @ found) - mean

    def covariance(self, normal: np.ndarray, precision: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """(P, P) covariance of the unknowns, which allows for errors that are alike within a cluster."""
        scores = self.rows.cluster.T @ (diags(precision * residual) @ self.design)
        inverse = np.linalg.inv(normal)
        spread = (scores.T @ scores).toarray() + np.diag(self.prior)
        return np.asarray(inverse @ spread @ inverse)


def _indicator(group: np.ndarray) -> csr_matrix:
    """(R, G) matrix with a one in each row, in the column of its group; groups (R,) may be any integers."""
    _, place = np.unique(group, return_inverse=True)
    count = len(place)
    return csr_matrix(
        (np.ones(count), (np.arange(count), place.reshape(-1))), (count, int(place.max(initial=-1)) + 1)
    )
