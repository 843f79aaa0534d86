# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that enters an open mesh from directions that no photograph shows, such as an unscanned ceiling.

At points of the surfaces the radiance is albedo (B + sum of e_k D_k): B is the irradiance from all that was
seen, D_k that of a smooth part of the sky around the room of radiance 1, where it is unseen and the mesh
open. The albedo of a surface of one color is constant. In logarithms it is eliminated, and the e_k are found
by robust least squares. Their level follows from shadows, from what photographs show of the outside and, with
less weight, from usual albedos: none is above that of white paint.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..conventions import equirect_pixel_directions
from ..pixels.grouped import numbered
from ..pixels.store import PixelStore
from ..robust import deviation, gauss_newton, student_weights
from ..surface.room import Room
from .cache import VoxelGrid
from .clipped import MOST_POINTS, OUTSIDE, POINTS_PER_SAMPLE, hemisphere_rays
from .environment import Environment, map_cells

# Mean share of the hemispheres over the points through which unseen light enters, above which a mesh is open.
# Windows and the holes of scans are below 0.03 in the test rooms.
OPEN = 0.05
# Parts of the sky, and the concentration of each around its middle (as of von Mises and Fisher).
PARTS, CONCENTRATION = 32, 8.0
# Standard deviations of logarithms: of the level of the sky, of a part from that level, of the sky's color
# from gray, as photographs are white-balanced, and of a part from that color.
LEVEL, PART_LEVEL, COLOR, PART_COLOR = 2.0, 0.7, 0.15, 0.1
# Median and standard deviation (of the logarithm) of the albedos in a room, the highest, and its deviation.
ALBEDO, ALBEDO_SPREAD, MOST_ALBEDO, MOST_SPREAD = 0.4, 0.7, 0.85, 0.1
# Points of one surface whose colors differ by less, in logarithms of ratios, have one albedo.
COLOR_STEP = 0.25
LEAST_POINTS, LEAST_GROUP = 200, 8
# Radiance of what photographs show outside below which it gives no light, in units of the capture's median.
DARK_OUTSIDE = 0.01
LEAST_WEIGHT = 0.5  # of pixels that are used
_ITERATIONS, _LONGEST_STEP = 40, 0.5  # of Gauss-Newton; it ends earlier
_DARKEST = 1e-4  # radiance, in units of the capture's median


@dataclass(frozen=True, eq=False)
class OpenPoints:
    """N points of surfaces and the light that reaches them.

    Attributes:
        log_radiance: (N, 3).
        group: (N,) int from 0, points of one albedo.
        seen: (N, 3) irradiance over pi from what the photographs show.
        unseen: (N, K) irradiance over pi by each part of the sky of radiance 1.
    """

    log_radiance: np.ndarray
    group: np.ndarray
    seen: np.ndarray
    unseen: np.ndarray


