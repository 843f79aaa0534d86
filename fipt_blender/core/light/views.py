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

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..job.per_view import Workers
from ..material.brdf import set_masking
from ..render.environment import EnvironmentLight
from ..render.lights import AreaLights, EmitterTable
from ..scene.pixels import PixelStore, ViewPixels, open_array, trace_pixels
from ..scene.room import Room, triangle_normals
from .cache import SurfaceLookup, VoxelGrid
from .denoise import Denoiser
from .radiance import CachedRadiance, RadianceSource, TracedRadiance
from .shadings import SampleCounts, ShadingPoints, Shadings, bake

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
        normals = triangle_normals(self.room.vertices, self.room.triangles).astype(np.float32)
        return partial(bake_view, self, self._source(lights), lights, normals)

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
    baking: Baking, source: RadianceSource, lights: AreaLights, normals: np.ndarray, pixels: ViewPixels
) -> BakedView:
    """Shadings of one view.

    Args:
        source, lights: of `baking`.
        normals: (T, 3) geometric normals of the room's triangles.
    """
    levels, view = baking.levels, pixels.view
    centres = view_points(pixels, normals)
    label = baking.labels[pixels.triangle]
    starts = [_shifted(baking.room, view, centres, label, baking.labels, shift) for shift in SUBPIXELS]
    counts = SampleCounts(*(_share(samples) for samples in astuple(baking.counts)))
    rows = np.flatnonzero(pixels.triangle >= 0)
    stream = baking.seed * 100003 + pixels.index
    found = _bake_rows(starts, rows, source, lights, levels, counts, stream)
    if baking.denoise:
        normal = np.sum([points.normal for points in starts], axis=0)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
        found = _denoise(found, normal, (view.height, view.width), baking.denoise_specular)
    halves = [array.clip(0.0, HALF_LARGEST).astype(np.float16) for array in (found.diffuse, found.specular)]
    samples = counts.diffuse + counts.specular * len(levels) + (counts.light if lights.count else 0)
    return BakedView(halves[0], halves[1], len(rows) * samples * len(SUBPIXELS))


def _share(samples: int) -> int:
    """How many of a pixel's samples begin at each of its starts, at least all of them together."""
    return -(-samples // len(SUBPIXELS))


def _shifted(
    room: Room,
    view: View,
    centres: ShadingPoints,
    label: np.ndarray,
    labels: np.ndarray,
    shift: tuple[float, float],
) -> ShadingPoints:
    """The surface points beside the pixels' centres; the centre where another surface lies there.

    Args:
        label: (N,) int of the centres' triangles, labels: (T,) of all.
        shift: pixels.
    """
    surface = trace_pixels(room, view, shift)
    valid = np.array(surface.valid)
    # Where the mesh is missed, positions lie at infinity.
    position = np.where(valid[:, None], np.array(surface.position, np.float32).T, centres.position)
    normal = np.array(surface.normal, np.float32).T
    geometric = np.array(dr.select(surface.front, 1.0, -1.0) * mi.Normal3f(surface.geometric_normal)).T
    toward = np.asarray(view.camera_to_world)[:3, 3] - position
    distance = np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    toward = (toward / distance).astype(np.float32)
    cosine = np.abs((toward * geometric).sum(axis=1)).clip(0.05)
    reach = SUBPIXEL_REACH * distance[:, 0] / min(view.fx, view.fy) / cosine
    other = labels[np.where(valid, np.array(surface.triangle), 0).astype(np.int64)]
    same = valid & (other == label)
    same &= np.linalg.norm(position - centres.position, axis=1) < reach
    keep = same[:, None]
    return ShadingPoints(
        np.where(keep, position, centres.position),
        np.where(keep, normal, centres.normal),
        np.where(keep, geometric, centres.geometric_normal),
        np.where(keep, toward, centres.view_direction),
    )


def view_points(pixels: ViewPixels, normals: np.ndarray) -> ShadingPoints:
    """Shading points of the pixels' centres.

    Args:
        normals: (T, 3) geometric normals of the room's triangles.
    """
    toward = pixels.view.camera_to_world[:3, 3].astype(np.float32) - pixels.position
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    side = np.where(pixels.front, 1.0, -1.0).astype(np.float32)
    geometric = normals[np.maximum(pixels.triangle, 0)] * side[:, None]
    return ShadingPoints(pixels.position, pixels.normal, geometric, toward)


def _bake_rows(
    starts: list[ShadingPoints],
    rows: np.ndarray,
    source: RadianceSource,
    lights: AreaLights,
    levels: np.ndarray,
    counts: SampleCounts,
    seed: int,
) -> Shadings:
    """Bake some pixels, mean over their starts; zero elsewhere.

    Args:
        starts: for each start the points of all pixels.
        rows: (M,) pixels to bake.
        counts: samples a start.
    """
    count, size = len(starts), len(starts[0].position)
    result = Shadings(np.zeros((size, 3), np.float32), np.zeros((size, len(levels), 2, 3), np.float32))
    step = max(1, CHUNK // count)
    for number, begin in enumerate(range(0, len(rows), step)):
        part = rows[begin : begin + step]

        def together(name: str, part: np.ndarray = part) -> np.ndarray:
            """A pixel's starts one after the other, as their rays meet the same things."""
            return np.stack([getattr(points, name)[part] for points in starts], axis=1).reshape(-1, 3)

        chunk = ShadingPoints(*(together(item.name) for item in fields(ShadingPoints)))
        baked = bake(chunk, source, lights, levels, counts, seed * 1009 + number, count)
        result.diffuse[part], result.specular[part] = baked.diffuse, baked.specular
    return result


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
