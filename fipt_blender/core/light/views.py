# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadings of all training views: baked view by view, denoised, kept as memory-mapped half floats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..render.lights import AreaLights
from ..scene.pixels import PixelStore, open_array
from ..scene.room import Room, triangle_normals
from .denoise import Denoiser
from .radiance import RadianceSource
from .shadings import SampleCounts, ShadingPoints, Shadings, bake

# Most pixels in one kernel launch, so that large photographs stay within memory.
CHUNK = 1 << 18
HALF_LARGEST = 6.0e4


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
        denoise: denoise L_d.
        denoise_specular: denoise L_s0 and L_s1 of every level too.
        seed: each view uses its own stream made of it.
    """
    normals = triangle_normals(room.vertices, room.triangles).astype(np.float32)
    cameras = pixels.camera_positions()
    rays = 0
    for i, view in enumerate(pixels.views):
        first, last = int(pixels.ranges[i]), int(pixels.ranges[i + 1])
        points = view_points(pixels, normals, cameras[i], first, last)
        seen = np.asarray(pixels.triangle[first:last]) >= 0
        found = _bake_seen(points, seen, source, lights, levels, counts, seed * 100003 + i)
        if denoise:
            found = _denoise(found, points.normal, (view.height, view.width), denoise_specular)
        store.diffuse[first:last] = found.diffuse.clip(0.0, HALF_LARGEST)
        store.specular[first:last] = found.specular.clip(0.0, HALF_LARGEST)
        light = counts.light if lights.count else 0
        rays += int(seen.sum()) * (counts.diffuse + counts.specular * len(levels) + light)
        progress((i + 1) / len(pixels.views))
    return rays


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
