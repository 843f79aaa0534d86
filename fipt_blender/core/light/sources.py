"""Radiance of light sources that no photograph shows, from the light that they cast on what photographs show.

The radiance of a diffuse surface point is albedo (B + sum of e_k D_k): B is the irradiance over pi from all
that the photographs show, D_k that from source k of radiance 1. The albedo of a surface of one color is
constant. In logarithms it is eliminated, and the e_k are found by robust least squares, with a covariance.
The prior of a source is Student's t-distribution: most sources are surfaces like others, a few are lamps or
windows. The level follows from shadows and, with less weight, from usual albedos. No albedo is above that of
white paint, which is physics: it counts by the information of all points of the group.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robust import DEGREES, deviation, gauss_newton, student_weights, without_means

# Standard deviations of logarithms: of a source from what is expected, of the level that sources outside the
# mesh share, and of color from gray, as photographs are white-balanced: that of all sources, and of one. With
# less for the first two, hundreds of sources keep a room dark together.
SOURCE, LEVEL, COLOR, SOURCE_COLOR = 3.0, 3.0, 0.15, 0.15
SPECULAR = 0.04  # reflectance of dielectrics at normal incidence (paper Sec. 3)
DARKEST = 1e-4  # radiance, in units of the capture's median
_SPREAD, _MIN_SPREAD = 0.15, 0.02  # of a point's logarithm: to begin with, and at least
_ITERATIONS, _LONGEST_STEP = 20, 0.7  # of Gauss-Newton; more only move sources that hardly cast light
# Expected albedo and its standard deviation (of the logarithm): broad, as rooms are dark or light as a whole;
# the highest albedo, and its deviation; the deviation of a known albedo.
ALBEDO, ALBEDO_SPREAD, MAX_ALBEDO, MAX_SPREAD, KNOWN_SPREAD = 0.4, 1.0, 0.9, 0.1, 0.05
MIN_GROUP = 8  # points of one albedo
# Neighbouring points share textures and errors of the light: about this many count as one.
POINTS_PER_SAMPLE = 10.0


@dataclass(frozen=True, eq=False)
class Transport:
    """N points of surfaces and the light that reaches them.

    Attributes:
        log_radiance: (N, 3).
        group: (N,) int from 0, points of one albedo.
        seen: (N, 3) irradiance over pi from what the photographs show.
        unseen: (N, K) irradiance over pi by each source of radiance 1.
        known: (G, 3) base colour of the groups that are known, else NaN; None: none is.
    """

    log_radiance: np.ndarray
    group: np.ndarray
    seen: np.ndarray
    unseen: np.ndarray
    known: np.ndarray | None = None

    def log_albedos(self) -> np.ndarray:
        """(G, 3) logarithms of the known albedos, which include the gloss of dielectrics; else NaN."""
        if self.known is None:
            return np.full((int(self.group.max()) + 1, 3), np.nan)
        return np.asarray(np.log(self.known + SPECULAR))


@dataclass(frozen=True, eq=False)
class Expectation:
    """What is expected of K sources.

    Attributes:
        log_radiance: (K, 3). outside: (K,) bool, those that share an unknown level.
    """

    log_radiance: np.ndarray
    outside: np.ndarray


@dataclass(frozen=True, eq=False)
class SourceLight:
    """What is found of K sources.

    Attributes:
        radiance: (K, 3).
        covariance: (3, K, 3, K) of its logarithms, by channel and source.
        spread: robust standard deviation of a point's logarithm.
    """

    radiance: np.ndarray
    covariance: np.ndarray
    spread: float

    def shares(self, points: Transport) -> np.ndarray:
        """(N, K) share of the light on each point that each source casts."""
        cast = points.unseen * self.radiance.sum(axis=1)
        total = np.maximum(points.seen.sum(axis=1) + cast.sum(axis=1), DARKEST)
        return np.asarray(cast / total[:, None])

    def error(self, points: Transport) -> np.ndarray:
        """(N,) standard deviation of the logarithm of the light on points, mean of the channels."""
        cast = points.unseen[None] * self.radiance.T[:, None]
        total = np.maximum(points.seen.T + cast.sum(axis=2), DARKEST)
        part = np.moveaxis(cast / total[..., None], 0, 1).reshape(len(points.group), -1) / 3.0
        size = part.shape[1]
        return np.asarray(np.sqrt(((part @ self.covariance.reshape(size, size)) * part).sum(axis=1)))


def solve_sources(points: Transport, expected: Expectation) -> SourceLight:
    """Radiance of the sources."""
    sources = points.unseen.shape[1]
    mean = expected.log_radiance.T.ravel()

    def system(x: np.ndarray, spread: float) -> tuple[np.ndarray, np.ndarray, float]:
        precision = _precision(x.reshape(3, sources), expected)
        normal, pull = precision.copy(), precision @ (mean - x)
        left = []
        for channel, rows in enumerate(_channels(points, np.exp(x.reshape(3, sources)), spread)):
            mine = slice(channel * sources, (channel + 1) * sources)
            weighted = rows.jacobian * rows.weight[:, None]
            normal[mine, mine] += weighted.T @ rows.jacobian
            pull[mine] -= weighted.T @ rows.residual
            left.append(rows.residual[: len(points.group)])
        return normal, pull, deviation(np.array(left), _MIN_SPREAD)

    found = gauss_newton(system, mean, _SPREAD, most_steps=_ITERATIONS, longest=_LONGEST_STEP, settled=1e-2)
    radiance = np.exp(found.x.reshape(3, sources))
    covariance = np.linalg.inv(found.normal).reshape(3, sources, 3, sources)
    return SourceLight(radiance.T, covariance, found.spread)


def held_back_gain(
    points: Transport, expected: Expectation, block: np.ndarray, rng: np.random.Generator
) -> float:
    """Mean logarithm of the likelihood of points held back with the sources over that with the expected ones,
    in its standard errors (the test of Q. Vuong 1989).

    Blocks of neighbouring points count as one sample, as they share errors of the light that is seen: light
    that explains one place alone has no gain. Each half of the blocks is held back once.

    Args:
        block: (N,) int from 0, of each point.
    """
    half = rng.permutation(int(block.max()) + 1)[block] % 2
    gain, judged = np.zeros(len(block)), np.zeros(len(block), bool)
    size = int(points.group.max()) + 1
    for held in (half == 0, half == 1):
        held &= (np.bincount(points.group[~held], minlength=size) >= MIN_GROUP)[points.group]
        columns = points.log_radiance, points.group, points.seen, points.unseen
        log_radiance, group, seen, unseen = (column[~held] for column in columns)
        kept = Transport(log_radiance, group, seen, unseen, points.known)
        found, judged = solve_sources(kept, expected), judged | held
        for radiance, sign in ((found.radiance, 1.0), (np.exp(expected.log_radiance), -1.0)):
            for channel, rows in enumerate(_channels(kept, radiance.T, found.spread)):
                spread = deviation(rows.residual[: len(kept.group)], _MIN_SPREAD)
                light = points.seen[held, channel] + points.unseen[held] @ radiance[:, channel]
                residual = points.log_radiance[held, channel] - np.log(np.maximum(light, DARKEST))
                residual -= rows.albedo[points.group[held]]
                error = np.log1p((residual / spread) ** 2 / DEGREES) * (0.5 * (DEGREES + 1.0))
                gain[held] -= sign * (error + np.log(spread)) / 3.0
    _, own = np.unique(block[judged], return_inverse=True)
    count = np.bincount(own)
    mean, weight = np.bincount(own, gain[judged]) / count, count / (count + POINTS_PER_SAMPLE)
    scatter = weight * (mean - np.average(mean, weights=weight))
    return float((weight * mean).sum() / max(np.sqrt((scatter**2).sum()), 1e-12))


def _channels(points: Transport, radiance: np.ndarray, spread: float) -> list[AlbedoRows]:
    """The rows of each channel, for a radiance (3, K)."""
    found, known = [], points.log_albedos()
    for channel in range(3):
        cast = points.unseen * radiance[channel]
        total = np.maximum(points.seen[:, channel] + cast.sum(axis=1), DARKEST)
        residual = points.log_radiance[:, channel] - np.log(total)
        jacobian = -cast / total[:, None]
        found.append(without_albedo(residual, jacobian, points.group, known[:, channel], spread))
    return found


def _precision(x: np.ndarray, expected: Expectation) -> np.ndarray:
    """(3 K, 3 K) of the logarithms of the sources' radiance (3, K), channel by channel."""
    off = (x - expected.log_radiance.T).mean(axis=0)
    outside = expected.outside
    if outside.any():
        off = np.where(outside, off - np.median(off[outside]), off)
    own = SOURCE**2 / student_weights((off / SOURCE) ** 2)
    both = outside[:, None] & outside[None]
    level = np.diag(own) + LEVEL**2 * both
    color = SOURCE_COLOR**2 * np.eye(len(own)) + COLOR**2
    gray = np.full((3, 3), 1.0 / 3.0)
    return np.asarray(
        np.kron(gray, np.linalg.inv(3.0 * level)) + np.kron(np.eye(3) - gray, np.linalg.inv(color))
    )


