# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The convex hull of a room, by half-spaces that hold nearly all of its points: outliers do not matter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DIRECTIONS = 600  # of the half-spaces, evenly over the sphere: 5 degrees apart
WALLS = 24  # of them, those that most normals are near, are turned to the mean of these
INSIDE = 99.5  # percent of the points that each holds


@dataclass(frozen=True, eq=False)
class Hull:
    """Half-spaces `normals @ point <= offsets`: (K, 3) outward unit vectors and (K,) distances."""

    normals: np.ndarray
    offsets: np.ndarray

    @classmethod
    def around(cls, points: np.ndarray, normals: np.ndarray, certain: np.ndarray) -> Hull:
        """The hull of a surface.

        Args:
            points: (N, 3), most of which are inside.
            normals: (M, 3) unit vectors of its largest parts, with either sign.
            certain: (K, 3) points that all are inside.
        """
        index = np.arange(DIRECTIONS) + 0.5
        z, turn = 1.0 - 2.0 * index / DIRECTIONS, index * np.pi * (1.0 + np.sqrt(5.0))
        flat = np.sqrt(1.0 - z**2)
        faces = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
        both = np.concatenate([normals, -normals])
        nearest = (both @ faces.T).argmax(axis=1)
        for face in np.argsort(np.bincount(nearest, minlength=DIRECTIONS))[::-1][:WALLS]:
            if (nearest == face).any():
                mean = both[nearest == face].mean(axis=0)
                faces[face] = mean / np.linalg.norm(mean)
        offsets = [
            max(float(np.percentile(points @ face, INSIDE)), float((certain @ face).max())) for face in faces
        ]
        return cls(faces, np.array(offsets))

    def depth(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(...) multiples of directions (3, ...) after which rays from an inner point (3,) leave."""
        left = np.maximum(self.offsets - self.normals @ origin, 0.0)
        nearest = np.full(directions.shape[1:], np.inf)
        for normal, distance in zip(self.normals, left, strict=True):
            along = np.tensordot(normal, directions, 1)
            reached = np.divide(distance, along, out=np.full_like(along, np.inf), where=along > 1e-9)
            nearest = np.minimum(nearest, reached)
        return nearest
