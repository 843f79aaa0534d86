# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What each pixel of the training views sees, and all that is stored per pixel.

Arrays are memory-mapped .npy files in the run's stage folder, so that a capture need not fit into RAM.
Pixels of all views stand one after the other; `ranges` says where each view begins.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.images import read_radiance
from ..capture.views import View
from ..job.errors import FiptError
from ..job.per_view import LocalWorkers, Workers
from .room import Room, Surface

NO_TRIANGLE = -1
LEFT_OUT = -2  # masked out of the photograph: neither the room nor what lies outside it
# Pixels of all views, and of one at most, whose median luminance is the capture's.
LUMINANCES = 2_000_000
VIEW_LUMINANCES = 20_000


@dataclass
class PixelStore:
    """Per-pixel arrays of all training views, memory-mapped.

    Attributes:
        views: the training views in order.
        ranges: (n + 1,) int64; view i has pixels ranges[i] to ranges[i + 1].
        radiance: (N, 3) float32 photographed radiance in units of the capture's median.
        position: (N, 3) float32 first hit, world metres.
        normal: (N, 3) float32 shading normal towards the viewer.
        triangle: (N,) int32, NO_TRIANGLE where the mesh is missed, LEFT_OUT where the photograph is masked.
        front: (N,) bool, whether the triangle's front is seen.
        pure: (N,) bool, whether the whole pixel sees one smooth surface, or nothing but the outside (paper's
            blind spot: mixed pixels).
    """

    views: list[View]
    ranges: np.ndarray
    radiance: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    triangle: np.ndarray
    front: np.ndarray
    pure: np.ndarray

    def __len__(self) -> int:
        return int(self.ranges[-1])

    def rows(self, view: int) -> slice:
        """The pixels of a view."""
        return slice(int(self.ranges[view]), int(self.ranges[view + 1]))

    def of_view(self, view: int) -> ViewPixels:
        """What one view sees, in memory."""
        rows = self.rows(view)
        arrays = (self.position, self.normal, self.triangle, self.front)
        return ViewPixels(view, self.views[view], *(np.array(array[rows]) for array in arrays))

    def camera_positions(self) -> np.ndarray:
        """(n, 3) float32 camera centre of each view."""
        return np.array([view.camera_to_world[:3, 3] for view in self.views], np.float32)

    def view_of(self, pixels: np.ndarray) -> np.ndarray:
        """Index of the view that each pixel index belongs to."""
        return np.searchsorted(self.ranges, pixels, side="right") - 1


@dataclass(frozen=True)
class ViewPixels:
    """What the pixels of one view see; arrays as in :class:`PixelStore`.

    Attributes:
        index: of the view.
    """

    index: int
    view: View
    position: np.ndarray
    normal: np.ndarray
    triangle: np.ndarray
    front: np.ndarray


_ARRAYS: dict[str, tuple[type, tuple[int, ...]]] = {
    "radiance": (np.float32, (3,)),
    "position": (np.float32, (3,)),
    "normal": (np.float32, (3,)),
    "triangle": (np.int32, ()),
    "front": (np.bool_, ()),
    "pure": (np.bool_, ()),
}


def open_array(path: Path, shape: tuple[int, ...], dtype: type, create: bool) -> np.ndarray:
    """A memory-mapped .npy array; new and zero with `create`, else read-only."""
    if create:
        path.parent.mkdir(parents=True, exist_ok=True)
        array = np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)
        if hasattr(os, "posix_fallocate"):
            # Without blocks of its own, a mapped file on a full disk kills the process instead of raising.
            with path.open("r+b") as file:
                os.posix_fallocate(file.fileno(), 0, max(path.stat().st_size, 1))
        return array
    array = np.lib.format.open_memmap(path, mode="r")
    if array.shape != shape or array.dtype != dtype:
        raise FiptError("file-damaged", f"{path} does not fit the capture.", "Start the run anew.")
    return array


