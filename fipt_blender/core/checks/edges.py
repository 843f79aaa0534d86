# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a mesh's edges are from those of a photograph, by the small motion of the camera that joins them.

Edges of the mesh are jumps of depth and of the normal. Across each of them the photograph's gradient is
searched; the motion that most edges agree with is found by shifts first, then by least squares with a search
that narrows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

REACH = 12  # pixels across an edge that are searched
_STEP = 0.5  # of the search
_CREASE = np.cos(np.radians(25.0))  # normals of neighbouring pixels that differ more make an edge
_JUMP = 0.02  # distance of a pixel's point from its neighbour's plane, over the depth, that makes an edge
_NEIGHBOURS = 9  # edge pixels around each from which its direction is taken
_THIN = 0.15  # width over length of these neighbours, above which they form a corner rather than a line
_MOST_EDGES = 4000  # of a view; more only cost time
LEAST_EDGES = 40  # pieces of edge, each `_SHARED` pixels to either side
_BLUR = 0.8  # pixels, of the photograph
_LEAST_CONTRAST = 0.02  # of log radiance per pixel, below which a gradient is noise
_WIDTHS = (4.0, 2.0, 1.2, 0.8, 0.8, 0.8)  # standard deviations of the narrowing search, pixels
_SHARED = 4.0  # pixels within which edge points see the same gradient
_PRIOR = 2.0  # pixels by which each of the six motions is expected to be off
_UNSURE = 0.5  # pixels of standard deviation of the result, above which there is no verdict


@dataclass(frozen=True, eq=False)
class MeshEdges:
    """Points on the edges of a mesh in a view.

    Attributes:
        pixel: (K, 2) x, y; the centre of the first pixel is (0.5, 0.5).
        normal: (K, 2) unit vectors across the edge.
        depth: (K,) along the camera's Z, of the nearer side.
    """

    pixel: np.ndarray
    normal: np.ndarray
    depth: np.ndarray

    def over(self, factor: float) -> MeshEdges:
        """The edges in an image that is smaller by a factor."""
        return MeshEdges(self.pixel / factor, self.normal, self.depth)


def mesh_edges(
    points: np.ndarray, normals: np.ndarray, valid: np.ndarray, rng: np.random.Generator
) -> MeshEdges:
    """The edges of a mesh as a view sees it.

    Args:
        points: (H, W, 3) seen through each pixel's centre, in the camera's axes (X right, Y down, Z forward).
        normals: (H, W, 3) unit, towards the camera.
        valid: (H, W) bool, whether the mesh is seen.
        rng: chooses among many edges.
    """
    found = [_between(points, normals, valid, axis) for axis in (0, 1)]
    pixel, depth = (np.concatenate([part[item] for part in found]) for item in (0, 1))
    if len(pixel) <= _NEIGHBOURS:
        return MeshEdges(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    chosen = rng.permutation(len(pixel))[: 2 * _MOST_EDGES]
    around = pixel[cKDTree(pixel).query(pixel[chosen], _NEIGHBOURS)[1]]
    middle = around.mean(axis=1)
    apart = around - middle[:, None]
    values, vectors = np.linalg.eigh(np.einsum("kni,knj->kij", apart, apart))
    thin = np.sqrt(np.maximum(values[:, 0], 0.0) / np.maximum(values[:, 1], 1e-12)) < _THIN
    normal = vectors[:, :, 0]
    # The staircase of pixels is smoothed: each point goes to the line through its neighbours.
    offset = ((middle - pixel[chosen]) * normal).sum(axis=1)
    smooth = pixel[chosen] + offset[:, None] * normal
    keep = np.nonzero(thin)[0][:_MOST_EDGES]
    return MeshEdges(smooth[keep], normal[keep], depth[chosen][keep])


def _between(
    points: np.ndarray, normals: np.ndarray, valid: np.ndarray, axis: int
) -> tuple[np.ndarray, np.ndarray]:
    """Edges between neighbours along an axis: positions (E, 2) between the pixels and depths (E,)."""
    first, second = (slice(None, -1), slice(1, None))
    a, b = (
        ((first, slice(None)), (second, slice(None)))
        if axis == 0
        else ((slice(None), first), (slice(None), second))
    )
    both = valid[a] & valid[b]
    step = points[b] - points[a]
    depth = np.minimum(
        np.where(valid[a], points[a][..., 2], np.inf), np.where(valid[b], points[b][..., 2], np.inf)
    )
    off = np.minimum(np.abs(_dot(step, normals[a])), np.abs(_dot(step, normals[b])))
    jump = both & (off > _JUMP * np.where(both, depth, 1.0))
    crease = both & (_dot(normals[a], normals[b]) < _CREASE)
    row, column = np.nonzero(jump | crease | (valid[a] != valid[b]))
    x = column + (1.0 if axis == 1 else 0.5)
    y = row + (1.0 if axis == 0 else 0.5)
    return np.stack([x, y], axis=1), depth[row, column]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...) dot products of vectors (..., 3); five times as fast as a sum over the short axis."""
    return np.einsum("...c,...c->...", a, b)


def edge_misfit(image: np.ndarray, edges: MeshEdges, intrinsics: np.ndarray) -> float | None:
    """Root mean square distance in pixels of the mesh's edges from the photograph's; None without a verdict.

    Args:
        image: (H, W) log radiance.
        edges: of the mesh in the view.
        intrinsics: (3, 3) in pixels of the image.
    """
    profiles = edge_profiles(image, edges)
    with_gradient = profiles.max(axis=1) > 0.5
    chosen = MeshEdges(edges.pixel[with_gradient], edges.normal[with_gradient], edges.depth[with_gradient])
    profiles = profiles[with_gradient]
    shared = _shared(chosen.pixel)
    if (1.0 / shared).sum() < LEAST_EDGES:
        return None
    flow = edge_flow(chosen, intrinsics)
    across = np.einsum("kc,kcj->kj", chosen.normal, flow)
    sizes = np.sqrt((flow**2).sum(axis=1).mean(axis=0))
    start = _best_shift(profiles, chosen, flow)
    motion, information = _narrowed(profiles, across, sizes, shared, start)
    squares = np.einsum("kci,kcj->ij", flow, flow) / len(flow)
    spread = float(np.trace(squares @ np.linalg.inv(information)))
    if spread > _UNSURE**2:
        return None
    square = float(motion @ squares @ motion) - spread  # less what chance adds to it
    return float(np.sqrt(max(square, 0.0)))


def edge_profiles(image: np.ndarray, edges: MeshEdges) -> np.ndarray:
    """(K, P) strength of the photograph's gradient across each edge, 0 to 1, at `offsets()`."""
    smooth = gaussian_filter(np.asarray(image, np.float64), _BLUR, mode="nearest")
    rows, columns = np.gradient(smooth)
    noise = max(float(np.percentile(np.hypot(rows, columns), 70.0)), _LEAST_CONTRAST)
    height, width = image.shape
    places = edges.pixel[:, None] + offsets()[:, None] * edges.normal[:, None] - 0.5
    inside = (places >= 0.0).all(axis=-1) & (places[..., 0] <= width - 1) & (places[..., 1] <= height - 1)
    where = places[..., ::-1].reshape(-1, 2).T
    gradient_x, gradient_y = (
        map_coordinates(part, where, order=1, mode="nearest") for part in (columns, rows)
    )
    shape = inside.shape
    slope = (
        gradient_x.reshape(shape) * edges.normal[:, None, 0]
        + gradient_y.reshape(shape) * edges.normal[:, None, 1]
    )
    strength = slope**2 / (slope**2 + noise**2)
    return np.asarray(np.where(inside, strength, 0.0))


