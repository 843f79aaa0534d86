"""Shadings of all training views: baked view by view, denoised, stored as memory-mapped half floats.

The input shared by all views (:class:`Baking`) and that of one view are arrays and numbers, so that any
process can bake a view.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, fields
from functools import partial
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics.brdf import set_masking
from ..optics.denoise import Denoiser
from ..optics.lights import AreaLights, EmitterTable
from ..pixels.camera_rays import opaque_vector, trace_pixels
from ..pixels.store import PixelStore, ViewPixels, open_array
from ..run.finished_views import FinishedViews
from ..run.per_view import TwoSteps, Workers
from ..surface.room import Room
from .cache import SurfaceLookup, VoxelGrid
from .environment import Environment
from .radiance import CachedRadiance, OutsideRadiance, RadianceSource, TracedRadiance
from .shadings import SampleCounts, ShadingPoints, Shadings, bake, means

# Most pixels in one kernel launch, so that large photographs stay within memory.
CHUNK = 1 << 18
HALF_LARGEST = 6.0e4
# Positions in the pixel at which equal shares of its samples start (pixels from the centre; a rotated grid):
# a photograph integrates over the pixel, so the centre alone would misrepresent bevels and edges.
SUBPIXELS = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
# A start farther than this from the surface point at the centre, in pixel widths, is on another surface.
SUBPIXEL_REACH = 3.0
ROUGHNESS = 3  # column of the materials


@dataclass
class ShadingStore:
    """Baked shadings of every pixel, in units of the capture's median.

    Attributes:
        diffuse: (N, 3) float16.
        specular: (N, K, 2, 3) float16.
        levels: (K,) float32 roughness of the specular ones, ascending.
    """

    diffuse: np.ndarray
    specular: np.ndarray
    levels: np.ndarray

    def flush(self) -> None:
        """Write what was changed to the disk."""
        for array in (self.diffuse, self.specular):
            if isinstance(array, np.memmap):
                array.flush()


def open_shadings(
    folder: Path, pixels: int, levels: np.ndarray, create: bool = False, keep: bool = False
) -> ShadingStore:
    """Open (or create) the arrays in `folder`; arguments and errors as of `open_array`."""
    return ShadingStore(
        open_array(folder / "diffuse.npy", (pixels, 3), np.float16, create, keep),
        open_array(folder / "specular.npy", (pixels, len(levels), 2, 3), np.float16, create, keep),
        levels,
    )


@dataclass(frozen=True)
class TracedLight:
    """Input of stage 3 (see :class:`.radiance.TracedRadiance`).

    Attributes:
        materials: (M * 6, 5) base colour, roughness and metallic of each cache entry.
        diffuse: (M * 6, 3) L_d of each cache entry, negative where unknown; with None, paths also sample
            diffuse reflection.
        cache_roughness: paths end in the cache at rougher surfaces.
        depth: most surfaces of a path.
    """

    materials: np.ndarray
    diffuse: np.ndarray | None
    cache_roughness: float
    depth: int


@dataclass(frozen=True)
class Baking:
    """Baking of the shadings of views, in units of the capture's median.

    Attributes:
        labels: (T,) int part of each triangle; all samples of a pixel start on one part.
        grid: voxels of the cache.
        cache: (M * 6, 3) float32 radiance of each cache entry; None only with `traced`.
        traced: input of stage 3; None in stage 1, which reads the cache at the first hit.
        emitters: triangles to sample; those that are not reflective have their own radiance.
        environment: radiance from outside, or None.
        levels: (K,) float32 roughness levels.
        denoise: denoise L_d.
        denoise_specular: also denoise L_s0 and L_s1.
        masking: G of the BRDF, see `brdf.set_masking`.
        seed: from which the streams of random numbers of each view follow.
    """

    room: Room
    labels: np.ndarray
    grid: VoxelGrid
    cache: np.ndarray | None
    traced: TracedLight | None
    emitters: EmitterTable
    environment: Environment | None
    levels: np.ndarray
    counts: SampleCounts
    denoise: bool
    denoise_specular: bool
    masking: str
    seed: int

    def prepare(self) -> TwoSteps[ViewPixels, NoisyView, tuple[Shadings, int]]:
        """The function of one view: a view is denoised while the next one is traced."""
        set_masking(self.masking)
        lights = AreaLights(self.room.vertices, self.room.triangles, self.emitters)
        tables = TriangleTables.of(self.room, self.labels)
        return TwoSteps(
            partial(bake_view, self, self._source(lights), lights, tables), partial(finish_view, self)
        )

    def _source(self, lights: AreaLights) -> RadianceSource:
        environment = None if self.environment is None else OutsideRadiance(self.environment)
        traced = self.traced
        if traced is None:
            assert self.cache is not None, "stage 1 needs the cache"
            return CachedRadiance(self.room, SurfaceLookup(self.grid, self.cache), environment, lights)
        values = traced.materials
        if self.environment is not None and self.environment.entries is not None:
            values = values.copy()  # paths read inferred radiance from the cache, whatever the surface is
            values[self.environment.entries, ROUGHNESS] = 1.0
        materials = SurfaceLookup(self.grid, values)
        return TracedRadiance(
            room=self.room,
            cache=None if self.cache is None else materials.with_values(self.cache),
            materials=materials,
            diffuse=None if traced.diffuse is None else materials.with_values(traced.diffuse),
            lights=lights,
            environment=environment,
            cache_roughness=traced.cache_roughness,
            depth=traced.depth,
        )


@dataclass(frozen=True)
class NoisyView:
    """Shadings of one view as they were traced.

    Attributes:
        shadings: of all N pixels.
        normal: (N, 3) float32 mean normals, not of unit length; zero without denoising.
        size: height and width in pixels.
        rays: number of primary rays traced.
    """

    shadings: Shadings
    normal: np.ndarray
    size: tuple[int, int]
    rays: int


def bake_views(
    store: ShadingStore,
    pixels: PixelStore,
    baking: Baking,
    progress: Callable[[float], None],
    workers: Workers,
    finished: FinishedViews,
) -> int:
    """Fill `store` with the views that are not `finished` yet; returns the primary rays of all views."""
    count = len(pixels.views)
    remaining = [index for index in range(count) if index not in finished.views]
    items = (pixels.of_view(index) for index in remaining)
    for number, (baked, rays) in workers.map(baking, items):
        index = remaining[number]
        rows = pixels.rows(index)
        store.diffuse[rows], store.specular[rows] = baked.diffuse, baked.specular
        finished.add(index, rays)
        progress(len(finished.views) / count)
    return finished.rays


def baked_light(baking: Baking, pixels: PixelStore, rows: np.ndarray, counts: SampleCounts) -> np.ndarray:
    """(M, 3) float32 L_d at the centres of some pixels (M,) that see the room, not denoised."""
    set_masking(baking.masking)
    room, lights = baking.room, AreaLights(baking.room.vertices, baking.room.triangles, baking.emitters)
    source = baking._source(lights)
    cameras, result = pixels.camera_positions(), np.zeros((len(rows), 3), np.float32)
    for number, begin in enumerate(range(0, len(rows), CHUNK)):
        chunk = rows[begin : begin + CHUNK]
        position, geometric = pixels.surface(room, chunk)
        toward = cameras[pixels.view_of(chunk)] - position
        toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-6)
        points = ShadingPoints(position, np.asarray(pixels.normal[chunk]), geometric, toward)
        none = baking.levels[:0]
        baked = bake(points, source, lights, none, counts, baking.seed * 100003 + number)
        result[begin : begin + CHUNK] = baked.diffuse
    return result


def bake_view(
    baking: Baking,
    source: RadianceSource,
    lights: AreaLights,
    tables: TriangleTables,
    pixels: ViewPixels,
) -> NoisyView:
    """Trace the shadings of one view.

    Args:
        source, lights, tables: of `baking`.
    """
    levels, view = baking.levels, pixels.view
    size = view.height * view.width
    rows = np.flatnonzero(pixels.triangle >= 0)
    counts = SampleCounts(*(samples_per_start(samples) for samples in astuple(baking.counts)))
    stream = baking.seed * 100003 + pixels.index
    shadings = Shadings(np.zeros((size, 3), np.float32), np.zeros((size, len(levels), 2, 3), np.float32))
    normal = np.zeros((size, 3), np.float32)
    step = max(1, CHUNK // len(SUBPIXELS))
    for number, begin in enumerate(range(0, len(rows), step)):
        chunk = rows[begin : begin + step]
        points = start_points(baking.room, pixels, chunk, tables)
        baked = bake(points, source, lights, levels, counts, stream * 1009 + number, len(SUBPIXELS))
        shadings.diffuse[chunk], shadings.specular[chunk] = baked.diffuse, baked.specular
        if baking.denoise:
            normal[chunk] = means([points.normal], len(SUBPIXELS))
    samples = counts.diffuse + counts.specular * len(levels) + (counts.light if lights.count else 0)
    return NoisyView(shadings, normal, (view.height, view.width), len(rows) * samples * len(SUBPIXELS))


def finish_view(baking: Baking, view: NoisyView) -> tuple[Shadings, int]:
    """Denoise the shadings of one view, if wanted, and round them to float16; and the primary rays traced."""
    shadings, normal = view.shadings, view.normal
    if baking.denoise:
        normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
        shadings = denoised(shadings, normal, view.size, baking.denoise_specular)
    rounded = (
        array.clip(0.0, HALF_LARGEST).astype(np.float16) for array in (shadings.diffuse, shadings.specular)
    )
    return Shadings(*rounded), view.rays


def samples_per_start(samples: int) -> int:
    """Samples from each start of a pixel, so that all starts together take at least `samples`."""
    return -(-samples // len(SUBPIXELS))


@dataclass(frozen=True)
class TriangleTables:
    """Tables of the room's triangles on the device, for :func:`start_points`.

    Attributes:
        normal: (T * 3) geometric normals.
        label: (T) as in :class:`Baking`.
    """

    normal: mi.Float
    label: mi.Int32

    @classmethod
    def of(cls, room: Room, labels: np.ndarray) -> TriangleTables:
        """Tables of a room; `labels` (T,) int."""
        normals = room.normals.astype(np.float32)
        return cls(mi.Float(normals.reshape(-1)), mi.Int32(np.ascontiguousarray(labels, np.int32)))


def start_points(room: Room, pixels: ViewPixels, rows: np.ndarray, tables: TriangleTables) -> ShadingPoints:
    """Evaluated points at which the samples of some pixels start, at each pixel's :data:`SUBPIXELS` in order.

    Each is the surface point at that position, or the one at the pixel's centre where the position
    shows another surface: one of another label, or far away.

    Args:
        rows: (M,) pixels of the view that see the room.
    """
    view, count = pixels.view, len(SUBPIXELS)
    pixel_of_lane = dr.arange(mi.UInt32, len(rows) * count) // count
    camera = np.asarray(view.camera_to_world)[:3, 3]

    def gather(kind: type, array: np.ndarray) -> mi.Float | mi.Int32 | mi.Vector3f:
        flat = np.ascontiguousarray(array[rows]).reshape(-1)
        scalar = mi.Float if flat.dtype == np.float32 else mi.Int32
        return dr.gather(kind, scalar(flat), pixel_of_lane)

    triangle = mi.UInt32(gather(mi.Int32, pixels.triangle))
    side = gather(mi.Float, np.where(pixels.front, np.float32(1.0), np.float32(-1.0)))
    position, normal = gather(mi.Point3f, pixels.position), gather(mi.Normal3f, pixels.normal)
    geometric = dr.gather(mi.Normal3f, tables.normal, triangle) * side
    view_direction, _ = _unit(opaque_vector(mi.Vector3f, camera) - mi.Vector3f(position))
    centre = ShadingPoints(position, normal, geometric, view_direction)

    surface = trace_pixels(room, view, SUBPIXELS, mi.UInt32(rows.astype(np.uint32)))
    geometric = surface.geometric_normal * dr.select(surface.front, mi.Float(1.0), -1.0)
    view_direction, distance = _unit(opaque_vector(mi.Vector3d, camera) - mi.Vector3d(surface.position))
    view_direction = mi.Vector3f(view_direction)
    subpixel = ShadingPoints(surface.position, surface.normal, geometric, view_direction)
    product = view_direction * geometric
    cosine = dr.maximum(dr.abs(product.x + product.y + product.z), 0.05)
    focal_length = dr.opaque(mi.Float64, float(min(view.fx, view.fy)))
    reach = SUBPIXEL_REACH * distance / focal_length / mi.Float64(cosine)
    label = dr.gather(mi.Int32, tables.label, triangle)
    same = surface.valid & (dr.gather(mi.Int32, tables.label, surface.triangle, surface.valid) == label)
    same &= mi.Float64(_unit(surface.position - position)[1]) < reach
    chosen = [
        dr.select(same, getattr(subpixel, item.name), getattr(centre, item.name))
        for item in fields(ShadingPoints)
    ]
    dr.eval(chosen)
    return ShadingPoints(*chosen)


def _unit(vector: mi.Vector3f | mi.Vector3d) -> tuple[mi.Vector3f | mi.Vector3d, mi.Float | mi.Float64]:
    """Direction and length of a vector, without Dr.Jit's fused sums and reciprocals: rounded as in numpy."""
    x, y, z = vector.x, vector.y, vector.z
    length = dr.maximum(dr.sqrt(x * x + y * y + z * z), 1e-12)
    return type(vector)(x / length, y / length, z / length), length