def open_pixels(folder: Path, views: list[View], create: bool = False) -> PixelStore:
    """Open (or make) the arrays of the given views in `folder`."""
    counts = [view.width * view.height for view in views]
    ranges = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    total = int(ranges[-1])
    arrays = {
        name: open_array(folder / f"{name}.npy", (total, *tail), dtype, create)
        for name, (dtype, tail) in _ARRAYS.items()
    }
    return PixelStore(views=views, ranges=ranges, **arrays)


def trace_pixels(
    room: Room, view: View, shifts: Sequence[tuple[float, float]] = ((0.0, 0.0),), pixels: Any = None
) -> Surface:
    """First surface seen through each pixel, at its centre plus each of `shifts`, one after the other.

    Args:
        shifts: (x, y) in pixels.
        pixels: UInt32 row-major numbers of pixels; all of the view where not given.
    """
    count = len(shifts)
    number = view.width * view.height if pixels is None else dr.width(pixels)
    lane = dr.arange(mi.UInt32, number * count)
    pixel = lane // count if pixels is None else dr.gather(mi.UInt32, pixels, lane // count)
    # Opaque numbers: literals would make a kernel of its own for each view.
    fx, fy = (dr.opaque(mi.Float, float(number)) for number in (view.fx, view.fy))
    centres = [[view.cx - x - 0.5 for x, _ in shifts], [view.cy - y - 0.5 for _, y in shifts]]
    cx, cy = (dr.gather(mi.Float, mi.Float(numbers), lane % count) for numbers in centres)
    row = pixel // dr.opaque(mi.UInt32, view.width)
    column = pixel - row * dr.opaque(mi.UInt32, view.width)
    local = dr.normalize(mi.Vector3f((mi.Float(column) - cx) / fx, (mi.Float(row) - cy) / fy, 1.0))
    pose = np.asarray(view.camera_to_world, np.float64)
    x_axis, y_axis, z_axis = (opaque_vector(mi.Vector3f, pose[:3, axis]) for axis in range(3))
    direction = x_axis * local.x + y_axis * local.y + z_axis * local.z
    return room.intersect(mi.Ray3f(opaque_vector(mi.Point3f, pose[:3, 3]), direction))


def opaque_vector(kind: type, values: np.ndarray) -> mi.Vector3f:
    """Three numbers that Dr.Jit must not bake into kernels."""
    return kind(*[dr.opaque(dr.value_t(kind), float(value)) for value in values])


@dataclass(frozen=True)
class TracedView:
    """First surfaces that the pixels of one view see: arrays as in :class:`PixelStore`, before any mask.

    Positions and normals mean nothing where the mesh is missed.
    """

    position: np.ndarray
    normal: np.ndarray
    triangle: np.ndarray
    front: np.ndarray


@dataclass(frozen=True)
class Tracing:
    """Work on views: what their pixels see."""

    room: Room

    def prepare(self) -> Callable[[View], TracedView]:
        """The function of one view."""
        return partial(trace_view, self.room)


def trace_view(room: Room, view: View) -> TracedView:
    """What each pixel of a view sees at its centre."""
    surface = trace_pixels(room, view)
    valid = np.array(surface.valid)
    return TracedView(
        np.array(surface.position).T,
        np.array(surface.normal).T,
        np.where(valid, np.array(surface.triangle).astype(np.int32), np.int32(NO_TRIANGLE)),
        np.array(surface.front),
    )


