"""Mixed pixels, which see more than one surface or part: finding them, and the pixels that replace them."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..run.per_view import LocalWorkers, Workers
from ..surface.room import Room
from .camera_rays import opaque_vector, trace_pixels
from .store import LEFT_OUT, PixelStore, ViewFunction


def mark_pure(
    store: PixelStore,
    room: Room,
    labels: np.ndarray,
    progress: Callable[[float], None],
    workers: Workers | None = None,
) -> None:
    """Fill `store.pure`.

    Args:
        labels: (T,) int part of each triangle; pixels across a border of parts are not pure.
        progress: called with the share (0..1) that is done.
        workers: trace the views; this process where None.
    """
    marked = (workers or LocalWorkers()).map(ViewFunction(_pure, (room, labels)), store.views)
    for done, (index, pure) in enumerate(marked, 1):
        rows = store.rows(index)
        store.pure[rows] = pure & (store.triangle[rows] != LEFT_OUT)
        progress(done / len(store.views))


def _pure(room: Room, labels: np.ndarray, view: View) -> np.ndarray:
    """(H * W,) bool, pixels whose corners see one part at similar positions and slopes, or the outside."""
    centre = trace_pixels(room, view)
    valid = centre.valid
    label_of = mi.Int32(labels.astype(np.int32))
    here = dr.gather(mi.Int32, label_of, centre.triangle, valid)
    camera = opaque_vector(mi.Point3f, np.asarray(view.camera_to_world)[:3, 3])
    cosine = dr.abs(dr.dot(centre.normal, dr.normalize(camera - centre.position)))
    # Half a pixel's diagonal on the tangent plane, with a margin for curvature.
    pixel = centre.distance / dr.opaque(mi.Float, float(min(view.fx, view.fy)))
    reach = 1.5 * pixel / dr.maximum(cosine, 0.05)
    pure, outside = mi.Bool(valid), ~valid
    for shift in ((-0.45, -0.45), (0.45, -0.45), (-0.45, 0.45), (0.45, 0.45)):
        corner = trace_pixels(room, view, [shift])
        outside &= ~corner.valid
        pure &= corner.valid & (dr.norm(corner.position - centre.position) < reach)
        pure &= dr.dot(corner.normal, centre.normal) > 0.8
        pure &= dr.gather(mi.Int32, label_of, corner.triangle, corner.valid) == here
    return np.array(pure | outside)


def find_donors(store: PixelStore, index: int, part: np.ndarray, reach: int) -> np.ndarray:
    """For each pixel of a view the one whose radiance it takes: itself, or a pure neighbour if it is mixed.

    A mixed pixel's radiance is that of several surfaces. The nearest pure pixel of the same part, at most
    `reach` steps away in the same view, shows the radiance of its own surface.

    Args:
        index: of the view.
        part: (n,) int part of each of its pixels; one value for all where parts are unknown.

    Returns:
        (n,) int64 indices among the pixels of all views; -1 for mixed pixels without such a neighbour and
        where the mesh is missed.
    """
    rows, view = store.rows(index), store.views[index]
    size = (view.height, view.width)
    hit = (np.asarray(store.triangle[rows]) >= 0).reshape(size)
    pure = np.asarray(store.pure[rows]).reshape(size) & hit
    label = part.reshape(size)
    donor = np.where(pure, np.arange(rows.start, rows.stop).reshape(size), -1)
    for _ in range(reach):
        before = donor
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            near = np.roll(before, step, axis=axis)
            alike = np.roll(label, step, axis=axis) == label
            edge: list[slice] = [slice(None), slice(None)]
            edge[axis] = slice(0, 1) if step == 1 else slice(-1, None)
            alike[tuple(edge)] = False  # np.roll wraps around
            donor = np.where((donor < 0) & hit & alike, near, donor)
    return donor.reshape(-1)
