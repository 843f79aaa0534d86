# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The similarity from a solve's sparse points to the room's mesh, without a guess to start from.

Many starts (turns, scales) are improved coarsely; the best are improved with the scale free. Errors are
measured over the scale, in units of the solve: otherwise shrinking the points onto a wall would fit best.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robust import MAD_TO_DEVIATION
from ..run.errors import FiptError
from .surface import Surface, main_axes
from .turns import even_turns, rotation_between

LEAST_POINTS = 50  # of a solve
_SCALES = np.array([0.6, 0.75, 0.9, 1.05, 1.25, 1.5])  # of the extents' ratio: points miss part of the room
_YAWS = 24  # turns about a known up direction; improving bridges half of 15 degrees with ease
_COARSE_STEPS = 6  # of improving with few points
_STEPS = 25  # of improving with all points
_CAP = 0.05  # of the points' extent: farther points count as outliers
# Widths of the weights over the standard deviation of the distances: while searching, and while polishing,
# where wrong points, of which solves have many, would pull the result by some millimeters.
_SEARCHED, _POLISHED = 3.0, 1.0
_SAME = 0.02  # candidates closer than this, over the extent, are one


@dataclass(frozen=True, eq=False)
class Candidate:
    """A possible alignment.

    Attributes:
        similarity: (4, 4) float64 from the solve to the mesh.
        error: median distance of the points from the mesh, in units of the mesh.
        inliers: share of the points within `_CAP` of the points' extent.
        score: mean distance over the points' extent, outliers capped; the less, the better.
    """

    similarity: np.ndarray
    error: float
    inliers: float
    score: float


