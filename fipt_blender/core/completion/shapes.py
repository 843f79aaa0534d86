"""Surfaces in rows of about square cells, of which any can be meshed, fitted to triangles of a scan.

Upright surfaces of revolution are lamp shades, vases, pots, drums and columns; sheets, which are heights over
a plane, are fronts, boards and curtains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from ..surface.adjacency import without_unused


@dataclass(frozen=True, eq=False)
class CellSurface:
    """A surface by the corners of its cells. Seen from its front, columns run to the left of rising rows.

    Attributes:
        places: (R + 1, S + 1, 3) metres.
        normals: (R + 1, S + 1, 3) unit normals of its front.
        step: edge of a cell, metres.
        around: whether its last corners are the first ones again.
    """

    places: np.ndarray
    normals: np.ndarray
    step: float
    around: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.places.shape[0] - 1, self.places.shape[1] - 1

    def near(self, points: np.ndarray, distance: float) -> np.ndarray:
        """(N,) bool, whether points (N, 3) are about so many metres from the surface or closer."""
        reach = float(np.hypot(distance, self.step / np.sqrt(2.0)))
        away, _ = cKDTree(self.places.reshape(-1, 3)).query(points, distance_upper_bound=reach)
        return np.isfinite(away)

    def cells(self, down: float = 0.0, across: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Places (R, S, 3) in the cells and unit normals (R, S, 3) of their fronts.

        Args:
            down, across: where, in cells from their middles.
        """
        v, u = 0.5 + down, 0.5 + across
        places, normals = (
            (1.0 - v) * ((1.0 - u) * each[:-1, :-1] + u * each[:-1, 1:])
            + v * ((1.0 - u) * each[1:, :-1] + u * each[1:, 1:])
            for each in (self.places, self.normals)
        )
        return places, normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)

    def surface(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The mesh of some cells (R, S) bool.

        Returns:
            vertices (V, 3) float32, triangles (T, 3) int32, and corner normals (T, 3, 3) float32.
        """
        columns = self.shape[1] + (not self.around)
        row, column = np.nonzero(chosen)
        corners = [(row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)]
        index = np.stack([down * columns + across % columns for down, across in corners], axis=1)
        used, triangles = without_unused(index[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
        places, normals = (each[:, :columns].reshape(-1, 3)[used] for each in (self.places, self.normals))
        return places.astype(np.float32), triangles, normals[triangles].astype(np.float32)


# Triangles that face up or down by more than this sine hardly determine an axis or a radius.
STEEPEST = 0.87
# Share of the area that must lie within half a row of the surface, and most degrees between the normals
# and the surface's (median): boxes, leaves and cushions do not reach them, fluted and noisy vases do.
LEAST_INSIDE, MOST_DEGREES = 0.7, 15.0
# In rows: the smallest radius, and the least height.
LEAST_RADIUS, LEAST_ROWS = 3.0, 3
# Share of the area at either end that does not count for its height.
_TAIL = 0.01
_ROUNDS = 15


def revolved(axis: np.ndarray, low: float, step: float, radius: np.ndarray, side: int) -> CellSurface:
    """The surface of revolution about an upright axis.

    Args:
        axis: (2,) x and y of the axis, metres.
        low: z of the lower end, metres.
        step: height of a row, metres.
        radius: (R + 1,) metres at the ends of the rows, upwards.
        side: 1 where its front is outside, -1 where it is inside.
    """
    count = max(int(np.ceil(2.0 * np.pi * float(radius.max()) / step)), 3)
    angle = -side * 2.0 * np.pi * np.arange(count + 1) / count
    away = np.stack([np.cos(angle), np.sin(angle), np.zeros(count + 1)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    height, slope = low + step * np.arange(len(radius)), np.gradient(radius) / step
    places = np.append(axis, 0.0) + radius[:, None, None] * away + height[:, None, None] * up
    normals = side * (away - slope[:, None, None] * up) / np.sqrt(1.0 + slope**2)[:, None, None]
    return CellSurface(places, normals, step, around=True)


def fit_revolutions(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float
) -> list[CellSurface]:
    """Surfaces of revolution through the triangles of one thing, whose outside and inside are apart.

    Args:
        points: (N, 3) middles of the triangles, metres.
        normals: (N, 3) unit normals of their fronts.
        areas: (N,) square metres.
        step: height of a row, metres.

    Returns:
        those that most of the area of a side lies on.
    """
    steep = np.flatnonzero(np.abs(normals[:, 2]) < STEEPEST)
    axis = _axis_of_normals(points[steep], normals[steep], areas[steep], step)
    if axis is None:
        return []
    outward = (normals[steep, :2] * (points[steep, :2] - axis)).sum(axis=1)
    found = []
    for side in (1, -1):
        rows = steep[side * outward > 0.0]
        revolution = _fitted_revolution(points[rows], normals[rows], areas[rows], axis, step, side)
        if revolution is not None:
            found.append(revolution)
    return found


def _axis_of_normals(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float
) -> np.ndarray | None:
    """(2,) the place that the lines along the normals pass most closely, seen from above; robust."""
    across = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    along = (across * points[:, :2]).sum(axis=1)
    weight, axis = areas, None
    for _ in range(_ROUNDS):
        matrix = (across * weight[:, None]).T @ across
        if len(points) < 3 or np.linalg.cond(matrix) > 1e6:
            return None
        axis = np.linalg.solve(matrix, across.T @ (weight * along))
        weight = areas / (1.0 + ((along - across @ axis) / (0.5 * step)) ** 2)
    return axis


def _fitted_revolution(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, axis: np.ndarray, step: float, side: int
) -> CellSurface | None:
    """The surface whose front triangles are given, None where they lie on none."""
    if len(points) < LEAST_ROWS * LEAST_RADIUS:
        return None
    order = np.argsort(points[:, 2])
    share = np.cumsum(areas[order]) / areas.sum()
    low, high = np.interp((_TAIL, 1.0 - _TAIL), share, points[order, 2])
    rows = int(np.ceil((high - low) / step))
    if rows < LEAST_ROWS:
        return None
    row = np.clip(((points[:, 2] - low) / step).astype(np.int64), 0, rows - 1)
    order = np.argsort(row, kind="stable")
    groups = np.split(order, np.searchsorted(row[order], np.arange(1, rows)))
    filled = np.array([len(group) > 0 for group in groups])
    for _ in range(_ROUNDS):
        offset = points[:, :2] - axis
        distance = np.linalg.norm(offset, axis=1)
        medians = np.array([np.median(distance[group]) for group in groups if len(group)])
        profile = np.interp(np.arange(rows), np.flatnonzero(filled), medians)
        off = distance - profile[row]
        weight = areas / (1.0 + (off / (0.5 * step)) ** 2)
        away = offset / np.maximum(distance, 1e-9)[:, None]
        matrix = (away * weight[:, None]).T @ away
        if np.linalg.cond(matrix) > 1e6:
            return None
        axis = axis + np.linalg.solve(matrix, away.T @ (weight * off))
    offset = points[:, :2] - axis
    distance = np.linalg.norm(offset, axis=1)
    inside = areas[np.abs(distance - profile[row]) < 0.5 * step].sum() / areas.sum()
    flat = np.linalg.norm(normals[:, :2], axis=1) * np.maximum(distance, 1e-9)
    cosine = np.abs((normals[:, :2] * offset).sum(axis=1)) / np.maximum(flat, 1e-9)
    turn = np.degrees(np.median(np.arccos(np.clip(cosine, 0.0, 1.0))))
    if inside < LEAST_INSIDE or turn > MOST_DEGREES or profile.max() < LEAST_RADIUS * step:
        return None
    # Rows know the radius at their middles.
    ends = np.interp(np.arange(rows + 1.0), np.arange(rows) + 0.5, profile)
    ends[[0, -1]] += 0.5 * np.array([profile[0] - profile[1], profile[-1] - profile[-2]])
    return revolved(axis, float(low), (high - low) / rows, np.maximum(ends, 0.0), side)


# Triangles within so many cells of a plane, which face its front by at least this cosine, are of its sheet.
BAND, LEAST_FACING = 2.0, 0.5
# Planes that are tried, and triangles that each is tried on.
CANDIDATES, _SAMPLE = 100, 5000
# The plane goes on by this share of its extent, as torn ends have to be found; masks show where it ends.
MARGIN = 0.5
# Where the scan has nothing, heights are means of those around, by a Gaussian of so many cells.
SMOOTHED = 3.0
_MOST_CELLS = 500


def fit_sheets(
    points: np.ndarray,
    normals: np.ndarray,
    areas: np.ndarray,
    step: float,
    least: int,
    rng: np.random.Generator,
) -> list[CellSurface]:
    """Sheets through the triangles of a part, the largest first; each triangle is of one at most.

    Args:
        points: (N, 3) middles of the triangles, metres.
        normals: (N, 3) unit normals of their fronts.
        areas: (N,) square metres.
        step: edge of a cell, metres.
        least: triangles of a sheet.
    """
    found = []
    left = np.arange(len(points))
    while len(left) >= least:
        rows = _largest_plane(points[left], normals[left], areas[left], BAND * step, rng)
        if len(rows) < least:
            break
        rows = left[rows]
        sheet = _fitted_sheet(points[rows], normals[rows], areas[rows], step)
        if sheet is not None:
            found.append(sheet)
        left = np.setdiff1d(left, rows)
    return found


def _largest_plane(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, band: float, rng: np.random.Generator
) -> np.ndarray:
    """Rows of the triangles on the plane with the largest area, of those through some triangles (RANSAC)."""
    share = areas / areas.sum()
    tried = rng.choice(len(points), min(CANDIDATES, len(points)), replace=False, p=share)
    sample = rng.choice(len(points), min(_SAMPLE, len(points)), replace=False)

    def on(plane: int, rows: np.ndarray) -> np.ndarray:
        off = np.abs((points[rows] - points[plane]) @ normals[plane]) < band
        return np.asarray(off & (normals[rows] @ normals[plane] > LEAST_FACING))

    best = max(tried, key=lambda plane: float(areas[sample][on(plane, sample)].sum()))
    return np.flatnonzero(on(best, np.arange(len(points))))


def _fitted_sheet(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float
) -> CellSurface | None:
    """The sheet of the triangles on a plane, None if it is too large."""
    centre = np.average(points, axis=0, weights=areas)
    axes = np.linalg.svd((points - centre) * np.sqrt(areas)[:, None], full_matrices=False)[2]
    if (normals @ axes[2] * areas).sum() < 0.0:
        axes[2] = -axes[2]
    axes[1] = np.cross(axes[2], axes[0])
    local = (points - centre) @ axes.T
    low, high = local[:, :2].min(axis=0), local[:, :2].max(axis=0)
    low, high = low - MARGIN * (high - low), high + MARGIN * (high - low)
    rows, columns = np.ceil((high - low) / step).astype(int)
    if max(rows, columns) > _MOST_CELLS:
        return None
    # Each triangle counts for the nearest corner of a cell.
    row, column = np.round((local[:, :2] - low) / step).astype(np.int64).T
    weight, total = np.zeros((2, rows + 1, columns + 1))
    np.add.at(weight, (row, column), areas)
    np.add.at(total, (row, column), areas * local[:, 2])
    around = gaussian_filter(np.stack([weight, total]), (0.0, SMOOTHED, SMOOTHED), mode="constant")
    little = 1e-3 * float(areas.mean())  # far from all triangles the height goes to that of the plane
    height = np.where(weight > 0.0, total / np.maximum(weight, 1e-20), around[1] / (around[0] + little))
    flat = np.moveaxis(low[:, None, None] + step * np.indices(height.shape), 0, 2)
    down, across = np.gradient(height, step)
    along = np.dstack([-down, -across, np.ones_like(height)]) @ axes
    normals = along / np.linalg.norm(along, axis=2, keepdims=True)
    return CellSurface(centre + np.dstack([flat, height]) @ axes, normals, step)
