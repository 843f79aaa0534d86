"""The radiance of lamps that are clipped in all photographs, from the light that they cast.

At points of diffuse surfaces the radiance is kd (B + sum of r_f D_f): B is the irradiance from all that is
not clipped, which the photographs show, and D_f that from lamp f of radiance 1. kd is constant on a part.
In logarithms the parts are eliminated; the lamps' radiances r_f and, where it is not known, the contrast of
the camera's response are found by robust least squares: with a wrong contrast, light does not fall off over
the walls as it should.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..pixels.camera_rays import rays_along
from ..robust import deviation, gauss_newton
from ..run.store import Gaps
from ..surface.room import Room
from .cache import VoxelGrid
from .sources import MIN_GROUP, without_albedo

RAYS = 128  # over the hemisphere of each point; their noise would make the contrast too high
LAMP_SAMPLES = 32  # points on each lamp
MAX_POINTS = 3000  # that are compared; more only cost time
MAX_LAMPS = 24  # the largest ones
ON_LAMP, OUTSIDE = -1, -2  # in place of cache entries
_ITERATIONS = 25  # of Gauss-Newton; it ends earlier
_LONGEST_STEP = 0.7  # of any logarithm
# Standard deviation of the logarithm of a point's radiance, due to texture and gloss.
_TEXTURE = 0.15
_MIN_SPREAD = 0.02  # of a point, however well all agree
# Standard deviation of the logarithm of a lamp's radiance before anything is known, and its expectation as a
# multiple of the radiance at which it is clipped.
_UNKNOWN, _EXPECTED = 2.0, 8.0


@dataclass(frozen=True, eq=False)
class LitPoints:
    """N surface points and the light that reaches them.

    Attributes:
        value: (N, 3) logarithm of radiance over the contrast, NaN in channels that are clipped or black.
        part: (N,) int.
        entry: (N, RAYS) int32 cache entries that rays over the hemisphere meet, ON_LAMP or OUTSIDE.
        direct: (N, F) irradiance over pi by each of F lamps of radiance 1; the last is what lies outside.
        correction: (N, 3) logarithm of the true light over that of this model, or a number for all.
    """

    value: Gaps
    part: np.ndarray
    entry: np.ndarray
    direct: np.ndarray
    correction: np.ndarray | float = 0.0

    def light(self, cache: np.ndarray, radiance: np.ndarray, contrast: float) -> np.ndarray:
        """(N, 3) irradiance over pi without the correction.

        Args:
            cache: (E, 3) logarithm of the radiance of the entries over the contrast.
            radiance: (F, 3) of the lamps.
        """
        shown = (self.entry >= 0)[..., None]
        shining = np.exp(contrast * cache)[np.maximum(self.entry, 0)]
        return np.where(shown, shining, 0.0).mean(axis=1) + self.direct @ radiance


@dataclass(frozen=True, eq=False)
class Expectation:
    """The prior of the lamps' radiance, before their light is measured.

    Attributes:
        log_radiance: (F, 3) natural logarithms.
        deviation: (F,) their standard deviations.
    """

    log_radiance: np.ndarray
    deviation: np.ndarray

    @classmethod
    def of(cls, bound: np.ndarray, log_contrast: float) -> Expectation:
        """The broad prior of lamps that are clipped at a radiance.

        Args:
            bound: (F, 3) its logarithm over the contrast.
        """
        return cls(np.exp(log_contrast) * bound + np.log(_EXPECTED), np.full(len(bound), _UNKNOWN))


@dataclass(frozen=True, eq=False)
class LampLight:
    """Radiance of the lamps and contrast, as inferred from the light on the points.

    Attributes:
        log_radiance: (F, 3) natural logarithms.
        deviation: (F, 3) their standard deviations.
        log_contrast: of the response, with its standard deviation.
        spread: robust standard deviation of a point.
    """

    log_radiance: np.ndarray
    deviation: np.ndarray
    log_contrast: tuple[float, float]
    spread: float


def light_on_points(
    room: Room, grid: VoxelGrid, points: tuple[np.ndarray, np.ndarray], lamp: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """The rays and the direct light of N points.

    Args:
        points: (N, 3) positions, metres, and (N, 3) normals on the seen side.
        lamp: (T,) int32 lamp of each triangle, -1 for none.

    Returns:
        `LitPoints.entry` and `LitPoints.direct`.
    """
    if not len(points[0]):  # Dr.Jit traces no empty set of rays
        return np.zeros((0, RAYS), np.int32), np.zeros((0, int(lamp.max(initial=-1)) + 2))
    position, normal = (np.ascontiguousarray(array, np.float32) for array in points)
    entry = hemisphere_rays(room, grid, position, normal, lamp, seed)[0]
    outside = (entry == OUTSIDE).mean(axis=1, keepdims=True)
    return entry, np.concatenate([_direct(room, position, normal, lamp, seed), outside], axis=1)


def hemisphere_rays(
    room: Room,
    grid: VoxelGrid,
    position: np.ndarray,
    normal: np.ndarray,
    lamp: np.ndarray,
    seed: int,
    rays: int = RAYS,
) -> tuple[np.ndarray, np.ndarray]:
    """What cosine-distributed rays from N points meet; arguments as of `light_on_points`.

    Returns:
        (N, rays) int32 as `LitPoints.entry`, and (N, rays, 3) unit directions.
    """
    rng = np.random.default_rng([seed, 21])
    count = len(position)
    number = np.arange(rays)
    golden = (number * 0.6180339887498949)[None] + rng.random((count, 1))
    height = ((number + 0.5) / rays)[None] + np.zeros((count, 1))
    angle, radius = 2.0 * np.pi * (golden % 1.0), np.sqrt(height)
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - height)], axis=-1)
    direction = np.einsum("nrc,ncd->nrd", local, _frames(normal)).reshape(-1, 3)
    start = np.repeat(position + room.offset * normal, rays, axis=0)
    surface = room.intersect(rays_along(start, direction))
    valid, triangle = np.array(surface.valid), np.array(surface.triangle).astype(np.int64)
    front = np.array(surface.front)
    side = room.normals[triangle] * np.where(front, 1.0, -1.0)[:, None]
    place = np.where(valid, np.array(surface.position), 0.0).T.astype(np.float64)
    entry = grid.entries(place, side)
    entry[lamp[triangle] >= 0] = ON_LAMP
    entry[~valid] = OUTSIDE
    return entry.astype(np.int32).reshape(count, rays), direction.reshape(count, rays, 3)


def _direct(room: Room, position: np.ndarray, normal: np.ndarray, lamp: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng([seed, 22])
    lamps = int(lamp.max(initial=-1)) + 1
    direct = np.zeros((len(position), lamps))
    start = np.repeat(position + room.offset * normal, LAMP_SAMPLES, axis=0)
    for index in range(lamps):
        members = np.flatnonzero(lamp == index)
        area = np.maximum(room.areas[members].astype(np.float64), 1e-12)
        chosen = members[rng.choice(len(members), LAMP_SAMPLES, p=area / area.sum())]
        place = room.points_on(chosen, *rng.random((2, LAMP_SAMPLES)))
        toward = (place[None] - position[:, None]).reshape(-1, 3)
        distance = np.linalg.norm(toward, axis=1)
        direction = toward / np.maximum(distance, 1e-9)[:, None]
        here = np.repeat(normal, LAMP_SAMPLES, axis=0)
        there = np.tile(room.normals[chosen], (len(position), 1))
        cosines = np.maximum((direction * here).sum(1), 0.0) * np.abs((direction * there).sum(1))
        surface = room.intersect(rays_along(start, direction))
        hit = np.array(surface.triangle).astype(np.int64)
        seen = np.array(surface.valid) & (lamp[hit] == index)
        seen &= np.array(surface.distance) > 0.98 * distance - 0.01
        falloff = np.where(seen, cosines / np.maximum(distance, 0.02) ** 2, 0.0).reshape(-1, LAMP_SAMPLES)
        direct[:, index] = falloff.mean(axis=1) * area.sum() / np.pi
    return direct


def _frames(normal: np.ndarray) -> np.ndarray:
    """(N, 3, 3) two tangents and the normal of each point."""
    helper = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], axis=1)


def solve_lamps(
    points: LitPoints, cache: np.ndarray, expected: Expectation, contrast: tuple[float, float]
) -> LampLight:
    """Radiances of the lamps, and the contrast of the response.

    Args:
        cache: (E, 3) logarithm of the radiance of the entries over the contrast.
        expected: of the F lamps.
        contrast: expected logarithm of the contrast, and its standard deviation; 0 where it is known.
    """
    fit = _Fit(points, cache, expected, contrast)
    start = np.concatenate([[contrast[0]], expected.log_radiance.ravel()])
    found = gauss_newton(
        fit.system, start, _TEXTURE, most_steps=_ITERATIONS, longest=_LONGEST_STEP, settled=1e-4
    )
    (log_contrast, *logs), (error, *errors) = found.x.tolist(), found.deviation.tolist()
    radiance, deviations = np.reshape(logs, (-1, 3)), np.reshape(errors, (-1, 3))
    return LampLight(radiance, deviations, (log_contrast, error), found.spread)


class _Fit:
    """Residuals of the points' radiance, in contrasts, and their derivatives by the unknowns."""

    def __init__(
        self, points: LitPoints, cache: np.ndarray, expected: Expectation, contrast: tuple[float, float]
    ) -> None:
        self._points = points
        self._correction = np.broadcast_to(points.correction, points.value.shape)
        self._mean = np.concatenate([[contrast[0]], expected.log_radiance.ravel()])
        deviation = np.concatenate([[max(contrast[1], 1e-4)], np.repeat(expected.deviation, 3)])
        self._precision = deviation**-2.0
        self._shown = points.entry >= 0
        used, place = np.unique(np.maximum(points.entry, 0), return_inverse=True)
        self._cache, self._entry = cache[used], place.reshape(points.entry.shape)
        self._group = np.unique(points.part, return_inverse=True)[1].reshape(-1)

    def system(self, x: np.ndarray, spread: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Normal matrix, right side and spread of a step; see :func:`.gauss_newton`."""
        normal, right, left = np.diag(self._precision), self._precision * (self._mean - x), []
        for channel in range(3):
            residual, jacobian, weight, points = self._channel(x, channel, spread)
            normal = normal + jacobian.T @ (weight[:, None] * jacobian)
            right = right - jacobian.T @ (weight * residual)
            left.append(residual[:points])
        return normal, right, deviation(np.concatenate(left), _MIN_SPREAD)

    def _channel(
        self, x: np.ndarray, channel: int, spread: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Residuals (R,), derivatives (R, P) and weights (R,), and how many of the rows are points."""
        points, contrast = self._points, float(np.exp(x[0]))
        radiance = np.exp(x[1:]).reshape(-1, 3)
        logs = contrast * self._cache[:, channel]
        light = np.exp(logs)
        indirect = np.where(self._shown, light[self._entry], 0.0).mean(axis=1)
        by_contrast = np.where(self._shown, (light * logs)[self._entry], 0.0).mean(axis=1)
        cast = points.direct * radiance[:, channel]
        total = np.maximum(indirect + cast.sum(axis=1), 1e-9)
        good = np.isfinite(points.value[:, channel])
        good &= np.bincount(self._group, good)[self._group] >= MIN_GROUP
        jacobian = np.zeros((len(total), len(x)))
        logarithm = np.log(total) + self._correction[:, channel]
        jacobian[:, 0] = logarithm - by_contrast / total
        jacobian[:, 1 + channel :: 3] = -cast / total[:, None]
        residual = contrast * points.value[:, channel] - logarithm
        unknown = np.full(int(self._group.max(initial=-1)) + 1, np.nan)
        rows = without_albedo(residual[good], jacobian[good], self._group[good], unknown, contrast * spread)
        # In contrasts, as errors are those of codes: else a low contrast would have small residuals.
        return rows.residual / contrast, rows.jacobian / contrast, rows.weight * contrast**2, int(good.sum())
