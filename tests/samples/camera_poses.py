"""Poses of cameras (4, 4) with OpenCV axes, and random rotations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def look_at(
    origin: Sequence[float] | np.ndarray, target: Sequence[float] | np.ndarray, up: Sequence[float] = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """Camera-to-world of a camera at `origin` that looks at `target`; level with the default `up`."""
    forward = np.subtract(target, origin)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, np.asarray(origin)], axis=1)
    return pose


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A rotation (3, 3)."""
    orthogonal, triangular = np.linalg.qr(rng.normal(size=(3, 3)))
    orthogonal = orthogonal * np.sign(np.diag(triangular))
    return orthogonal * np.sign(np.linalg.det(orthogonal))


def drawn_similarity(rng: np.random.Generator, scale: float) -> np.ndarray:
    """A similarity (4, 4) of some scale: any rotation, and a shift of a few of its units."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * random_rotation(rng)
    matrix[:3, 3] = 3.0 * scale * rng.normal(size=3)
    return matrix