def with_unseen_light(
    environment: Environment | None,
    pixels: PixelStore,
    room: Room,
    grid: VoxelGrid,
    cache: Callable[[], np.ndarray],
    label: np.ndarray,
    width: int,
    seed: int,
) -> Environment | None:
    """The environment with the light from unseen directions, where the mesh is open; else as it is.

    Args:
        cache: returns the radiance (M * 6, 3) of the cache's entries; called only where the mesh is open.
        label: (T,) int surface of each triangle, on which points of one color have one albedo.
        width: of the map in pixels.
    """
    known = np.zeros((width // 2, width), bool) if environment is None else environment.seen
    image = np.zeros((*known.shape, 3), np.float32) if environment is None else environment.image
    points = _open_points(pixels, room, grid, cache, label, (image, known), seed)
    if points is None:
        return environment
    radiance = solve_sky(points, seen_sky(image, known))
    unseen = ~known
    filled = image.copy()
    filled[unseen] = sky_parts(equirect_pixel_directions(width, width // 2)[unseen]) @ radiance
    share = 0.0 if environment is None else environment.observed_share
    cast = points.unseen @ radiance
    inferred = float((cast.sum(axis=1) / np.maximum((points.seen + cast).sum(axis=1), _DARKEST)).mean())
    return Environment(filled, share, known, inferred)


def sky_parts(directions: np.ndarray) -> np.ndarray:
    """(N, PARTS) weight of each part of the sky in unit directions (N, 3); they sum to 1."""
    index = np.arange(PARTS) + 0.5
    height, azimuth = 1.0 - 2.0 * index / PARTS, np.pi * (1.0 + 5.0**0.5) * index
    level = np.sqrt(1.0 - height**2)
    middles = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=1)
    weight = np.exp(CONCENTRATION * (np.asarray(directions, np.float64) @ middles.T - 1.0))
    return np.asarray(weight / weight.sum(axis=-1, keepdims=True))


def _open_points(
    pixels: PixelStore,
    room: Room,
    grid: VoxelGrid,
    cache: Callable[[], np.ndarray],
    label: np.ndarray,
    sky: tuple[np.ndarray, np.ndarray],
    seed: int,
) -> OpenPoints | None:
    """Points on the surfaces with their light; None where the mesh is not open, or there are too few.

    Args:
        sky: (H, W, 3) radiance from outside, and (H, W) bool, where it was seen.
    """
    rng = np.random.default_rng([seed, 23])
    share = max(1, MOST_POINTS // max(len(pixels.views), 1))
    chosen = []
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        good = (np.asarray(pixels.triangle[rows]) >= 0) & np.asarray(pixels.pure[rows])
        good &= (np.asarray(pixels.weight[rows]) >= LEAST_WEIGHT) & (pixels.own[rows] > _DARKEST).all(axis=1)
        chosen.append(rng.permutation(np.flatnonzero(good))[:share] + rows.start)
    where = np.concatenate([*chosen, np.zeros(0, np.int64)])
    if len(where) < LEAST_POINTS:
        return None
    triangle = np.asarray(pixels.triangle[where])
    nothing = np.full(len(room.triangles), -1, np.int32)
    entry, direction = hemisphere_rays(room, grid, *pixels.surface(room, where), nothing, seed)
    image, known = sky
    cell, outside = map_cells(direction, known.shape[1]), entry == OUTSIDE
    shown = known.reshape(-1)[cell]
    unknown = outside & ~shown
    if unknown.mean() < OPEN:
        return None
    seen = np.where((outside & shown)[..., None], image.reshape(-1, 3)[cell], 0.0)
    seen = np.where((entry >= 0)[..., None], cache()[np.maximum(entry, 0)], seen).mean(axis=1)
    ways = zip(unknown, direction, strict=True)
    unseen = np.stack([np.where(part[:, None], sky_parts(way), 0.0).mean(axis=0) for part, way in ways])
    logs = np.log(np.asarray(pixels.own[where], np.float64))
    ratio = np.floor((logs[:, [0, 2]] - logs[:, [1]]) / COLOR_STEP).astype(np.int64)
    group = numbered([label[triangle], *ratio.T])
    enough = np.bincount(group)[group] >= LEAST_GROUP
    if np.count_nonzero(enough) < LEAST_POINTS:
        return None
    group = np.unique(group[enough], return_inverse=True)[1].reshape(-1)
    return OpenPoints(logs[enough], group, seen[enough].astype(np.float64), unseen[enough])


def seen_sky(image: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How bright photographs show the parts of the sky.

    Args:
        image: (H, W, 3) radiance in an equirectangular map. known: (H, W) bool, where it was seen.

    Returns:
        (K,) mean logarithm of radiance, at least `DARK_OUTSIDE`, and (K,) share of each part that was seen.
    """
    height, width = known.shape
    solid = np.repeat(np.cos((np.arange(height) + 0.5) / height * np.pi - np.pi / 2), width)
    weight = sky_parts(equirect_pixel_directions(width, height).reshape(-1, 3)) * solid[:, None]
    mine = weight * known.reshape(-1, 1)
    level = np.log(np.maximum(image.reshape(-1, 3), DARK_OUTSIDE)).mean(axis=1)
    return mine.T @ level / np.maximum(mine.sum(axis=0), 1e-12), mine.sum(axis=0) / weight.sum(axis=0)


def solve_sky(points: OpenPoints, observed: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(K, 3) radiance of the parts of the sky.

    Args:
        observed: radiance and share of the parts that photographs show (:func:`seen_sky`).
    """
    parts = points.unseen.shape[1]
    prior, evidence = _sky_precision(parts), _evidence_precision(observed[1])
    expected = np.linalg.solve(prior + evidence, evidence @ np.tile(observed[0], 3))
    precision = prior + evidence

    def system(x: np.ndarray, spread: float) -> tuple[np.ndarray, np.ndarray, float]:
        normal, pull = precision.copy(), precision @ (expected - x)
        left = []
        for channel in range(3):
            mine = slice(channel * parts, (channel + 1) * parts)
            cast = points.unseen * np.exp(x[mine])
            total = np.maximum(points.seen[:, channel] + cast.sum(axis=1), _DARKEST)
            residual = points.log_radiance[:, channel] - np.log(total)
            rows = _without_albedo(residual, -cast / total[:, None], points.group, spread)
            weighted = rows.jacobian * rows.weight[:, None]
            normal[mine, mine] += weighted.T @ rows.jacobian
            pull[mine] -= weighted.T @ rows.residual
            left.append(rows.residual[: len(residual)])
        return normal, pull, deviation(np.array(left), 0.02)

    found = gauss_newton(system, expected, 0.15, most_steps=_ITERATIONS, longest=_LONGEST_STEP, settled=1e-3)
    return np.asarray(np.exp(found.x.reshape(3, parts).T))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Residuals (R,) less the albedo of their group, their derivatives (R, K), and weights (R,); the points
    first, then the prior of the albedo of each group."""

    residual: np.ndarray
    jacobian: np.ndarray
    weight: np.ndarray


def _without_albedo(residual: np.ndarray, jacobian: np.ndarray, group: np.ndarray, spread: float) -> _Rows:
    """Eliminate the logarithm of the albedo of each group; arguments as in `_Rows`, for N points."""
    size = int(group.max()) + 1
    weight = np.full(len(residual), 1.0 / (spread**2 * POINTS_PER_SAMPLE))
    albedo = np.full(size, np.log(ALBEDO))
    expected, precision = _expected_albedo(albedo)
    for _ in range(6):
        total = np.bincount(group, weight, size) + precision
        albedo = (np.bincount(group, weight * residual, size) + precision * expected) / total
        weight = student_weights(((residual - albedo[group]) / spread) ** 2) / (spread**2 * POINTS_PER_SAMPLE)
        expected, precision = _expected_albedo(albedo)
    total = np.bincount(group, weight, size) + precision
    albedo = (np.bincount(group, weight * residual, size) + precision * expected) / total
    sums = np.stack([np.bincount(group, weight * column, size) for column in jacobian.T], axis=1)
    mean = sums / total[:, None]
    return _Rows(
        np.concatenate([residual - albedo[group], expected - albedo]),
        np.concatenate([jacobian - mean[group], -mean]),
        np.concatenate([weight, precision]),
    )


def _expected_albedo(albedo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Prior mean of the logarithms of albedos (G,), and its precision.

    Robust in both directions: red paint reflects hardly any blue, and a screen is no white paint.
    """
    most = np.log(MOST_ALBEDO)
    above = albedo > most
    expected = np.where(above, most, np.log(ALBEDO))
    width = np.where(above, MOST_SPREAD, ALBEDO_SPREAD)
    return expected, student_weights(((albedo - expected) / width) ** 2) / width**2


def _sky_precision(parts: int) -> np.ndarray:
    """(3 K, 3 K) of the logarithms of the sky's radiance, channel by channel, around 0."""
    common = np.full((parts, parts), 1.0 / parts)
    level = np.eye(parts) * PART_LEVEL**2 + common * parts * LEVEL**2
    color = np.eye(parts) * PART_COLOR**2 + common * parts * COLOR**2
    gray = np.full((3, 3), 1.0 / 3.0)
    covariance = 3.0 * np.kron(gray, level) + np.kron(np.eye(3) - gray, color)
    return np.asarray(np.linalg.inv(covariance))


def _evidence_precision(share: np.ndarray) -> np.ndarray:
    """(3 K, 3 K), as `_sky_precision`, of how bright photographs show the shares (K,) of the parts.

    The seen directions of a part predict its other ones as well as a part predicts its neighbors. Their
    color, that of a wall or of grass, is hardly evidence of that of the light.
    """
    return np.asarray(np.kron(np.full((3, 3), 1.0 / 9.0), np.diag(share / PART_LEVEL**2)))
