"""Camera rays through the pixels of a view."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..surface.room import Room, Surface


def trace_pixels(
    room: Room,
    view: View,
    shifts: Sequence[tuple[float, float]] = ((0.0, 0.0),),
    pixels: mi.UInt32 | None = None,
) -> Surface:
    """First surface seen through each pixel, at its centre plus each of `shifts`.

    Args:
        shifts: (x, y) in pixels.
        pixels: row-major pixel indices; all pixels of the view where None.

    Returns:
        the surfaces, ordered by pixel and then by shift.
    """
    count = len(shifts)
    pixel_count = view.width * view.height if pixels is None else dr.width(pixels)
    lane = dr.arange(mi.UInt32, pixel_count * count)
    pixel = lane // count if pixels is None else dr.gather(mi.UInt32, pixels, lane // count)
    # Opaque: with literals, Dr.Jit would compile a kernel for each view.
    fx, fy = (dr.opaque(mi.Float, float(focal)) for focal in (view.fx, view.fy))
    centres = [[view.cx - x - 0.5 for x, _ in shifts], [view.cy - y - 0.5 for _, y in shifts]]
    cx, cy = (dr.gather(mi.Float, mi.Float(centre), lane % count) for centre in centres)
    row = pixel // dr.opaque(mi.UInt32, view.width)
    column = pixel - row * dr.opaque(mi.UInt32, view.width)
    local = dr.normalize(mi.Vector3f((mi.Float(column) - cx) / fx, (mi.Float(row) - cy) / fy, 1.0))
    pose = np.asarray(view.camera_to_world, np.float64)
    x_axis, y_axis, z_axis = (opaque_vector(mi.Vector3f, pose[:3, axis]) for axis in range(3))
    direction = x_axis * local.x + y_axis * local.y + z_axis * local.z
    return room.intersect(mi.Ray3f(opaque_vector(mi.Point3f, pose[:3, 3]), direction))


def rays_along(origins: np.ndarray, directions: np.ndarray) -> mi.Ray3f:
    """Rays from points (N, 3), or one point (3,), along unit directions (N, 3)."""
    origin, direction = (
        np.ascontiguousarray(np.atleast_2d(each).T, np.float32) for each in (origins, directions)
    )
    return mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))


def first_hits(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int64 triangle of each ray, -1 where it meets none, and (N,) metres to it, infinite there."""
    dr.eval(surface.valid, surface.triangle, surface.distance)  # together, or each would trace the rays again
    valid = np.array(surface.valid)
    triangle = np.where(valid, np.array(surface.triangle).astype(np.int64), -1)
    return triangle, np.where(valid, np.array(surface.distance), np.inf)


def opaque_vector(kind: type, values: np.ndarray) -> mi.Vector3f:
    """A vector or point (3,) that Dr.Jit does not compile into kernels as a constant."""
    return kind(*[dr.opaque(dr.value_t(kind), float(value)) for value in values])
