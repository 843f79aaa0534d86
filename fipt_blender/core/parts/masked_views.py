"""Views with part masks, and the part that they show at points in front of a scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..capture.views import View
from ..conventions import project
from ..pixels.camera_rays import first_hits, trace_pixels
from ..pixels.grouped import pairs_of
from ..surface.room import Room
from .labels import NO_PART, at_border, choose_parts

# Share of the views of a point that may show another part there, because of errors of masks and poses.
MISSES = 0.1
# A plane of the scan belongs to the parts that have at least this share of its area.
LEAST_OWN = 0.5


@dataclass(frozen=True)
class MaskedView:
    """A view with its mask and what it sees of the scan.

    Attributes:
        view: with masks.
        mask: (H, W) part ids.
        distance: (H, W) float32 metres to the scan, infinite where a ray meets nothing.
        same: (H, W) bool, whether the scan shows the mask's part.
        found: (N,) int, for each id, interior pixels that meet a triangle of the part.
        pixels: (N,) int, for each id, interior pixels.
    """

    view: View
    mask: np.ndarray
    distance: np.ndarray
    same: np.ndarray
    found: np.ndarray
    pixels: np.ndarray

    @property
    def place(self) -> np.ndarray:
        """(3,) of the camera, metres."""
        return np.asarray(self.view.camera_to_world[:3, 3])

    def shown(self, part: int) -> np.ndarray:
        """(H, W) int8: 1 where the view shows the part, -1 where another one that the scan has, else 0."""
        known = 2 * self.found >= self.pixels  # a part that the scan lost may occlude this one
        known[0] = True
        return np.where(self.mask == part, 1, np.where(known[self.mask], -1, 0)).astype(np.int8)

    def seen(self, points: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The points (N, 3) that the view sees in front of the scan: their rows; rows and columns of pixels.

        Args:
            tolerance: metres by which they are in front of it.
        """
        rows, pixel = seen_before(self.view, self.distance.reshape(-1), points, tolerance)
        return rows, *np.divmod(pixel, self.view.width)


def seen_before(
    view: View, distance: np.ndarray, points: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """The points (N, 3) that a view sees in front of its surfaces: their rows, and the pixels (row-major).

    Args:
        distance: (H * W,) metres to the surfaces.
        tolerance: metres by which points are in front of them.
    """
    place, depth = project(points, view)
    within = (depth > 0.0) & (place >= 0.0).all(axis=1)
    within &= (place[:, 0] < view.width) & (place[:, 1] < view.height)
    rows = np.flatnonzero(within)
    x, y = place[rows].astype(np.int64).T
    pixel = y * view.width + x
    away = np.linalg.norm(points[rows] - view.camera_to_world[:3, 3], axis=1)
    free = away < distance[pixel] - tolerance
    return rows[free], pixel[free]


def grid_points(low: np.ndarray, step: float, shape: np.ndarray) -> np.ndarray:
    """(N, 3) centres of the cells of a grid."""
    return np.asarray(low + (np.indices(tuple(shape)).reshape(3, -1).T + 0.5) * step)


def masked_views(room: Room, views: Sequence[View]) -> tuple[list[MaskedView], np.ndarray]:
    """The views that have masks, and (T,) the id of the part of each triangle, or NO_PART.

    Triangles behind a hole of a part get the label of this part. Some of them are recognised as belonging to
    the plane of another part (`LEAST_OWN`); they have no part here.
    """
    surfaces = [first_hits(trace_pixels(room, view)) for view in views]
    parts = choose_parts(room, views, [triangle for triangle, _ in surfaces])
    label = np.append(parts.ids, NO_PART)[parts.triangle_part]
    ids = np.append(label, NO_PART)  # the last: of no triangle
    label = np.where(_on_other_planes(label, room), NO_PART, label)
    own = np.append(label, NO_PART)
    masks = [view.part_ids() for view in views]
    count = 1 + max(int(mask.max()) for mask in masks if mask is not None)
    masked = []
    for view, image, (triangle, reached) in zip(views, masks, surfaces, strict=True):
        if image is None:
            continue
        mask, inner = np.maximum(image, 0), ~at_border(image)
        distance = reached.reshape(mask.shape).astype(np.float32)
        found = ids[triangle].reshape(mask.shape) == mask
        counts = (np.bincount(mask[chosen], minlength=count) for chosen in (inner & found, inner))
        same = own[triangle].reshape(mask.shape) == mask
        masked.append(MaskedView(view, mask, distance, same, *counts))
    return masked, label


def _on_other_planes(label: np.ndarray, room: Room) -> np.ndarray:
    """(T,) bool, triangles on planes of which their parts have less than half."""
    other = np.zeros(len(label), bool)
    if room.plane is None:
        return other
    on = room.plane >= 0
    plane, _, place = pairs_of(room.plane[on], np.maximum(label[on], 0))
    area = np.bincount(place, room.areas[on])
    other[on] = (area < LEAST_OWN * np.bincount(plane, area)[plane])[place]
    return other
