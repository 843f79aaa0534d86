# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses of cameras (4, 4) with OpenCV axes, and random rotations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def look_at(
    origin: Sequence[float] | np.ndarray,
    target: Sequence[float] | np.ndarray,
    up: Sequence[float] = (0.0, 0.0, 1.0),
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