def _shared(pixel: np.ndarray) -> np.ndarray:
    """(K,) number of edge points near each, itself included; they see the same gradient."""
    if not len(pixel):
        return np.ones(0)
    return np.asarray(cKDTree(pixel).query_ball_point(pixel, _SHARED, return_length=True), np.float64)


def offsets() -> np.ndarray:
    """Positions across an edge in pixels at which profiles are sampled."""
    return np.arange(-REACH, REACH + 0.5 * _STEP, _STEP)


def edge_flow(edges: MeshEdges, intrinsics: np.ndarray) -> np.ndarray:
    """(K, 2, 6) displacement of each edge point by turning and shifting the points in the camera's axes."""
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    x, y = ((edges.pixel - intrinsics[:2, 2]) / (fx, fy)).T
    zero, inverse = np.zeros_like(x), 1.0 / edges.depth
    flow_x = [-x * y, 1.0 + x**2, -y, inverse, zero, -x * inverse]
    flow_y = [-(1.0 + y**2), x * y, x, zero, inverse, -y * inverse]
    return np.stack([fx * np.stack(flow_x, axis=1), fy * np.stack(flow_y, axis=1)], axis=1)


def _best_shift(profiles: np.ndarray, edges: MeshEdges, flow: np.ndarray) -> np.ndarray:
    """(6,) turn of the camera that shifts the picture as a whole onto the strongest gradients."""
    steps = np.arange(-REACH + 2, REACH - 1)
    shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    some = slice(None, None, max(len(profiles) // 1500, 1))
    index = np.rint((edges.normal[some] @ shifts.T + REACH) / _STEP).astype(np.int64)
    usable = (index >= 0) & (index < profiles.shape[1])
    blurred = gaussian_filter(profiles[some], (0.0, 1.0 / _STEP), mode="constant")
    rows = np.arange(len(blurred))[:, None]
    score = np.where(usable, blurred[rows, np.clip(index, 0, profiles.shape[1] - 1)], 0.0).sum(axis=0)
    shift = shifts[int(score.argmax())]
    matrix = flow[:, :, :2].reshape(-1, 2)
    turn = np.linalg.lstsq(matrix, np.tile(shift, len(flow)), rcond=None)[0]
    return np.concatenate([turn, np.zeros(4)])


def _narrowed(
    profiles: np.ndarray, across: np.ndarray, sizes: np.ndarray, shared: np.ndarray, motion: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares on where the gradients lie, searched nearer and nearer to the motion found so far.

    Args:
        profiles: (K, P) strengths.
        across: (K, 6) displacement across each edge by the motions.
        sizes: (6,) root mean square displacement by each motion.
        shared: (K,) number of points that share each one's gradient.
        motion: (6,) to start from.

    Returns:
        The motion (6,), and the inverse of its covariance (6, 6).
    """
    places = offsets()
    prior = np.diag((sizes / _PRIOR) ** 2)
    normal = prior
    for width in _WIDTHS:
        near = profiles * np.exp(-0.5 * ((places - (across @ motion)[:, None]) / width) ** 2)
        total = near.sum(axis=1)
        found = (near @ places) / np.maximum(total, 1e-12)
        # An edge with a strong gradient within reach counts once, however wide that gradient is.
        weight = np.minimum(total * _STEP / width, 1.0)
        off = found - across @ motion
        spread = float(np.sqrt(np.average(off**2, weights=weight + 1e-12))) + 0.05
        weight = weight / (1.0 + (off / (2.0 * spread)) ** 2)
        weight /= spread**2 * shared
        normal = across.T @ (across * weight[:, None]) + prior
        motion = np.linalg.solve(normal, across.T @ (weight * found))
    return motion, normal