def denoised(shadings: Shadings, normal: np.ndarray, size: tuple[int, int], specular_too: bool) -> Shadings:
    """The shadings of a view (height, width) with normals (N, 3): L_d is denoised and, if wanted, the others.

    Specular shadings change as their brightness does, the sum over both terms and all channels.

    The noise of both terms and of all channels is alike, because they come from the same rays. Images of
    their own would take five times as long and not improve the materials.
    """
    guide = np.ones((*size, 3), np.float32)
    with Denoiser(guide, normal.reshape(*size, 3), fast=True) as denoiser:
        diffuse = denoiser(shadings.diffuse.reshape(*size, 3)).reshape(-1, 3)
        if not specular_too:
            return Shadings(diffuse, shadings.specular)
        noisy = shadings.specular.sum(axis=(2, 3))
        smooth = np.empty_like(noisy)
        for first in range(0, noisy.shape[1], 3):
            # The three channels of an image are three levels.
            levels = np.minimum(np.arange(first, first + 3), noisy.shape[1] - 1)
            smooth[:, levels] = denoiser(noisy[:, levels].reshape(*size, 3)).reshape(-1, 3)
    change = smooth / np.maximum(noisy, 1e-6)
    return Shadings(diffuse, shadings.specular * change[:, :, None, None])