def fill_pixels(
    store: PixelStore, room: Room, progress: Callable[[float], None], workers: Workers | None = None
) -> float:
    """Trace all views, read their photographs, and return the capture's radiance scale.

    The scale is the median luminance of all pixels that are not black; `store.radiance` is divided by it,
    so that nothing after this depends on exposure. `store.pure` is left to :func:`mark_pure`.

    Args:
        workers: who traces; this process where none are given.

    Raises:
        FiptError: ``mesh-unseen`` where no view sees the mesh, ``images-black``.
    """
    luminances = []
    most = max(1, min(VIEW_LUMINANCES, LUMINANCES // max(len(store.views), 1)))
    seen = 0
    done = 0
    for i, traced in (workers or LocalWorkers()).map(Tracing(room), store.views):
        rows, view = store.rows(i), store.views[i]
        image = read_radiance(view.image).reshape(-1, 3)
        store.radiance[rows] = image
        masked = view.masked()
        used = image if masked is None else image[~masked.reshape(-1)]
        sample = used[:: max(1, len(used) // most)].mean(axis=1)
        luminances.append(sample[sample > 0])
        triangle = traced.triangle
        if masked is not None:
            triangle = np.where(masked.reshape(-1), np.int32(LEFT_OUT), triangle)
        valid = triangle >= 0
        seen += int(valid.sum())
        store.triangle[rows] = triangle
        store.position[rows] = np.where(valid[:, None], traced.position, np.float32(0.0))
        store.normal[rows] = np.where(valid[:, None], traced.normal, np.float32(0.0))
        store.front[rows] = traced.front
        done += 1
        progress(done / len(store.views))
    if not seen:
        raise FiptError(
            "mesh-unseen",
            "No camera sees the mesh.",
            "Check the up axis and the scale: the cameras and the mesh must lie in one space.",
        )
    luminance = np.concatenate(luminances)
    if not len(luminance):
        raise FiptError("images-black", "All photographs are black.", "Check the images of the capture.")
    scale = float(np.median(luminance))
    for i in range(len(store.views)):
        store.radiance[store.rows(i)] /= scale
    return scale


@dataclass(frozen=True)
class Marking:
    """Work on views: which of their pixels are pure.

    Attributes:
        labels: (T,) int part of each triangle.
    """

    room: Room
    labels: np.ndarray

    def prepare(self) -> Callable[[View], np.ndarray]:
        """The function of one view: (H * W,) bool."""
        return partial(_pure, self.room, mi.Int32(self.labels.astype(np.int32)))


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
        workers: who traces; this process where none are given.
    """
    done = 0
    for i, pure in (workers or LocalWorkers()).map(Marking(room, labels), store.views):
        rows = store.rows(i)
        store.pure[rows] = pure & (store.triangle[rows] != LEFT_OUT)
        done += 1
        progress(done / len(store.views))


def _pure(room: Room, label: mi.Int32, view: View) -> np.ndarray:
    """Whether the corners of each pixel see the same part, at about the same place and slope; or outside."""
    centre = trace_pixels(room, view)
    valid = centre.valid
    here = dr.gather(mi.Int32, label, centre.triangle, valid)
    cosine = dr.abs(dr.dot(centre.normal, _toward(view, centre)))
    # Half a pixel's diagonal on the tangent plane, with room for curvature.
    pixel = centre.distance / dr.opaque(mi.Float, float(min(view.fx, view.fy)))
    reach = 1.5 * pixel / dr.maximum(cosine, 0.05)
    pure, outside = mi.Bool(valid), ~valid
    for shift in ((-0.45, -0.45), (0.45, -0.45), (-0.45, 0.45), (0.45, 0.45)):
        corner = trace_pixels(room, view, [shift])
        outside &= ~corner.valid
        pure &= corner.valid & (dr.norm(corner.position - centre.position) < reach)
        pure &= dr.dot(corner.normal, centre.normal) > 0.8
        pure &= dr.gather(mi.Int32, label, corner.triangle, corner.valid) == here
    return np.array(pure | outside)


def _toward(view: View, surface: Surface) -> mi.Vector3f:
    centre = opaque_vector(mi.Point3f, np.asarray(view.camera_to_world)[:3, 3])
    return dr.normalize(centre - surface.position)


def find_donors(store: PixelStore, index: int, part: np.ndarray, reach: int) -> np.ndarray:
    """For each pixel of a view the one whose photograph stands for it: itself, or near by where it is mixed.

    A mixed pixel's radiance is that of several surfaces. The nearest pure pixel of the same part, at most
    `reach` steps away in the same view, shows what its own surface looks like.

    Args:
        index: of the view.
        part: (n,) int part of each of its pixels; any one value for all where parts are unknown.

    Returns:
        (n,) int64 indices among all views' pixels; -1 for mixed pixels without such a neighbour and where the
        mesh is missed.
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
