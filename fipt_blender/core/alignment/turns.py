"""Rotations: evenly spread, between two directions, about a vector. Needs only numpy."""

from __future__ import annotations

import numpy as np


def even_turns(count: int) -> np.ndarray:
    """(count, 3, 3) rotations spread evenly: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    index = np.arange(count) + 0.5
    share, first, second = (
        index / count,
        2.0 * np.pi * index / np.sqrt(2.0),
        2.0 * np.pi * index / 1.533751168755,
    )
    inner, outer = np.sqrt(share), np.sqrt(1.0 - share)
    x, y, z, w = inner * np.sin(first), inner * np.cos(first), outer * np.sin(second), outer * np.cos(second)
    return np.moveaxis(quaternion_rotation(np.stack([w, x, y, z])), -1, 0)


def quaternion_rotation(wxyz: np.ndarray) -> np.ndarray:
    """(3, 3, ...) rotations of quaternions w, x, y, z (4, ...) of length 1."""
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The shortest rotation (3, 3) from one direction to another."""
    start, end = start / np.linalg.norm(start), end / np.linalg.norm(end)
    axis, cosine = np.cross(start, end), float(start @ end)
    if cosine < -1.0 + 1e-9:
        side = np.cross(start, np.eye(3)[int(np.argmin(np.abs(start)))])
        side /= np.linalg.norm(side)
        return np.asarray(2.0 * np.outer(side, side) - np.eye(3))
    cross = cross_matrix(axis)
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) that gives the cross product of a vector (3,) with another."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def moved_about(middle: np.ndarray, turn: np.ndarray, shift: np.ndarray, scale: float) -> np.ndarray:
    """The similarity (4, 4) that turns by a vector (3,) and grows about a point (3,), then shifts (3,)."""
    change = np.eye(4)
    change[:3, :3] = scale * turn_by(turn)
    change[:3, 3] = middle - change[:3, :3] @ middle + shift
    return change


def turn_by(vector: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) about a vector (3,) by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    cross = cross_matrix(np.asarray(vector, np.float64))
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
