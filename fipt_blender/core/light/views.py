# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadings of all training views: baked view by view, denoised, kept as memory-mapped half floats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..render.lights import AreaLights
from ..scene.pixels import PixelStore, open_array, trace_pixels
from ..scene.room import Room, triangle_normals
from .denoise import Denoiser
from .radiance import RadianceSource
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


def bake_views(
    store: ShadingStore,
    pixels: PixelStore,
    labels: np.ndarray,
    room: Room,
    source: RadianceSource,
    lights: AreaLights,
    levels: np.ndarray,
    counts: SampleCounts,
    denoise: bool,
    denoise_specular: bool,
    seed: int,
    progress: Callable[[float], None],
) -> int:
    """Fill `store` and return the number of primary rays traced.

    Args:
        labels: (T,) int part of each triangle; a pixel's samples start on one part.
        denoise: denoise L_d.
        denoise_specular: denoise L_s0 and L_s1 of every level too.
        seed: each view uses its own stream made of it.
    """
    normals = triangle_normals(room.vertices, room.triangles).astype(np.float32)
    cameras = pixels.camera_positions()
    shares = [
        SampleCounts(*(_share(number, index) for number in (counts.diffuse, counts.specular, counts.light)))
        for index in range(len(SUBPIXELS))
    ]
    rays = 0
    for i, view in enumerate(pixels.views):
        first, last = int(pixels.ranges[i]), int(pixels.ranges[i + 1])
        centres = view_points(pixels, normals, cameras[i], first, last)
        triangle = np.asarray(pixels.triangle[first:last])
        seen = triangle >= 0
        diffuse = np.zeros((len(seen), 3), np.float32)
        specular = np.zeros((len(seen), len(levels), 2, 3), np.float32)
        normal = np.zeros((len(seen), 3), np.float32)
        for number, (shift, share) in enumerate(zip(SUBPIXELS, shares, strict=True)):
            points = _shifted(room, view, centres, labels[triangle], labels, shift)
            stream = (seed * 100003 + i) * len(SUBPIXELS) + number
            found = _bake_seen(points, seen, source, lights, levels, share, stream)
            diffuse += found.diffuse / len(SUBPIXELS)
            specular += found.specular / len(SUBPIXELS)
            normal += points.normal
            light = share.light if lights.count else 0
            rays += int(seen.sum()) * (share.diffuse + share.specular * len(levels) + light)
        found = Shadings(diffuse, specular)
        if denoise:
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
            found = _denoise(found, normal, (view.height, view.width), denoise_specular)
        store.diffuse[first:last] = found.diffuse.clip(0.0, HALF_LARGEST)
        store.specular[first:last] = found.specular.clip(0.0, HALF_LARGEST)
        progress((i + 1) / len(pixels.views))
    return rays


def _share(samples: int, index: int) -> int:
    """How many of a pixel's samples start at one of its starts: all of them together, at least one each."""
    return max(1, (samples + index) // len(SUBPIXELS))


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
    position = np.array(surface.position, np.float32).T
    normal = np.array(surface.normal, np.float32).T
    geometric = np.array(dr.select(surface.front, 1.0, -1.0) * mi.Normal3f(surface.geometric_normal)).T
    toward = np.asarray(view.camera_to_world)[:3, 3] - position
    distance = np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    toward = (toward / distance).astype(np.float32)
    cosine = np.abs((toward * geometric).sum(axis=1)).clip(0.05)
    reach = SUBPIXEL_REACH * distance[:, 0] / min(view.fx, view.fy) / cosine
    other = labels[np.where(np.array(surface.valid), np.array(surface.triangle), 0).astype(np.int64)]
    same = np.array(surface.valid) & (other == label)
    same &= np.linalg.norm(position - centres.position, axis=1) < reach
    keep = same[:, None]
    return ShadingPoints(
        np.where(keep, position, centres.position),
        np.where(keep, normal, centres.normal),
        np.where(keep, geometric, centres.geometric_normal),
        np.where(keep, toward, centres.view_direction),
    )


def view_points(
    pixels: PixelStore, normals: np.ndarray, camera: np.ndarray, first: int, last: int
) -> ShadingPoints:
    """Shading points of the pixels first..last of one view.

    Args:
        normals: (T, 3) geometric normals of the room's triangles.
        camera: (3,) camera centre, metres.
    """
    position = np.asarray(pixels.position[first:last])
    toward = camera - position
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    triangle = np.maximum(pixels.triangle[first:last], 0)
    side = np.where(pixels.front[first:last], 1.0, -1.0).astype(np.float32)
    return ShadingPoints(
        position, np.asarray(pixels.normal[first:last]), normals[triangle] * side[:, None], toward
    )


def _bake_seen(
    points: ShadingPoints,
    seen: np.ndarray,
    source: RadianceSource,
    lights: AreaLights,
    levels: np.ndarray,
    counts: SampleCounts,
    seed: int,
) -> Shadings:
    """Bake the pixels that see the mesh; zero elsewhere."""
    result = Shadings(
        np.zeros((len(seen), 3), np.float32), np.zeros((len(seen), len(levels), 2, 3), np.float32)
    )
    rows = np.flatnonzero(seen)
    for number, start in enumerate(range(0, len(rows), CHUNK)):
        part = rows[start : start + CHUNK]
        chunk = ShadingPoints(
            points.position[part],
            points.normal[part],
            points.geometric_normal[part],
            points.view_direction[part],
        )
        baked = bake(chunk, source, lights, levels, counts, seed * 1009 + number)
        result.diffuse[part] = baked.diffuse
        result.specular[part] = baked.specular
    return result


def _denoise(shadings: Shadings, normal: np.ndarray, size: tuple[int, int], specular_too: bool) -> Shadings:
    height, width = size
    guide = np.ones((height, width, 3), np.float32)
    with Denoiser(guide, normal.reshape(height, width, 3), clean_guides=True) as denoiser:
        diffuse = denoiser(shadings.diffuse.reshape(height, width, 3)).reshape(-1, 3)
        if not specular_too:
            return Shadings(diffuse, shadings.specular)
        specular = np.empty_like(shadings.specular)
        for level in range(specular.shape[1]):
            for term in range(2):
                image = shadings.specular[:, level, term].reshape(height, width, 3)
                specular[:, level, term] = denoiser(image).reshape(-1, 3)
    return Shadings(diffuse, specular)
