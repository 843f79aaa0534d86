# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Corrects cameras by the edges of mesh and photographs: all together by a similarity, and single ones.

Each view has given a motion of its camera with its information. A similarity of the mesh moves what every
camera sees: turning and shifting by the pose, growth like a shift away from the middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..robust import LEAST_VIEWS
from .edges import EdgeFit, corrected_pose
from .turns import cross_matrix, turn_by

LEAST_ALONE = 4.0  # pixels by which a single camera must be off to be moved by itself
MOST = 8.0  # pixels; larger displacements are not for polishing
_ROUNDS = 5  # of reweighting views that do not agree with the others


@dataclass(frozen=True, eq=False)
class Polish:
    """Corrected cameras.

    Attributes:
        poses: camera-to-world (4, 4) of each view, in the order given.
        together: pixels by which the similarity moves the edges, root mean square over the views.
        alone: indices of views that were also moved by themselves.
    """

    poses: list[np.ndarray]
    together: float
    alone: list[int]


def polish(poses: Sequence[np.ndarray], fits: Sequence[EdgeFit | None]) -> Polish | None:
    """Correct the cameras; None where too few views have a verdict, or more than `MOST` pixels are off.

    Args:
        poses: camera-to-world (4, 4), OpenCV axes.
        fits: of each view, None without a verdict.
    """
    known = [
        (np.asarray(pose, np.float64), fit) for pose, fit in zip(poses, fits, strict=True) if fit is not None
    ]
    if len(known) < LEAST_VIEWS:
        return None
    middle = np.mean([pose[:3, 3] for pose, _ in known], axis=0)
    matrices = [_of_camera(pose, middle) for pose, _ in known]
    weights, change = np.ones(len(known)), np.zeros(7)
    for _ in range(_ROUNDS):
        normal, right = 1e-9 * np.eye(7), np.zeros(7)
        for matrix, (_, fit), weight in zip(matrices, known, weights, strict=True):
            normal += weight * matrix.T @ fit.information @ matrix
            right += weight * matrix.T @ fit.information @ fit.motion
        change = np.linalg.lstsq(normal, right, rcond=1e-10)[0]
        left = [
            _pixels(fit, fit.motion - matrix @ change)
            for matrix, (_, fit) in zip(matrices, known, strict=True)
        ]
        weights = 1.0 / (1.0 + (np.array(left) / 1.5) ** 2)  # 1.5 pixels
    moved = [_pixels(fit, matrix @ change) for matrix, (_, fit) in zip(matrices, known, strict=True)]
    together = float(np.sqrt(np.mean(np.square(moved))))
    if together > MOST:
        return None
    inverse = np.linalg.inv(_similarity(change, middle))
    result, alone = [], []
    for index, (pose, given) in enumerate(zip(poses, fits, strict=True)):
        corrected = _moved_pose(inverse, np.asarray(pose, np.float64))
        if given is not None:
            own = given.motion - _of_camera(np.asarray(pose, np.float64), middle) @ change
            if LEAST_ALONE < _pixels(given, own) <= MOST:
                corrected = corrected_pose(corrected, own)
                alone.append(index)
        result.append(corrected)
    return Polish(result, together, alone)


def _of_camera(pose: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """(6, 7) motion of what a camera sees by turn, shift and growth of the world about a middle."""
    back, arm = pose[:3, :3].T, pose[:3, 3] - middle
    matrix = np.zeros((6, 7))
    matrix[:3, :3] = back
    matrix[3:, :3] = -back @ cross_matrix(arm)
    matrix[3:, 3:6] = back
    matrix[3:, 6] = back @ arm
    return matrix


def _similarity(change: np.ndarray, middle: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.exp(change[6]) * turn_by(change[:3])
    matrix[:3, 3] = middle - matrix[:3, :3] @ middle + change[3:6]
    return matrix


def _moved_pose(similarity: np.ndarray, pose: np.ndarray) -> np.ndarray:
    moved = similarity @ pose
    moved[:3, :3] /= np.cbrt(np.linalg.det(moved[:3, :3]))
    return np.asarray(moved)


def _pixels(fit: EdgeFit, motion: np.ndarray) -> float:
    return float(np.sqrt(max(motion @ fit.squares @ motion, 0.0)))
