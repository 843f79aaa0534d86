"""Radial distortion that none of COLMAP's camera models has, as COLMAP's model with a rational function.

Programs differ in their radial polynomials: a fourth coefficient, or a polynomial that undoes the distortion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...run.errors import FiptError
from ..rig import Lens

MOST_ERROR = 0.01  # pixels; far below what calibrations are accurate to
_SAMPLES = 400  # radii to which a lens is fitted
Intrinsics = tuple[float, float, float, float]  # fx, fy, cx, cy in pixels


def distorting_lens(
    intrinsics: Intrinsics,
    size: tuple[int, int],
    coefficients: tuple[float, ...],
    tangential: tuple[float, float] = (0.0, 0.0),
) -> Lens:
    """The lens of a polynomial that distorts: r' = r (1 + k1 r^2 + k2 r^4 + ...).

    Args:
        intrinsics: fx, fy, cx, cy in pixels.
        size: width and height in pixels.
        coefficients: k1, k2, ...; any number.
        tangential: OpenCV's p1 and p2.

    Returns:
        PINHOLE, OPENCV or FULL_OPENCV. Up to three coefficients are exact; more are fitted over the image.
    """
    k = (*coefficients, 0.0, 0.0, 0.0)
    if not any(coefficients[3:]):
        if k[2] != 0.0:
            return Lens("FULL_OPENCV", (*intrinsics, k[0], k[1], *tangential, k[2], 0.0, 0.0, 0.0))
        if any((k[0], k[1], *tangential)):
            return Lens("OPENCV", (*intrinsics, k[0], k[1], *tangential))
        return Lens("PINHOLE", intrinsics)
    # Up to half a field of view of 84 degrees.
    radii = np.linspace(0.0, 10.0, 200 * _SAMPLES)[1:]
    with np.errstate(all="ignore"):
        distorted = radii * np.polyval([*reversed(coefficients), 1.0], radii**2)
    # Up to the image's corner, or to where the polynomial folds back before it.
    ends = np.nonzero((distorted > _corner(intrinsics, size)) | (np.gradient(distorted) <= 0.0))[0]
    last = int(ends[0]) if len(ends) else len(radii) - 1
    chosen = np.unique(np.linspace(0, last, _SAMPLES).astype(np.int64))
    return _fitted(intrinsics, radii[chosen], distorted[chosen], tangential)


def undistorting_lens(
    intrinsics: Intrinsics,
    size: tuple[int, int],
    undistort: Callable[[np.ndarray], np.ndarray],
) -> Lens:
    """The lens whose distorted radii, over the focal length, a function maps to undistorted ones."""
    distorted = np.linspace(0.0, _corner(intrinsics, size), _SAMPLES + 1)[1:]
    with np.errstate(all="ignore"):
        radii = undistort(distorted)
    if np.allclose(radii, distorted, rtol=0.0, atol=1e-12):
        return Lens("PINHOLE", intrinsics)
    if not (np.isfinite(radii).all() and radii[0] > 0.0 and (np.diff(radii) > 0.0).all()):
        raise _unusable()
    return _fitted(intrinsics, radii, distorted, (0.0, 0.0))


def _corner(intrinsics: Intrinsics, size: tuple[int, int]) -> float:
    """Distance of the farthest corner from the principal point over the focal length."""
    fx, fy, cx, cy = intrinsics
    if not (fx > 0.0 and fy > 0.0):
        raise _unusable()
    return float(np.hypot(max(cx, size[0] - cx) / fx, max(cy, size[1] - cy) / fy))


def _fitted(
    intrinsics: Intrinsics, radii: np.ndarray, distorted: np.ndarray, tangential: tuple[float, float]
) -> Lens:
    """FULL_OPENCV: r'/r = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3) with s = r^2, by least
    squares in the form that is linear in the coefficients."""
    square, ratio = radii**2, distorted / radii
    powers = np.stack([square, square**2, square**3], axis=1)
    matrix = np.concatenate([powers, -ratio[:, None] * powers], axis=1)
    scale = np.abs(matrix).max(axis=0)
    if not (np.isfinite(matrix).all() and (scale > 0.0).all()):
        raise _unusable()
    weights = radii[:, None]
    solved = np.linalg.lstsq(matrix / scale * weights, (ratio - 1.0) * radii, rcond=1e-15)[0] / scale
    bottom = 1.0 + powers @ solved[3:]
    error = np.abs(radii * (1.0 + powers @ solved[:3]) / bottom - distorted).max() * max(intrinsics[:2])
    if not (error <= MOST_ERROR and (bottom > 0.0).all()):
        raise _unusable()
    k1, k2, k3, k4, k5, k6 = (float(value) for value in solved)
    return Lens("FULL_OPENCV", (*intrinsics, k1, k2, *tangential, k3, k4, k5, k6))


def _unusable() -> FiptError:
    return FiptError("camera-model.unusable")
