"""Which triangles of the room a view sees, from few rays: one through each pixel of a coarse image, and one
to the centroid of each triangle, because small triangles fall between the pixels.
"""

from __future__ import annotations

import numpy as np

from ..capture.views import View
from ..conventions import project
from ..pixels.camera_rays import first_hits, rays_along, trace_pixels
from ..surface.room import Room

GRID = 256  # pixels along the longer side
_COINCIDENT = 2e-5  # of the distance: coincident faces do not occlude each other


def view_coverage(room: Room, view: View, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Which triangles a view sees, whatever their size.

    Args:
        known: (T,) bool, triangles that are in sight of earlier views. Outside the image they are not tested
            again, which saves rays.

    Returns:
        (T,) bool, whether some point of each triangle is seen; (T,) bool, whether it is seen or, if it was
        not `known`, its centroid would be visible to the camera after a rotation towards it; and the share,
        0..1, of the pixels that see the mesh.
    """
    triangle = coarse_triangles(room, coarse_view(view))
    seen, in_sight = _centroids_seen(room, view, known)
    seen[triangle[triangle >= 0]] = True
    return seen, seen | in_sight, float((triangle >= 0).mean())


def coarse_view(view: View) -> View:
    """The same camera with at most `GRID` pixels along its longer side."""
    factor = min(1.0, GRID / max(view.width, view.height))
    return view.resized(max(1, round(view.width * factor)), max(1, round(view.height * factor)))


def resampled(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) values of an image (H, W), read at the centres of the pixels of an image of another size."""
    rows, columns = (
        ((np.arange(count) + 0.5) * of / count).astype(np.int64)
        for count, of in zip(shape, image.shape, strict=True)
    )
    return image[np.ix_(rows, columns)]


def coarse_triangles(room: Room, view: View) -> np.ndarray:
    """(H * W,) int32 triangle that each pixel sees, -1 where none."""
    return first_hits(trace_pixels(room, view))[0].astype(np.int32)


def _centroids_seen(room: Room, view: View, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two (T,) bool: whether each triangle's centroid is in the image and not occluded; and whether it is not
    occluded, also outside the image. Outside, only triangles that are not `known` are tested.
    """
    centroid = room.vertices[room.triangles].mean(axis=1, dtype=np.float64)
    place, _ = project(centroid, view)  # NaN behind the camera
    inside = ((place >= 0.0) & (place <= (view.width, view.height))).all(axis=1)
    traced = np.flatnonzero(inside | ~known)
    unhidden = np.zeros(len(known), bool)
    if len(traced):
        origin = np.asarray(view.camera_to_world, np.float64)[:3, 3]
        toward = centroid[traced] - origin
        distance = np.maximum(np.linalg.norm(toward, axis=1), 1e-20)
        triangle, reached = first_hits(room.intersect(rays_along(origin, toward / distance[:, None])))
        beyond = np.isfinite(reached) & (reached > distance * (1.0 - _COINCIDENT))
        unhidden[traced] = (triangle == traced) | beyond
    return inside & unhidden, unhidden
