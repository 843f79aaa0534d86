# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that the photographs show and the mesh lacks (the paper's failure case: missing geometry of a lamp).

Each view projects such a lamp onto a different piece of wall: each piece is far brighter in one view than in
the others, and the rays of these pixels meet at one point in front of the surfaces. The rays of highlights do
not meet, and those of a mirror image meet behind the surface.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from ..pixels.grouped import grouped_median, grouped_sums
from ..pixels.store import PixelStore
from ..robust import LEAST_VIEWS
from .cells import CellPixels, SurfaceCells

# A pixel stands out if it is this many times as bright as its cell in other views, ...
STANDS_OUT = 3.0
# ... and this many times as bright as the capture's median.
BRIGHT = 4.0
# Rays meet where they pass each other within this many pixel footprints.
MEET = 3.0
# Share of the distance to the surface within which they must meet.
IN_FRONT = 0.95
# The radiance behind a lamp is this quantile of the pixels around it.
BEHIND = 0.2
# On a scan, a pixel shows the rim of a lamp of the mesh if a pixel within this distance sees a surface that
# has at least this share of its radiance and is as bright in other views.
RIM, RIM_SHARE = 2, 0.5
TRIES = 2000
# Rays that are used; more only cost time.
MOST_RAYS = 20_000
MOST_LAMPS = 8
# Unit vectors to the faces, edges and corners of a cube.
_FACING = np.array([n for n in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(n)])
_FACING /= np.linalg.norm(_FACING, axis=1, keepdims=True)


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


@dataclass(frozen=True)
class Ball:
    """A ball that looks like a lamp in the photographs.

    Attributes:
        radius: metres.
        radiance: (3,) in units of the pixels.
    """

    radius: float
    radiance: np.ndarray


