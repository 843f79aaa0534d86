# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadings of all training views: baked view by view, denoised, kept as memory-mapped half floats.

What all views share (:class:`Baking`) and what one view needs are arrays and numbers, so that any process
can bake a view.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..job.per_view import Workers
from ..material.brdf import set_masking
from ..render.environment import EnvironmentLight
from ..render.lights import AreaLights, EmitterTable
from ..scene.pixels import PixelStore, ViewPixels, opaque_vector, open_array, trace_pixels
from ..scene.room import Room, triangle_normals
from .cache import SurfaceLookup, VoxelGrid
from .denoise import Denoiser
from .radiance import CachedRadiance, RadianceSource, TracedRadiance
from .shadings import SampleCounts, ShadingPoints, Shadings, bake, means

# Most pixels in one kernel launch, so that large photographs stay within memory.
CHUNK = 1 << 18
HALF_LARGEST = 6.0e4
# Where in its pixel a share of the samples starts (pixels from the centre; a rotated grid): a photograph is
# an integral over pixels, and bevels and edges that the centre misses or alone sees would stand out.
SUBPIXELS = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
# A start that lies farther than so many pixels' widths from the centre's surface belongs to another one.
SUBPIXEL_REACH = 3.0


@dataclass
class ShadingStore:
    """Baked shadings of every pixel, in units of the capture's median.

    Attributes:
        diffuse: (N, 3) float16.
        specular: (N, K, 2, 3) float16.
    """

    diffuse: np.ndarray
    specular: np.ndarray


def open_shadings(folder: Path, pixels: int, levels: int, create: bool = False) -> ShadingStore:
    """Open (or make) the arrays in `folder`."""
    return ShadingStore(
        open_array(folder / "diffuse.npy", (pixels, 3), np.float16, create),
        open_array(folder / "specular.npy", (pixels, levels, 2, 3), np.float16, create),
    )


@dataclass(frozen=True)
class TracedLight:
    """What stage 3 follows light paths by.

    Attributes:
        materials: (M * 6, 5) base colour, roughness and metallic of each cache entry.
        diffuse: (M * 6, 3) L_d of each cache entry, negative where unknown; None follows diffuse light too.
        cache_roughness: rougher surfaces end a path in the cache.
        depth: most surfaces that a path may meet.
    """

    materials: np.ndarray
    diffuse: np.ndarray | None
    cache_roughness: float
    depth: int


@dataclass(frozen=True)
class Baking:
    """Work on views: their shadings, in units of the capture's median.

    Attributes:
        labels: (T,) int part of each triangle; a pixel's samples start on one part.
        grid: voxels of the cache.
        cache: (M * 6, 3) float32 radiance of each cache entry; None only with `traced`.
        traced: of stage 3; None in stage 1, which reads the cache at the first hit.
        emitters: triangles to aim at; in stage 3 those that emit.
        environment: (H, 2H, 3) radiance from outside, or None.
        levels: (K,) float32 roughness levels.
        denoise: denoise L_d.
        denoise_specular: denoise L_s0 and L_s1 of every level too.
        masking: G of the BRDF, see `brdf.set_masking`.
        seed: each view uses its own streams made of it.
    """

    room: Room
    labels: np.ndarray
    grid: VoxelGrid
    cache: np.ndarray | None
    traced: TracedLight | None
    emitters: EmitterTable
    environment: np.ndarray | None
    levels: np.ndarray
    counts: SampleCounts
    denoise: bool
    denoise_specular: bool
    masking: str
    seed: int

    def prepare(self) -> Callable[[ViewPixels], BakedView]:
        """The function of one view."""
        set_masking(self.masking)
        lights = AreaLights(self.room.vertices, self.room.triangles, self.emitters)
        tables = TriangleTables.of(self.room, self.labels)
        return partial(bake_view, self, self._source(lights), lights, tables)

    def _source(self, lights: AreaLights) -> RadianceSource:
        environment = None if self.environment is None else EnvironmentLight(self.environment)
        if self.traced is None:
            assert self.cache is not None, "stage 1 reads nothing but the cache"
            return CachedRadiance(self.room, SurfaceLookup(self.grid, self.cache), environment)
        materials = SurfaceLookup(self.grid, self.traced.materials)
        cache = None if self.cache is None else materials.beside(self.cache)
        diffuse = None if self.traced.diffuse is None else materials.beside(self.traced.diffuse)
        path = self.traced.cache_roughness, self.traced.depth
        return TracedRadiance(self.room, cache, materials, diffuse, lights, environment, *path)


@dataclass(frozen=True)
class BakedView:
    """Shadings of one view's pixels as :class:`ShadingStore` keeps them, and the primary rays traced."""

    diffuse: np.ndarray
    specular: np.ndarray
    rays: int


def bake_views(
    store: ShadingStore,
    pixels: PixelStore,
    baking: Baking,
    progress: Callable[[float], None],
    workers: Workers,
) -> int:
    """Fill `store` and return the number of primary rays traced."""
    rays = done = 0
    items = (pixels.of_view(index) for index in range(len(pixels.views)))
    for i, baked in workers.map(baking, items):
        rows = pixels.rows(i)
        store.diffuse[rows], store.specular[rows] = baked.diffuse, baked.specular
        rays += baked.rays
        done += 1
        progress(done / len(pixels.views))
    return rays