def register(
    points: np.ndarray, surface: Surface, rng: np.random.Generator, up: np.ndarray | None = None
) -> list[Candidate]:
    """Find where the points of a solve lie on a mesh.

    Args:
        points: (N, 3) sparse points of the solve.
        surface: of the mesh.
        rng: chooses points for the coarse search.
        up: (3,) the direction in the solve in which the cameras' tops point on average; it may be off by some
            degrees, and makes the search shorter. None where it is not known.

    Returns:
        The best alignments, the best first; several where the room looks the same from several sides.

    Raises:
        FiptError: ``alignment-points`` for too few points.
    """
    points = np.asarray(points, np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < LEAST_POINTS:
        raise FiptError(
            "alignment-points",
            f"The camera solve has {len(points)} points; an alignment needs at least {LEAST_POINTS}.",
            "Align by pairs of points, or solve the cameras with more features.",
        )
    source, from_source = _normalized(points)
    from_target = _normalized(surface.points)[1]
    fine = surface.moved(from_target)
    coarse = fine.part(rng.permutation(len(fine.points))[:6000])
    some = source[rng.permutation(len(source))[:100]]
    starts = _starts(source, fine.points, main_axes(surface.normals), up)
    improved = _improved(some, coarse, starts, _COARSE_STEPS, free_scale=False)
    rough = _ranked(some, coarse, improved)[:24]  # improved with the scale free
    rough = _improved(some, coarse, rough, 2 * _COARSE_STEPS, free_scale=True)
    found = _improved(source, fine, rough, _STEPS, free_scale=True)
    different = _different(_ranked(source, fine, found), source)[:6]
    return _candidates(source, fine, different, np.linalg.inv(from_target), from_source)


def refine(points: np.ndarray, surface: Surface, similarity: np.ndarray) -> Candidate:
    """Improve an alignment that is nearly right, one from pairs of points for example.

    Args:
        points: (N, 3) sparse points of the solve.
        surface: of the mesh.
        similarity: (4, 4) from the solve to the mesh.
    """
    source, from_source = _normalized(np.asarray(points, np.float64))
    from_target = _normalized(surface.points)[1]
    fine = surface.moved(from_target)
    start = from_target @ similarity @ np.linalg.inv(from_source)
    better = _improved(source, fine, start[None], _STEPS, free_scale=True, reach=_CAP)
    return _candidates(source, fine, better, np.linalg.inv(from_target), from_source)[0]


def _normalized(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points with their middle at the origin and an extent of 1, and the similarity (4, 4) that led there.

    The extent leaves out a few points far away, which every solve has.
    """
    low, high = np.percentile(points, [2.0, 98.0], axis=0)
    size = float(np.linalg.norm(high - low)) or 1.0
    matrix = np.eye(4)
    matrix[:3, :3] /= size
    matrix[:3, 3] = -0.5 * (low + high) / size
    return points @ matrix[:3, :3].T + matrix[:3, 3], matrix


# ---------------------------------------------------------------------------------------------------- starts


def _starts(source: np.ndarray, target: np.ndarray, axes: np.ndarray, up: np.ndarray | None) -> np.ndarray:
    """Similarities (S, 4, 4) from which the search starts: turns, and for each the scales of `_SCALES`.

    Args:
        source, target: normalized points of the solve and of the mesh.
        axes: (3, 3) main directions of the mesh, one a row.
        up: up direction in the solve, or None.
    """
    in_axes = target @ axes.T
    target_low, target_high = np.percentile(in_axes, [1.0, 99.0], axis=0)
    starts = []
    for turn in _turns(axes, up):
        turned = source @ (axes @ turn).T
        low, high = np.percentile(turned, [2.0, 98.0], axis=0)
        ratio = float(np.median((target_high - target_low) / np.maximum(high - low, 1e-6)))
        for scale in ratio * _SCALES:
            start = np.eye(4)
            start[:3, :3] = scale * turn
            start[:3, 3] = axes.T @ (0.5 * (target_low + target_high) - 0.5 * scale * (low + high))
            starts.append(start)
    return np.stack(starts)


def _turns(axes: np.ndarray, up: np.ndarray | None) -> list[np.ndarray]:
    """Rotations (3, 3) from the solve to the mesh."""
    if up is None:
        return list(even_turns(576))  # evenly spread turns without one, about 30 degrees apart
    upright = rotation_between(np.asarray(up, np.float64), np.array([0.0, 0.0, 1.0]))
    angles = 2.0 * np.pi * np.arange(_YAWS) / _YAWS
    yaws = [
        np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]]) for a in angles
    ]
    ups = [rotation_between(np.array([0.0, 0.0, 1.0]), sign * axis) for axis in axes for sign in (1.0, -1.0)]
    return [to_axis @ yaw @ upright for to_axis in ups for yaw in yaws]


# ----------------------------------------------------------------------------------------------- improvement


def _improved(
    source: np.ndarray,
    target: Surface,
    starts: np.ndarray,
    steps: int,
    free_scale: bool,
    reach: float = 0.2,
    exact: bool = False,
) -> np.ndarray:
    """Gauss-Newton steps on the distances along the nearest normals, far points weighted less and less.

    Args:
        source: (N, 3) normalized points.
        target: the mesh.
        starts: (S, 4, 4) similarities, each improved by itself.
        steps: how many.
        free_scale: improve the scale, too.
        reach: distance, over the points' extent, from which points count less at first.
        exact: measure distances from the triangles.

    Returns:
        (S, 4, 4).
    """
    current = starts
    for step in range(steps):
        positions = _placed(source, current)
        scales = _scales(current)[:, None]
        distances, along, normals = _nearest(target, positions, exact)
        # Tukey's weights; the reach shrinks to what most points are off by.
        spread = MAD_TO_DEVIATION * np.median(np.abs(along), axis=1, keepdims=True)
        spread *= _POLISHED if exact else _SEARCHED
        width = np.maximum(reach * scales * 0.8**step, np.maximum(spread, 1e-4 * scales))
        weights = np.maximum(1.0 - (distances / (2.0 * width)) ** 2, 0.0) ** 2 + 1e-9
        middles = np.einsum("sn,snc->sc", weights, positions) / weights.sum(axis=1, keepdims=True)
        arms = positions - middles[:, None]
        columns = [_cross(arms, normals), normals]
        if free_scale:
            columns.append((arms * normals).sum(axis=2, keepdims=True) - along[..., None])
        matrix = np.concatenate(columns, axis=2)
        weighted = np.swapaxes(matrix * weights[..., None], 1, 2)
        normal = weighted @ matrix
        size = normal.shape[1]
        damping = 1e-6 * np.trace(normal, axis1=1, axis2=2) / size + 1e-12
        normal += damping[:, None, None] * np.eye(size)
        change = np.linalg.solve(normal, -(weighted @ along[..., None]))[..., 0]
        current = _moved(change, middles) @ current
    return current


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Cross products (..., 3); np.cross takes several times as long."""
    x, y, z = np.moveaxis(first, -1, 0)
    u, v, w = np.moveaxis(second, -1, 0)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _moved(change: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Similarities (S, 4, 4) of small turns, shifts and, if it is there, growth about middles (S, 3)."""
    angle = np.linalg.norm(change[:, :3], axis=1)[:, None, None]
    x, y, z = change[:, :3].T
    zero = np.zeros_like(x)
    cross = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    growth = np.exp(np.clip(change[:, 6], -0.2, 0.2)) if change.shape[1] == 7 else np.ones(len(change))
    result = np.tile(np.eye(4), (len(change), 1, 1))
    result[:, :3, :3] = growth[:, None, None] * (np.eye(3) + first * cross + second * cross @ cross)
    result[:, :3, 3] = middles - np.einsum("sij,sj->si", result[:, :3, :3], middles) + change[:, 3:6]
    return result


def _placed(source: np.ndarray, similarities: np.ndarray) -> np.ndarray:
    """The points (N, 3) mapped by each similarity (S, 4, 4): (S, N, 3)."""
    return source @ np.swapaxes(similarities[:, :3, :3], 1, 2) + similarities[:, None, :3, 3]


def _scales(similarities: np.ndarray) -> np.ndarray:
    return np.asarray(np.cbrt(np.linalg.det(similarities[:, :3, :3])))


def _nearest(
    target: Surface, positions: np.ndarray, exact: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (S, N), distances along the normals (S, N) and normals (S, N, 3) of positions (S, N, 3)."""
    flat = positions.reshape(-1, 3)
    distances, along, normals = target.nearest_triangle(flat) if exact else target.nearest_point(flat)
    shape = positions.shape[:2]
    return distances.reshape(shape), along.reshape(shape), normals.reshape(*shape, 3)


def _off(source: np.ndarray, target: Surface, similarities: np.ndarray, exact: bool = False) -> np.ndarray:
    """(S, N) distances of the points from the mesh over the scale."""
    distances = _nearest(target, _placed(source, similarities), exact)[0]
    return distances / _scales(similarities)[:, None]


def _ranked(source: np.ndarray, target: Surface, similarities: np.ndarray) -> np.ndarray:
    """The similarities, the one first that leaves the points nearest to the mesh."""
    scores = np.minimum(_off(source, target, similarities), _CAP).mean(axis=1)
    return np.asarray(similarities[np.argsort(scores, kind="stable")])


def _different(ranked: np.ndarray, source: np.ndarray) -> np.ndarray:
    """The similarities (S, 4, 4) that put the points elsewhere than all before them."""
    kept: list[int] = []
    places = _placed(source, ranked)
    for index, scale in enumerate(_scales(ranked)):
        apart = (np.sqrt(np.mean((places[index] - places[other]) ** 2)) for other in kept)
        if all(distance > _SAME * scale for distance in apart):
            kept.append(index)
    return ranked[kept]


def _candidates(
    source: np.ndarray, target: Surface, found: np.ndarray, to_mesh: np.ndarray, from_source: np.ndarray
) -> list[Candidate]:
    """The similarities polished with the mesh's triangles in place of points on them, the best first.

    Args:
        source, target: normalized points and mesh.
        found: (S, 4, 4) similarities between them.
        to_mesh: (4, 4) from the normalized mesh to the mesh.
        from_source: (4, 4) from the solve to the normalized points.
    """
    polished = _improved(source, target, found, _STEPS, free_scale=True, reach=0.01, exact=True)
    polished = _different(_ranked(source, target, polished), source)
    candidates = []
    for normalized, off in zip(polished, _off(source, target, polished, exact=True), strict=True):
        similarity = to_mesh @ normalized @ from_source
        scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
        candidates.append(
            Candidate(
                similarity=similarity,
                error=float(np.median(off)) * scale / float(from_source[0, 0]),
                inliers=float((off < _CAP).mean()),
                score=float(np.minimum(off, _CAP).mean()),
            )
        )
    return sorted(candidates, key=lambda candidate: candidate.score)