@dataclass(frozen=True)
class _Rays:
    """Rays from N pixels to the surface points that they see.

    Attributes:
        origin: (N, 3) camera centre, metres.
        segment: (N, 3) vector from the camera to the surface, metres.
        view: (N,) index of the view.
    """

    origin: np.ndarray
    segment: np.ndarray
    view: np.ndarray

    def __len__(self) -> int:
        return len(self.view)

    def among(self, chosen: np.ndarray) -> _Rays:
        """The rays marked in a bool mask (N,), or of the given indices."""
        return _Rays(self.origin[chosen], self.segment[chosen], self.view[chosen])

    def view_count(self, chosen: np.ndarray | slice = slice(None)) -> int:
        """Number of views that the chosen rays come from."""
        return len(np.unique(self.view[chosen]))

    def distances(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) distance in metres at which each ray passes a point, and at which share of its segment."""
        toward = point - self.origin
        share = (toward * self.segment).sum(axis=1) / np.maximum((self.segment**2).sum(axis=1), 1e-30)
        return np.linalg.norm(toward - share[:, None] * self.segment, axis=1), share

    def near(self, point: np.ndarray, reach: float) -> np.ndarray:
        """(N,) bool, rays that pass a point within `reach` metres before they meet the mesh."""
        distance, share = self.distances(point)
        return (distance < reach) & (share > 0.0) & (share < IN_FRONT)

    def closest_point(self) -> np.ndarray | None:
        """(3,) point nearest to all rays by least squares, or None where they are nearly parallel."""
        direction = self.segment / np.linalg.norm(self.segment, axis=1, keepdims=True)
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        matrix = across.sum(axis=0)
        if np.linalg.eigvalsh(matrix)[0] < 0.02 * len(self):
            return None
        return np.linalg.solve(matrix, np.einsum("nij,nj->i", across, self.origin))


def unmeshed_lights(
    cells: SurfaceCells, footprint: float, rng: np.random.Generator, scan: bool
) -> list[UnmeshedLight]:
    """Lamps in front of the mesh, those seen by most views first.

    Args:
        cells: of pixels whose radiance is already brought to one exposure.
        footprint: median width of a pixel on the surfaces, metres.
        scan: whether the mesh is a scan, whose surfaces end beside the lamps that it has.
    """
    pixels = cells.pixels
    rows, steady = _standing_out(cells)
    if scan:
        rows = rows[~_beside(pixels, rows, steady)]
    if len(rows) > MOST_RAYS:
        rows = np.sort(rng.choice(rows, MOST_RAYS, replace=False))
    view = pixels.view_of(rows)
    origin = pixels.camera_positions()[view].astype(np.float64)
    rays = _Rays(origin, np.asarray(pixels.position[rows]) - origin, view)
    lamps: list[UnmeshedLight] = []
    while len(lamps) < MOST_LAMPS and rays.view_count() >= LEAST_VIEWS:
        lamp, near = _meeting(rays, MEET * footprint, rng)
        if lamp is None:
            break
        # At the outline of a lamp that is in the mesh, pixels may count as pure wall and stand out.
        if not _shines(pixels, lamp.position, lamp.radius + MEET * footprint):
            lamps.append(lamp)
        rays = rays.among(~near)
    return lamps


def most_reflected_at(cells: SurfaceCells, places: np.ndarray) -> np.ndarray:
    """(P,) highest grey radiance that a white surface at some places (P, 3) could reflect.

    The surface faces where most light comes from, and nothing occludes the cells' light. A lamp without mesh
    is brighter; a table that a scanner lost is not, even if it is white.
    """
    sums = np.zeros((cells.count, 5))
    for index in range(len(cells.pixels.views)):
        in_view = cells.of_view(index)
        ones, position = np.ones(len(in_view.rows)), cells.pixels.position[in_view.rows]
        values = np.column_stack([ones, np.exp(in_view.value), position])
        sums += grouped_sums(values, in_view.cell, cells.count)
    seen = sums[:, 0] > 0.0
    means = sums[seen, 1:] / sums[seen, :1]
    flux, center = means[:, 0] * cells.grid.size**2 / np.pi, means[:, 1:]
    axis = cells.grid.axes(cells.keys[seen])[:, None]
    most = []
    for place in places:
        distance = np.maximum(np.linalg.norm(center - place, axis=1), cells.grid.size)
        direction = (center - place) / distance[:, None]
        emitted = flux * np.abs(np.take_along_axis(direction, axis, axis=1)[:, 0]) / distance**2
        most.append((emitted @ np.maximum(direction @ _FACING.T, 0.0)).max())
    return np.array(most)


def measure(pixels: PixelStore, lamp: UnmeshedLight, margin: float) -> Ball:
    """The ball whose light is that of a lamp in the median view.

    Its radiance is that of the brightest pixels. Where the lamp is smaller than a pixel, the ball is too
    large and too dim, and its power is still right.

    Args:
        margin: metres around the lamp's radius in which pixels may show it.
    """
    shown = shown_by(pixels, lamp, margin)
    brightest, sums = [], []
    view_of = pixels.view_of(shown)
    for index in np.unique(view_of):
        rows, view = shown[view_of == index], pixels.views[index]
        radiance = np.asarray(pixels.radiance[rows], np.float64)
        grey = radiance.mean(axis=1)
        if not grey.max() > BRIGHT:  # it is occluded
            continue
        behind = min(float(np.quantile(grey, BEHIND)), BRIGHT)
        width = np.linalg.norm(lamp.position - view.camera_to_world[:3, 3]) / min(view.fx, view.fy)
        brightest.append(radiance[grey.argmax()])
        sums.append(float(np.maximum(grey - behind, 0.0).sum() * width**2))
    if not brightest:
        return Ball(lamp.radius, np.zeros(3))
    color = np.median(brightest, axis=0)
    area = float(np.median(sums)) / max(float(color.mean()), 1e-12)
    return Ball(float(np.sqrt(area / np.pi)), color)


def shown_by(pixels: PixelStore, lamp: UnmeshedLight, margin: float) -> np.ndarray:
    """(K,) int64 pixels whose rays pass within a lamp's radius plus `margin` metres, in front of the mesh."""
    shown = []
    for index, camera in enumerate(pixels.camera_positions().astype(np.float64)):
        hit = np.flatnonzero(pixels.triangle[pixels.rows(index)] >= 0) + pixels.ranges[index]
        rays = _Rays(camera[None], np.asarray(pixels.position[hit]) - camera, np.full(len(hit), index))
        distance, share = rays.distances(lamp.position)
        shown.append(hit[(distance < lamp.radius + margin) & (share > 0.0) & (share < 1.0)])
    return np.concatenate(shown)