def bake_view(
    baking: Baking,
    source: RadianceSource,
    lights: AreaLights,
    tables: TriangleTables,
    pixels: ViewPixels,
) -> BakedView:
    """Shadings of one view.

    Args:
        source, lights, tables: of `baking`.
    """
    levels, view = baking.levels, pixels.view
    size = view.height * view.width
    rows = np.flatnonzero(pixels.triangle >= 0)
    counts = SampleCounts(*(_share(samples) for samples in astuple(baking.counts)))
    stream = baking.seed * 100003 + pixels.index
    found = Shadings(np.zeros((size, 3), np.float32), np.zeros((size, len(levels), 2, 3), np.float32))
    normal = np.zeros((size, 3), np.float32)
    step = max(1, CHUNK // len(SUBPIXELS))
    for number, begin in enumerate(range(0, len(rows), step)):
        part = rows[begin : begin + step]
        points = start_points(baking.room, pixels, part, tables)
        baked = bake(points, source, lights, levels, counts, stream * 1009 + number, len(SUBPIXELS))
        found.diffuse[part], found.specular[part] = baked.diffuse, baked.specular
        if baking.denoise:
            normal[part] = means([points.normal], len(SUBPIXELS))
    if baking.denoise:
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
        found = _denoise(found, normal, (view.height, view.width), baking.denoise_specular)
    halves = [array.clip(0.0, HALF_LARGEST).astype(np.float16) for array in (found.diffuse, found.specular)]
    samples = counts.diffuse + counts.specular * len(levels) + (counts.light if lights.count else 0)
    return BakedView(halves[0], halves[1], len(rows) * samples * len(SUBPIXELS))


def _share(samples: int) -> int:
    """How many of a pixel's samples begin at each of its starts, at least all of them together."""
    return -(-samples // len(SUBPIXELS))


@dataclass(frozen=True)
class TriangleTables:
    """What the starts of samples ask about the room's triangles, on the device.

    Attributes:
        normal: Float (T * 3), geometric normals.
        label: Int32 (T), as in :class:`Baking`.
    """

    normal: Any
    label: Any

    @classmethod
    def of(cls, room: Room, labels: np.ndarray) -> TriangleTables:
        """Those of a room; `labels` (T,) int."""
        normals = triangle_normals(room.vertices, room.triangles).astype(np.float32)
        return cls(mi.Float(normals.reshape(-1)), mi.Int32(np.ascontiguousarray(labels, np.int32)))


def start_points(room: Room, pixels: ViewPixels, rows: np.ndarray, tables: TriangleTables) -> ShadingPoints:
    """Evaluated points at which samples of some pixels start: each pixel's :data:`SUBPIXELS` in order.

    Each is the surface point beside the pixel's centre, or the centre's where another surface lies there: one
    of another label, or far away.

    Args:
        rows: (M,) pixels of the view that see the room.
    """
    view, count = pixels.view, len(SUBPIXELS)
    number = dr.arange(mi.UInt32, len(rows) * count) // count
    camera = np.asarray(view.camera_to_world)[:3, 3]

    def seen(kind: Any, array: np.ndarray) -> Any:
        flat = np.ascontiguousarray(array[rows]).reshape(-1)
        scalar = mi.Float if flat.dtype == np.float32 else mi.Int32
        return dr.gather(kind, scalar(flat), number)

    triangle = mi.UInt32(seen(mi.Int32, pixels.triangle))
    side = seen(mi.Float, np.where(pixels.front, np.float32(1.0), np.float32(-1.0)))
    position, normal = seen(mi.Point3f, pixels.position), seen(mi.Normal3f, pixels.normal)
    geometric = dr.gather(mi.Normal3f, tables.normal, triangle) * side
    toward, _ = _unit(opaque_vector(mi.Vector3f, camera) - mi.Vector3f(position))
    centre = ShadingPoints(position, normal, geometric, toward)

    surface = trace_pixels(room, view, SUBPIXELS, mi.UInt32(rows.astype(np.uint32)))
    geometric = surface.geometric_normal * dr.select(surface.front, mi.Float(1.0), -1.0)
    toward, distance = _unit(opaque_vector(mi.Vector3d, camera) - mi.Vector3d(surface.position))
    toward = mi.Vector3f(toward)
    beside = ShadingPoints(surface.position, surface.normal, geometric, toward)
    product = toward * geometric
    cosine = dr.maximum(dr.abs(product.x + product.y + product.z), 0.05)
    width = dr.opaque(mi.Float64, float(min(view.fx, view.fy)))
    reach = SUBPIXEL_REACH * distance / width / mi.Float64(cosine)
    own = dr.gather(mi.Int32, tables.label, triangle)
    same = surface.valid & (dr.gather(mi.Int32, tables.label, surface.triangle, surface.valid) == own)
    same &= mi.Float64(_unit(surface.position - position)[1]) < reach
    chosen = [
        dr.select(same, getattr(beside, item.name), getattr(centre, item.name))
        for item in fields(ShadingPoints)
    ]
    dr.eval(chosen)
    return ShadingPoints(*chosen)


def _unit(vector: Any) -> tuple[Any, Any]:
    """A vector's direction and length, without Dr.Jit's fused sums and reciprocals: rounded as numpy does."""
    x, y, z = vector.x, vector.y, vector.z
    length = dr.maximum(dr.sqrt(x * x + y * y + z * z), 1e-12)
    return type(vector)(x / length, y / length, z / length), length


def _denoise(shadings: Shadings, normal: np.ndarray, size: tuple[int, int], specular_too: bool) -> Shadings:
    height, width = size
    guide = np.ones((height, width, 3), np.float32)
    with Denoiser(guide, normal.reshape(height, width, 3), clean_guides=True, fast=True) as denoiser:
        diffuse = denoiser(shadings.diffuse.reshape(height, width, 3)).reshape(-1, 3)
        if not specular_too:
            return Shadings(diffuse, shadings.specular)
        specular = np.empty_like(shadings.specular)
        for level in range(specular.shape[1]):
            for term in range(2):
                image = shadings.specular[:, level, term].reshape(height, width, 3)
                specular[:, level, term] = denoiser(image).reshape(-1, 3)
    return Shadings(diffuse, specular)
