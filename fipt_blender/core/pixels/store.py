"""What each pixel of the training views sees, and all that is stored per pixel.

Arrays are memory-mapped .npy files in the run's stage folder, so that a capture need not fit into RAM.
The pixels of all views are concatenated; `ranges` says where each view begins.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from ..capture.views import View
from ..run.errors import FiptError
from ..run.per_view import LocalWorkers, Workers
from ..run.store import DAMAGE
from ..surface.room import Room, Surface
from .camera_rays import trace_pixels

NO_TRIANGLE = -1  # in place of a triangle: the pixel looks outside
LEFT_OUT = -2  # masked in the photograph: neither the room nor the outside
# Edge of a surface cell in median widths of a pixel on the room.
CELL_PIXELS = 1.5
# The capture's median luminance is that of at most this many pixels of all views, and of each view.
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
        pure: (N,) bool, whether the whole pixel sees one smooth surface, or only the outside; all others are
            mixed pixels.
        own: (N, 3) float32 radiance of the surface at the pixel's centre, without what other surfaces add to
            a mixed pixel (:mod:`.unmixing`); the photographed radiance of pure pixels.
        weight: (N,) float32 information of `own`: 1 for pure pixels, 0 where it is not known.
    """

    views: list[View]
    ranges: np.ndarray
    radiance: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    triangle: np.ndarray
    front: np.ndarray
    pure: np.ndarray
    own: np.ndarray
    weight: np.ndarray

    def __len__(self) -> int:
        return int(self.ranges[-1])

    def rows(self, view: int) -> slice:
        """Where the pixels of a view lie in the arrays."""
        return slice(int(self.ranges[view]), int(self.ranges[view + 1]))

    def with_copies(self, folder: Path, *names: str) -> PixelStore:
        """The same pixels, with copies of some of the arrays in `folder`, which may be written to."""
        copies: dict[str, Any] = {}
        for name in names:
            array = getattr(self, name)
            copies[name] = open_array(folder / f"{name}.npy", array.shape, array.dtype.type, create=True)
            for index in range(len(self.views)):
                copies[name][self.rows(index)] = array[self.rows(index)]
        return replace(self, **copies)

    def of_view(self, view: int) -> ViewPixels:
        """What one view sees, copied to memory."""
        rows = self.rows(view)
        stored = (self.position, self.normal, self.triangle, self.front)
        position, normal, triangle, front = (np.array(array[rows]) for array in stored)
        return ViewPixels(position, normal, triangle, front, view, self.views[view])

    def hits(self, view: int) -> np.ndarray:
        """(n,) int64 pixels of a view that see the mesh."""
        rows = self.rows(view)
        return np.flatnonzero(self.triangle[rows] >= 0) + rows.start

    def some_hits(self, most: int) -> np.ndarray:
        """(n,) int64 about `most` pixels that see the mesh, evenly spread over those of all views."""
        views = range(len(self.views))
        step, before, found = max(1, sum(len(self.hits(view)) for view in views) // most), 0, []
        for view in views:
            hit = self.hits(view)
            found.append(hit[-before % step :: step])
            before += len(hit)
        return np.concatenate(found)

    def surface(self, room: Room, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) that pixels (n,) see, and float32 geometric normals (n, 3) on the seen sides."""
        side = np.where(self.front[rows], np.float32(1.0), np.float32(-1.0))[:, None]
        return np.asarray(self.position[rows]), (room.normals[self.triangle[rows]] * side).astype(np.float32)

    def camera_positions(self) -> np.ndarray:
        """(n, 3) float32 camera centre of each view."""
        return np.array([view.camera_to_world[:3, 3] for view in self.views], np.float32)

    def view_of(self, pixels: np.ndarray) -> np.ndarray:
        """(n,) int64 index of the view that each pixel (n,) belongs to."""
        return np.searchsorted(self.ranges, pixels, side="right") - 1


@dataclass(frozen=True)
class TracedView:
    """First surfaces that the pixels of views see: arrays as in :class:`PixelStore`, before any mask.

    Positions and normals are undefined where the mesh is missed.
    """

    position: np.ndarray
    normal: np.ndarray
    triangle: np.ndarray
    front: np.ndarray


@dataclass(frozen=True)
class ViewPixels(TracedView):
    """What the pixels of one view see, with its index; LEFT_OUT where it is masked."""

    index: int
    view: View


_ARRAYS: dict[str, tuple[type, tuple[int, ...]]] = {
    "radiance": (np.float32, (3,)),
    "position": (np.float32, (3,)),
    "normal": (np.float32, (3,)),
    "triangle": (np.int32, ()),
    "front": (np.bool_, ()),
    "pure": (np.bool_, ()),
    "own": (np.float32, (3,)),
    "weight": (np.float32, ()),
}


def open_array(
    path: Path, shape: tuple[int, ...], dtype: type, create: bool, keep: bool = False
) -> np.ndarray:
    """A memory-mapped .npy array; new and zero with `create`, else read-only.

    Args:
        keep: with `create`, open an existing array for writing with its content.

    Raises:
        FiptError: ``file-damaged`` where an existing array is missing, cut off, or of another shape or type.
    """
    if create and not keep:
        path.parent.mkdir(parents=True, exist_ok=True)
        array = np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)
        if hasattr(os, "posix_fallocate"):
            # Allocate the blocks now: on a full disk, writing to a sparse mapped file kills the process.
            with path.open("r+b") as file:
                os.posix_fallocate(file.fileno(), 0, max(path.stat().st_size, 1))
        return array
    try:
        array = np.lib.format.open_memmap(path, mode="r+" if create else "r")
    except DAMAGE as error:
        raise FiptError("file-damaged.load-tensors", path=path, error=error) from None
    if array.shape != shape or array.dtype != dtype:
        raise FiptError("file-damaged.open-array", path=path)
    return array


def create_pixels(folder: Path, views: list[View]) -> PixelStore:
    """The arrays of the given views in `folder`, new and zero."""
    counts = [view.width * view.height for view in views]
    ranges = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    total = int(ranges[-1])
    arrays = {
        name: open_array(folder / f"{name}.npy", (total, *tail), dtype, create=True)
        for name, (dtype, tail) in _ARRAYS.items()
    }
    return PixelStore(views=views, ranges=ranges, **arrays)


@dataclass(frozen=True)
class ViewFunction:
    """Work on views: a function of what all views share and of one view, which is the last argument."""

    function: Callable[..., Any]
    shared: tuple[Any, ...]

    def prepare(self) -> Callable[[Any], Any]:
        """The function of one view."""
        return partial(self.function, *self.shared)


def trace_view(room: Room, view: View) -> TracedView:
    """The first surface that each pixel of a view sees at its centre."""
    return traced(trace_pixels(room, view))


def traced(surface: Surface) -> TracedView:
    """First surfaces as arrays."""
    # Together, or each would trace the rays again.
    dr.eval(surface.valid, surface.position, surface.normal, surface.triangle, surface.front)
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
    so that all later stages are independent of exposure. `mark_pure` and `unmix_pixels`
    fill the rest.

    Args:
        progress: called with the share (0..1) that is done.
        workers: trace the views; this process where None.

    Raises:
        FiptError: ``mesh-unseen`` where no view sees the mesh, ``images-black``, and those of
            the view's photograph and mask.
    """
    luminances = []
    view_luminances = max(1, min(VIEW_LUMINANCES, LUMINANCES // max(len(store.views), 1)))
    mesh_seen = False
    traced_views = (workers or LocalWorkers()).map(ViewFunction(trace_view, (room,)), store.views)
    for done, (index, traced) in enumerate(traced_views, 1):
        rows, view = store.rows(index), store.views[index]
        image = view.radiance().reshape(-1, 3)
        store.radiance[rows] = image
        masked = view.masked()
        used = image if masked is None else image[~masked.reshape(-1)]
        luminance = used[:: max(1, len(used) // view_luminances)].mean(axis=1)
        luminances.append(luminance[luminance > 0])
        triangle = traced.triangle
        if masked is not None:
            triangle = np.where(masked.reshape(-1), np.int32(LEFT_OUT), triangle)
        valid = triangle >= 0
        mesh_seen |= bool(valid.any())
        store.triangle[rows] = triangle
        store.position[rows] = np.where(valid[:, None], traced.position, np.float32(0.0))
        store.normal[rows] = np.where(valid[:, None], traced.normal, np.float32(0.0))
        store.front[rows] = traced.front
        progress(done / len(store.views))
    if not mesh_seen:
        raise FiptError("mesh-unseen")
    positive = np.concatenate(luminances)
    if not len(positive):
        raise FiptError("images-black")
    scale = float(np.median(positive))
    for index in range(len(store.views)):
        store.radiance[store.rows(index)] /= scale
    return scale