def _shines(pixels: PixelStore, position: np.ndarray, reach: float) -> bool:
    """Whether a surface point as bright as a lamp lies within `reach` metres of a position ((3,))."""
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        bright = (pixels.triangle[rows] >= 0) & (pixels.radiance[rows].mean(axis=1) > BRIGHT)
        points = np.asarray(pixels.position[rows][bright], np.float64)
        if len(points) and np.linalg.norm(points - position, axis=1).min() <= reach:
            return True
    return False


def _beside(pixels: PixelStore, rows: np.ndarray, steady: np.ndarray) -> np.ndarray:
    """(K,) bool, which pixels that stand out (K,) show the rim of a lamp that is in the mesh.

    Args:
        steady: (S,) int64 pixels of surfaces that are as bright in other views.
    """
    meshed = np.zeros(len(pixels), bool)
    meshed[steady] = True
    result = np.zeros(len(rows), bool)
    for index, view in enumerate(pixels.views):
        place = pixels.rows(index)
        chosen = np.flatnonzero((rows >= place.start) & (rows < place.stop))
        if not len(chosen):
            continue
        radiance = np.asarray(pixels.radiance[place]).mean(axis=1)
        lamps = np.where(meshed[place], radiance, 0.0).reshape(view.height, view.width)
        around = maximum_filter(lamps, 2 * RIM + 1, mode="constant").reshape(-1)
        own = rows[chosen] - place.start
        result[chosen] = around[own] >= RIM_SHARE * radiance[own]
    return result


def _bright(in_view: CellPixels) -> np.ndarray:
    """(M,) bool, pixels bright enough to show a lamp."""
    return in_view.value > np.log(BRIGHT)


def _standing_out(cells: SurfaceCells) -> tuple[np.ndarray, np.ndarray]:
    """(K,) int64 pixels far brighter than the median view of their cell, and (S,) other bright pixels.

    Both are of cells that several views see.
    """
    views = range(len(cells.pixels.views))
    nothing = np.zeros(0, np.int64)
    # Bright pixels are few; the means of all views are kept of their cells only.
    with_bright = np.zeros(cells.count, bool)
    for index in views:
        in_view = cells.of_view(index)
        with_bright[in_view.cell[_bright(in_view)]] = True
    if not with_bright.any():
        return nothing, nothing
    means, bright = [], []
    for index in views:
        in_view = cells.of_view(index)
        in_view = in_view.among(with_bright[in_view.cell])
        means.append(in_view.means())
        bright.append(in_view.among(_bright(in_view)))
    cell, value = (np.concatenate(columns) for columns in zip(*means, strict=True))
    count = np.bincount(cell, minlength=cells.count)
    median = grouped_median(value, cell, cells.count, "low")  # of two views the darker one
    standing, steady = [nothing], [nothing]
    for in_view in bright:
        known = count[in_view.cell] >= LEAST_VIEWS
        brighter = in_view.value - median[in_view.cell] > np.log(STANDS_OUT)
        standing.append(in_view.rows[known & brighter])
        steady.append(in_view.rows[known & ~brighter])
    return np.concatenate(standing), np.concatenate(steady)


def _meeting(rays: _Rays, reach: float, rng: np.random.Generator) -> tuple[UnmeshedLight | None, np.ndarray]:
    """The point that rays of most views pass within `reach` metres, found by random pairs (RANSAC).

    Returns:
        the lamp at that point, None where too few views agree, and (N,) bool, which rays pass it.
    """
    inliers, highest_score = None, 0
    for _ in range(TRIES):
        i, j = rng.integers(0, len(rays), 2)
        if rays.view[i] == rays.view[j]:
            continue
        point = rays.among(np.array([i, j])).closest_point()
        if point is None:
            continue
        near = rays.near(point, reach)
        if not (near[i] and near[j]):
            continue
        score = rays.view_count(near) * len(rays) + int(near.sum())
        if score > highest_score:
            inliers, highest_score = near, score
    if inliers is None:
        return None, np.zeros(len(rays), bool)
    point = rays.among(inliers).closest_point()
    for _ in range(2):  # refined with all inliers
        if point is not None and (near := rays.near(point, reach)).any():
            inliers = near
            point = rays.among(inliers).closest_point()
    views = rays.view_count(inliers)
    if point is None or views < LEAST_VIEWS:
        return None, inliers
    distance, _ = rays.among(inliers).distances(point)
    return UnmeshedLight(point, float(distance.max()), views), inliers
