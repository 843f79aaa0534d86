"""Ray queries against the exported room and other triangles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mathutils.bvhtree import BVHTree

from ...core.run.run_files import RoomMesh

# (origin (3,), unit direction (3,)) -> (point (3,), normal (3,)) of the first surface, or None.
Cast = Callable[[np.ndarray, np.ndarray], "tuple[np.ndarray, np.ndarray] | None"]


def corner_tree(corners: np.ndarray) -> BVHTree:
    """A tree of T triangles by their corners (T, 3, 3)."""
    triangles = np.arange(3 * len(corners)).reshape(-1, 3).tolist()
    return BVHTree.FromPolygons(corners.reshape(-1, 3).tolist(), triangles, all_triangles=True)


def make_cast(room: RoomMesh) -> Cast:
    """A function that casts rays into the exported room."""
    tree = BVHTree.FromPolygons(room.vertices.tolist(), room.triangles.tolist(), all_triangles=True)
    low, high = room.vertices.min(axis=0), room.vertices.max(axis=0)
    # Moves the origin off the surface that a ray starts on; relative, as the room may have any size.
    nudge = 1.0e-5 * float(np.linalg.norm(high - low))

    def cast(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        point, normal, _, _ = tree.ray_cast(tuple(origin + nudge * direction), tuple(direction))
        return None if point is None else (np.array(point), np.array(normal))

    return cast
