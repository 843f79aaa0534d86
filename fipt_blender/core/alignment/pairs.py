"""The similarity of pairs of points in closed form.

Source: Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two Point Patterns", 1991.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.errors import FiptError

MIN_PAIRS = 3  # of points: a similarity has seven unknowns
FLAT = 1e-4  # spread across a line over the spread along it, below which a turn about the line is undecided
MIRRORED = 0.5  # share of the error that is left if one side is mirrored, below which it is said


@dataclass(frozen=True, eq=False)
class PairFit:
    """A similarity fitted to pairs of points."""

    similarity: np.ndarray  # (4, 4) float64 from source to target
    residuals: np.ndarray  # (N,) distances in units of the target
    mirrored: bool  # the pairs fit much better if one side is mirrored: a mesh with a negated axis

    @property
    def error(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residuals**2)))


def fit_pairs(source: np.ndarray, target: np.ndarray) -> PairFit:
    """Fit the similarity that maps source points to target points with the least squares.

    Args:
        source, target: (N, 3) points, N of at least 3, not all on one line.
    """
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3:
        raise ValueError(f"pairs of shapes {source.shape} and {target.shape}")
    if len(source) < MIN_PAIRS:
        raise undecided(f"{len(source)} pairs of points are too few")
    for name, points in (("photographs", source), ("mesh", target)):
        if not np.isfinite(points).all():
            raise undecided(f"A point of the {name} is not finite")
        refuse_line(points, name)
    fitted = fit_similarity(source, target)
    residuals = _distances(fitted, source, target)
    flat = np.linalg.svd(source - source.mean(axis=0), compute_uv=False)
    mirrored = False
    if len(source) > MIN_PAIRS and flat[2] > 1e-3 * flat[0]:  # points in one plane fit both ways
        other = source * [-1.0, 1.0, 1.0]
        left = _distances(fit_similarity(other, target), other, target)
        mirrored = bool(np.linalg.norm(left) < MIRRORED * np.linalg.norm(residuals))
    return PairFit(fitted, residuals, mirrored)


def fit_similarity(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The similarity (4, 4) with the least squares of target - (s R source + t); points (N, 3) float64."""
    middles = source.mean(axis=0), target.mean(axis=0)
    centred_source, centred_target = source - middles[0], target - middles[1]
    u, values, vt = np.linalg.svd(centred_target.T @ centred_source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt)) or 1.0])
    rotation = (u * signs) @ vt
    scale = float(values @ signs) / float((centred_source**2).sum())
    result = np.eye(4)
    result[:3, :3] = scale * rotation
    result[:3, 3] = middles[1] - result[:3, :3] @ middles[0]
    return result


def _distances(similarity: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    mapped = source @ similarity[:3, :3].T + similarity[:3, 3]
    return np.asarray(np.linalg.norm(mapped - target, axis=1))


def refuse_line(points: np.ndarray, name: str) -> None:
    """Refuse points (N, 3) of what has a name that lie on one line."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not spread[1] > FLAT * spread[0]:
        raise undecided(f"The points of the {name} lie on one line")


def undecided(
    text: str, remedy: str = "Pick three or more pairs of points far apart, not on one line."
) -> FiptError:
    """The error for picked points that do not decide a placement."""
    return FiptError("alignment-pairs.undecided", text=text, remedy=remedy)