@dataclass(frozen=True, eq=False)
class AlbedoRows:
    """Residuals (R,) less the albedo of their group, their derivatives (R, K), and weights (R,); the points
    first, then the prior of the albedo of each group. And logarithms of the albedos (G,)."""

    residual: np.ndarray
    jacobian: np.ndarray
    weight: np.ndarray
    albedo: np.ndarray


def without_albedo(
    residual: np.ndarray, jacobian: np.ndarray, group: np.ndarray, known: np.ndarray, spread: float
) -> AlbedoRows:
    """Eliminate the logarithm of the albedo of each group.

    Args:
        residual, jacobian: as in `AlbedoRows`, of N points.
        known: (G,) logarithms of known albedos, else NaN.
    """
    size = len(known)
    weight = np.full(len(residual), 1.0 / (spread**2 * POINTS_PER_SAMPLE))
    albedo, samples = np.full(size, np.log(ALBEDO)), np.bincount(group, minlength=size) / POINTS_PER_SAMPLE
    mean = albedo
    for step in range(7):
        if step:  # about their own mean: a whole group above white is no outlier, its light is too low
            ratio = ((residual - mean[group]) / spread) ** 2
            weight = student_weights(ratio) / (spread**2 * POINTS_PER_SAMPLE)
        of_points, pull = (
            np.bincount(group, weight * each, size) for each in (np.ones(len(residual)), residual)
        )
        mean = pull / np.maximum(of_points, 1e-12)
        expected, precision = _expected_albedo(albedo, known, samples)
        albedo = (pull + precision * expected) / (of_points + precision)
    every, weight = np.concatenate([group, np.arange(size)]), np.concatenate([weight, precision])
    residual = without_means(np.concatenate([residual, expected]), every, weight)
    jacobian = np.concatenate([jacobian, np.zeros((size, jacobian.shape[1]))])
    return AlbedoRows(residual, without_means(jacobian, every, weight), weight, albedo)


def _expected_albedo(
    albedo: np.ndarray, known: np.ndarray, samples: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Prior mean of the logarithms of albedos (G,), and its precision.

    Usual albedos are a habit, therefore robust: red paint reflects hardly any blue.

    Args:
        known: (G,) those that are known, else NaN.
        samples: (G,) independent ones that the points of each group count as.
    """
    above = albedo > np.log(MAX_ALBEDO)
    usual = student_weights(((albedo - np.log(ALBEDO)) / ALBEDO_SPREAD) ** 2) / ALBEDO_SPREAD**2
    expected = np.log(np.where(above, MAX_ALBEDO, ALBEDO))
    precision = np.where(above, samples / MAX_SPREAD**2, usual)
    unknown = np.isnan(known)
    return np.where(unknown, expected, known), np.where(unknown, precision, samples / KNOWN_SPREAD**2)
