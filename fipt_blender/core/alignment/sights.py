"""The similarity of points that were picked on a mesh and in photographs: each photograph gives a ray.

Distances from rays are linear in scale and shift once the rotation is known, so that rotations all around are
tried; the best are improved by Levenberg-Marquardt on the angles between rays and points. Needs only numpy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .pairs import MIN_PAIRS, MIRRORED, PairFit, fit_pairs, refuse_line, undecided
from .turns import cross_matrix, even_turns, moved_about

_TURNS = 1000  # rotations that are tried, about 25 degrees apart
_MIN_NUMBERS = 7  # of a similarity; a ray gives two, a point three


@dataclass(frozen=True, eq=False)
class Sights:
    """Where the picked points are in the coordinates of the cameras."""

    pair: np.ndarray  # (K,) index of the pair that each belongs to
    origin: np.ndarray  # (K, 3) the camera's position, or the point itself where it is known
    direction: np.ndarray  # (K, 3) unit direction from the camera, or zeros where the point is known

    @property
    def is_point(self) -> np.ndarray:
        """(K,) bool."""
        return ~self.direction.any(axis=1)

    def beside(self, positions: np.ndarray) -> np.ndarray:
        """(..., K, 3) offsets of positions (..., K, 3) from the rays, or from the points."""
        offset = positions - self.origin
        along = (offset * self.direction).sum(axis=-1, keepdims=True)
        return np.asarray(offset - along * self.direction)


def fit_sights(sights: Sights, target: np.ndarray) -> PairFit:
    """Fit the similarity from the coordinates of the cameras to those of the mesh.

    Args:
        sights: of the pairs in the photographs.
        target: (N, 3) the pairs' points on the mesh.

    Returns:
        The similarity; as residual of a pair, the largest distance of its mesh point from its rays.
    """
    target = np.asarray(target, np.float64)
    known = sights.is_point
    if known.all() and len(np.unique(sights.pair)) == len(sights.pair):
        order = np.argsort(sights.pair)
        return fit_pairs(sights.origin[order], target[sights.pair[order]])
    _check_count(sights, target)
    inverse, cost = _solve(sights, target)
    if not np.isfinite(cost):
        raise undecided("No placement puts all points in front of the cameras that see them")
    mirrored = False
    flat = np.linalg.svd(target - target.mean(axis=0), compute_uv=False)
    # Points in one plane fit both ways, and too few points fit anything.
    if 3 * known.sum() + 2 * (~known).sum() > _MIN_NUMBERS + 2 and flat[2] > 1e-3 * flat[0]:
        mirrored = bool(_solve(sights, target * [-1.0, 1.0, 1.0])[1] < MIRRORED**2 * cost)
    residuals = np.zeros(len(target))
    positions = target[sights.pair] @ inverse[:3, :3].T + inverse[:3, 3]
    distances = np.linalg.norm(sights.beside(positions), axis=1) / np.cbrt(np.linalg.det(inverse[:3, :3]))
    np.maximum.at(residuals, sights.pair, distances)
    return PairFit(np.linalg.inv(inverse), residuals, mirrored)


def _check_count(sights: Sights, target: np.ndarray) -> None:
    known = sights.is_point
    numbers = 3 * int(known.sum()) + 2 * int((~known).sum())
    if len(np.unique(sights.pair)) < MIN_PAIRS or numbers < _MIN_NUMBERS:
        remedy = "Pick three points through two views each, or four or more points through one view each."
        raise undecided("There are too few picked points", remedy)
    cameras = np.unique(np.round(sights.origin[~known], 9), axis=0)
    if len(cameras) < 2 and known.sum() < 2:
        text = "All points were picked through one view, which leaves the scale open"
        raise undecided(text, "Pick some of them through a second view.")
    refuse_line(target, "mesh")


def _solve(sights: Sights, target: np.ndarray) -> tuple[np.ndarray, float]:
    """The similarity (4, 4) from the mesh to the cameras, and the sum of its squared angles."""
    middle = sights.origin.mean(axis=0)
    size = float(np.sqrt(((sights.origin - middle) ** 2).sum(axis=1).mean())) or 1.0
    near = Sights(sights.pair, (sights.origin - middle) / size, sights.direction)
    best, least, derivatives = np.eye(4), np.inf, np.zeros((1, 7))
    for start in _starts(near, target):
        found, cost, matrix = _improved(near, target, start)
        if cost < least:
            best, least, derivatives = found, cost, matrix
    if np.isfinite(least):
        values = np.linalg.svd(derivatives / np.maximum(np.linalg.norm(derivatives, axis=0), 1e-12))[1]
        if len(values) < 7 or values[-1] < 1e-5 * values[0]:
            raise undecided("The picked points leave the placement open")
    back = np.eye(4)
    back[:3, :3] *= size
    back[:3, 3] = middle
    return back @ best, least


def _starts(sights: Sights, target: np.ndarray) -> np.ndarray:
    """Similarities (S, 4, 4) from the mesh to the cameras: those rotations that come nearest to the rays."""
    turns = even_turns(_TURNS)
    turned = np.einsum("sij,kj->ski", turns, target[sights.pair])
    projectors = np.eye(3) - sights.direction[:, :, None] * sights.direction[:, None, :]
    # P (s R q + t - o) = 0 is linear in s and t.
    columns = np.empty((_TURNS, len(projectors), 3, 4))
    columns[..., 0] = np.einsum("kij,skj->ski", projectors, turned)
    columns[..., 1:] = projectors
    right = np.einsum("kij,kj->ki", projectors, sights.origin).reshape(-1)
    flat = columns.reshape(_TURNS, -1, 4)
    normal = np.swapaxes(flat, 1, 2) @ flat
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    solved = np.linalg.solve(normal, (np.swapaxes(flat, 1, 2) @ right)[..., None])[..., 0]
    left = np.linalg.norm(flat @ solved[..., None] - right[:, None], axis=(1, 2))
    usable = solved[:, 0] > 1e-9
    order = np.argsort(np.where(usable, left / np.maximum(solved[:, 0], 1e-9), np.inf))[:12]
    starts = np.tile(np.eye(4), (len(order), 1, 1))
    starts[:, :3, :3] = np.maximum(solved[order, 0], 1e-3)[:, None, None] * turns[order]
    starts[:, :3, 3] = solved[order, 1:]
    return starts


def _improved(sights: Sights, target: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Levenberg-Marquardt from one start.

    Returns:
        The similarity, the sum of squared angles (infinite where a point is behind its camera) and the
        derivatives (3 K, 7) by turn, shift and growth.
    """
    points = target[sights.pair]
    current, damping = start, 1e-3
    residual, matrix = _angles(sights, points, current)
    for _ in range(40):
        normal, slope = matrix.T @ matrix, matrix.T @ residual
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), -slope)
        middle = points.mean(axis=0) @ current[:3, :3].T + current[:3, 3]
        growth = float(np.exp(np.clip(step[6], -1.0, 1.0)))
        tried = moved_about(middle, step[:3], step[3:6], growth) @ current
        new_residual, new_matrix = _angles(sights, points, tried)
        if new_residual @ new_residual < residual @ residual:
            current, residual, matrix, damping = tried, new_residual, new_matrix, 0.3 * damping
        else:
            damping = 10.0 * damping
        if damping > 1e8:
            break
    toward = (points @ current[:3, :3].T + current[:3, 3] - sights.origin) * sights.direction
    behind = bool((toward.sum(axis=1) < 0.0).any())
    return current, np.inf if behind else float(residual @ residual), matrix


def _angles(sights: Sights, points: np.ndarray, similarity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (3 K,) in radians between rays and points, and their derivatives (3 K, 7).

    Where the point itself is known, its distance counts as if seen from a camera at the typical distance.
    """
    positions = points @ similarity[:3, :3].T + similarity[:3, 3]
    projectors = np.eye(3) - sights.direction[:, :, None] * sights.direction[:, None, :]
    depths = np.linalg.norm(positions - sights.origin, axis=1)
    known = sights.is_point
    typical = float(np.median(depths[~known])) if (~known).any() else 1.0
    weights = 1.0 / np.maximum(np.where(known, typical, depths), 1e-9)
    middle = positions.mean(axis=0)
    arms = positions - middle
    turns = -np.stack([cross_matrix(arm) for arm in arms])
    shifts = np.tile(np.eye(3), (len(arms), 1, 1))
    columns = np.concatenate([turns, shifts, arms[..., None]], axis=2)
    residual = weights[:, None] * sights.beside(positions)
    return residual.reshape(-1), (weights[:, None, None] * (projectors @ columns)).reshape(-1, 7)
