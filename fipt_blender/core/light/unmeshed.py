# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that the photographs show and the mesh lacks (the paper's failure case: a lamp's missing geometry).

Such a lamp is painted onto a different piece of wall by every view: each piece is far brighter in one view
than in the others, and the rays of these pixels meet in one point in front of the surfaces. Highlights do not
meet, and what a mirror shows lies behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.pixels import PixelStore
from .agreement import SurfaceCells

# A pixel stands out when so many times as bright as its cell in other views and as the capture's median.
STANDS_OUT = 3.0
BRIGHT = 4.0
# Views in which a lamp must stand out, and views that must know a cell.
LEAST_VIEWS = 3
# Rays meet where they pass each other within this many pixel footprints.
MEET = 3.0
# Share of the way to the surface within which they must meet.
IN_FRONT = 0.95
TRIES = 2000
# Rays that are looked at; more change nothing but the time.
MOST_RAYS = 20_000
MOST_LAMPS = 8


@dataclass(frozen=True)
class UnmeshedLight:
    """A lamp without mesh.

    Attributes:
        position: (3,) metres.
        radius: metres within which all its rays pass.
        views: number of views in which it stands out.
    """

    position: np.ndarray
    radius: float
    views: int


def unmeshed_lights(cells: SurfaceCells, footprint: float, rng: np.random.Generator) -> list[UnmeshedLight]:
    """Lamps in front of the mesh, those seen by most views first.

    Args:
        cells: of pixels whose radiance is already brought to one exposure.
        footprint: median width of a pixel on the surfaces, metres.
    """
    pixels = cells.pixels
    rows = _standing_out(cells)
    if len(rows) > MOST_RAYS:
        rows = np.sort(rng.choice(rows, MOST_RAYS, replace=False))
    view = pixels.view_of(rows)
    origin = pixels.camera_positions()[view].astype(np.float64)
    way = np.asarray(pixels.position[rows]) - origin
    lamps: list[UnmeshedLight] = []
    while len(lamps) < MOST_LAMPS and len(np.unique(view)) >= LEAST_VIEWS:
        lamp, near = _meeting(origin, way, view, MEET * footprint, rng)
        if lamp is None:
            break
        # Around a lamp that has its mesh, pixels at its outline may pass for wall alone and stand out.
        if not _shines(pixels, lamp.position, lamp.radius + MEET * footprint):
            lamps.append(lamp)
        origin, way, view = origin[~near], way[~near], view[~near]
    return lamps


def shown_by(pixels: PixelStore, lamp: UnmeshedLight, margin: float) -> np.ndarray:
    """(K,) int64 pixels whose rays pass a lamp within its radius and a margin in metres, before the mesh."""
    found = []
    for index, camera in enumerate(pixels.camera_positions().astype(np.float64)):
        hit = np.flatnonzero(pixels.triangle[pixels.rows(index)] >= 0) + pixels.ranges[index]
        distance, share = _passing(camera, np.asarray(pixels.position[hit]) - camera, lamp.position)
        found.append(hit[(distance < lamp.radius + margin) & (share > 0.0) & (share < 1.0)])
    return np.concatenate(found)


def _shines(pixels: PixelStore, position: np.ndarray, reach: float) -> bool:
    """Whether a surface point as bright as a lamp lies within `reach` metres of a position ((3,))."""
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        bright = (pixels.triangle[rows] >= 0) & (pixels.radiance[rows].mean(axis=1) > BRIGHT)
        points = np.asarray(pixels.position[rows][bright], np.float64)
        if len(points) and np.linalg.norm(points - position, axis=1).min() <= reach:
            return True
    return False


def _standing_out(cells: SurfaceCells) -> np.ndarray:
    """(K,) int64 pixels far brighter than their cell is in the views that know it."""
    views = range(len(cells.pixels.views))
    # Bright pixels are few; only what views know of their cells is kept.
    asked = np.zeros(cells.count, bool)
    for index in views:
        own = cells.of_view(index)
        asked[own.cell[own.value > np.log(BRIGHT)]] = True
    if not asked.any():
        return np.zeros(0, np.int64)
    known, bright = [], []
    for index in views:
        own = cells.of_view(index)
        own = own.among(asked[own.cell])
        known.append(own.means())
        bright.append(own.among(own.value > np.log(BRIGHT)))
    cell, value = (np.concatenate(columns) for columns in zip(*known, strict=True))
    order = np.lexsort((value, cell))
    count = np.bincount(cell, minlength=cells.count)
    first = np.cumsum(count) - count
    # The lower median: of two views the darker one.
    middle = value[order][np.minimum(first + np.maximum(count - 1, 0) // 2, max(len(value) - 1, 0))]
    out = [
        (count[own.cell] >= LEAST_VIEWS) & (own.value - middle[own.cell] > np.log(STANDS_OUT))
        for own in bright
    ]
    return np.concatenate([own.rows[chosen] for own, chosen in zip(bright, out, strict=True)])


def _meeting(
    origin: np.ndarray, way: np.ndarray, view: np.ndarray, reach: float, rng: np.random.Generator
) -> tuple[UnmeshedLight | None, np.ndarray]:
    """The point that rays of most views pass, found by trying pairs; and which rays pass it."""
    best, most = None, 0
    for _ in range(TRIES):
        i, j = rng.integers(0, len(origin), 2)
        if view[i] == view[j]:
            continue
        point = _closest(origin[[i, j]], way[[i, j]])
        if point is None:
            continue
        near = _near(origin, way, point, reach)
        if not (near[i] and near[j]):
            continue
        score = len(np.unique(view[near])) * len(origin) + int(near.sum())
        if score > most:
            best, most = near, score
    if best is None:
        return None, np.zeros(len(origin), bool)
    point = _closest(origin[best], way[best])
    for _ in range(2):  # all rays together know better than two
        if point is not None and _near(origin, way, point, reach).any():
            best = _near(origin, way, point, reach)
            point = _closest(origin[best], way[best])
    if point is None or len(np.unique(view[best])) < LEAST_VIEWS:
        return None, best
    distance, _ = _passing(origin[best], way[best], point)
    return UnmeshedLight(point, float(distance.max()), len(np.unique(view[best]))), best


def _closest(origin: np.ndarray, way: np.ndarray) -> np.ndarray | None:
    """(3,) the point nearest to all rays, or None where they run side by side."""
    direction = way / np.linalg.norm(way, axis=1, keepdims=True)
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    matrix = across.sum(axis=0)
    if np.linalg.eigvalsh(matrix)[0] < 0.02 * len(origin):
        return None
    return np.linalg.solve(matrix, np.einsum("nij,nj->i", across, origin))


def _near(origin: np.ndarray, way: np.ndarray, point: np.ndarray, reach: float) -> np.ndarray:
    """(N,) bool, rays that pass the point, before they meet the mesh."""
    distance, share = _passing(origin, way, point)
    return (distance < reach) & (share > 0.0) & (share < IN_FRONT)


def _passing(origin: np.ndarray, way: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance at which each ray passes a point, and at which share of its way to the mesh."""
    toward = point - origin
    share = (toward * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-30)
    return np.linalg.norm(toward - share[:, None] * way, axis=1), share
