"""By how many pixels the mesh is displaced in a view: its edges are compared with those of the photograph.

Edges of the mesh are jumps of depth and of the normal. Across each of them the photograph's gradient is
searched; the small motion of the camera that most edges agree with is found by shifts first, then by least
squares with a search that narrows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from ..capture.views import View
from ..pixels.store import trace_view
from ..surface.room import Room
from .registration import turn_flow

TRACED = 960  # least number of pixels that are traced along the longer side; at most twice as many are
COMPARED = 1280  # most pixels along the longer side of the photograph that is compared
_SEED = 0  # of the edges that are drawn

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


def edge_image(view: View, pixels: np.ndarray) -> np.ndarray | None:
    """(h, w) logarithm of a photograph (H, W, 3), reduced by an integer factor; None where it is black."""
    factor = _factor(view)
    height, width = view.height // factor, view.width // factor
    # Rows first: numpy is slow along short axes, as those of the channels and of the columns of a block are.
    rows = pixels[: height * factor].reshape(height, factor, -1).mean(axis=1, dtype=np.float64)
    blocks = rows.reshape(height, -1, 3)[:, : width * factor].reshape(height, width, -1)
    gray = np.maximum(blocks.mean(axis=2), 0.0)
    lit = gray[gray > 0.0]
    if not lit.size:
        return None
    return np.log(gray + 1e-2 * float(np.median(lit)))


def image_misfit(room: Room, view: View, image: np.ndarray | None) -> tuple[float, int] | None:
    """Compare the mesh's edges with those of a photograph; None without a verdict.

    Args:
        room: the mesh.
        view: the camera.
        image: of its photograph, by `edge_image`.

    Returns:
        The displacement in pixels of the photograph reduced by an integer factor, and this factor.
    """
    if image is None:
        return None
    factor = _factor(view)
    intrinsics = np.diag([1.0 / factor, 1.0 / factor, 1.0]) @ view.intrinsics
    misfit = edge_misfit(image, view_edges(room, view).over(factor), intrinsics)
    return None if misfit is None else (misfit, factor)


def _factor(view: View) -> int:
    """The integer factor by which a view's photograph is reduced."""
    return -(-max(view.width, view.height) // COMPARED)


def view_edges(room: Room, view: View) -> MeshEdges:
    """The mesh's edges in a view, in pixels of its photograph."""
    scale: float = max(round(TRACED / max(view.width, view.height)), 1)
    if max(view.width, view.height) > 2 * TRACED:
        scale = TRACED / max(view.width, view.height)
    width, height = round(view.width * scale), round(view.height * scale)
    seen = trace_view(room, view.resized(width, height))
    pose, valid = np.asarray(view.camera_to_world, np.float64), seen.triangle >= 0
    vectors = (np.where(valid[:, None], each, 0.0) for each in (seen.position - pose[:3, 3], seen.normal))
    points, normals = ((each @ pose[:3, :3]).reshape(height, width, 3) for each in vectors)
    edges = mesh_edges(points, normals, valid.reshape(height, width), np.random.default_rng(_SEED))
    return edges.over(width / view.width)


@dataclass(frozen=True, eq=False)
class MeshEdges:
    """Points on the edges of a mesh in a view."""

    pixel: np.ndarray  # (K, 2) x, y; the centre of the first pixel is (0.5, 0.5)
    normal: np.ndarray  # (K, 2) unit vectors across the edge
    depth: np.ndarray  # (K,) along the camera's Z, of the nearer side

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
    below = _between(points, normals, valid)
    beside = _between(*(np.swapaxes(each, 0, 1) for each in (points, normals, valid)))
    pixel, depth = np.concatenate([below[0], beside[0][:, ::-1]]), np.concatenate([below[1], beside[1]])
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


def _between(points: np.ndarray, normals: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges between neighbours along the first axis: x, y (E, 2) between the pixels, and depths (E,)."""
    a, b = slice(None, -1), slice(1, None)
    both = valid[a] & valid[b]
    step = points[b] - points[a]
    depth = np.minimum(*(np.where(valid[each], points[each][..., 2], np.inf) for each in (a, b)))
    off = np.minimum(np.abs(_dot(step, normals[a])), np.abs(_dot(step, normals[b])))
    jump = both & (off > _JUMP * np.where(both, depth, 1.0))
    crease = both & (_dot(normals[a], normals[b]) < _CREASE)
    row, column = np.nonzero(jump | crease | (valid[a] != valid[b]))
    return np.stack([column + 0.5, row + 1.0], axis=1), depth[row, column]


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
    noise = max(float(np.percentile(np.hypot(*np.gradient(smooth)), 70.0)), _LEAST_CONTRAST)
    height, width = image.shape
    places = edges.pixel[:, None] + offsets()[:, None] * edges.normal[:, None] - 0.5
    inside = (places >= 0.0).all(axis=-1) & (places[..., 0] <= width - 1) & (places[..., 1] <= height - 1)
    profile = map_coordinates(smooth, np.moveaxis(places[..., ::-1], 2, 0), order=1, mode="nearest")
    slope = np.gradient(profile, _STEP, axis=1)
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
    shift = np.repeat(intrinsics[None, :2], len(edges.depth), axis=0)
    shift[:, :, 2] -= edges.pixel
    return np.concatenate([turn_flow(edges.pixel, intrinsics), shift / edges.depth[:, None, None]], axis=2)


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
