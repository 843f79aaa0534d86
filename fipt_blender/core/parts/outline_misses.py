"""Distances between the outlines of parts on a scan and the borders of the masks, view by view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from ..capture.views import View
from ..pixels.camera_rays import first_hits, rays_along
from ..run.threads import in_threads
from ..surface.room import Room

# Outlines of mesh and mask that are farther apart, in pixels, are not matched.
REACH = 2.0
# Margin beyond that reach, in pixels, in which vertices are searched.
_MARGIN = 2.0
# Least gradient of the distance from a border, in pixels per pixel; it is lower in the middle of thin parts.
_LEAST_SLOPE = 0.5
# A surface that is less than this in front of a vertex, in edges of the mesh or pixels, does not occlude it.
_BEFORE_EDGES, _BEFORE_PIXELS = 2.0, 1.0


@dataclass(frozen=True)
class Misses:
    """Distances between outlines and those of the masks, for N pairs of a vertex and a view.

    Attributes:
        vertex: (N,) int64.
        gradient: (N, 3) pixels per metre by which a move of the vertex changes the miss.
        pixels: (N,) signed miss; positive inside the mask's part.
    """

    vertex: np.ndarray
    gradient: np.ndarray
    pixels: np.ndarray


@dataclass(frozen=True)
class _Candidates:
    """N vertices near the border of their part in a view; whether the mesh has an outline there is not known.

    Attributes:
        view: in which they are.
        vertex, part: (N,) int64.
        place: (N, 2) pixel.
        step: (N, 2) pixels towards the inside of the part; the mesh is traced at plus and minus this step.
        gradient, pixels: as of :class:`Misses`.
    """

    view: View
    vertex: np.ndarray
    part: np.ndarray
    place: np.ndarray
    step: np.ndarray
    gradient: np.ndarray
    pixels: np.ndarray


def find_misses(
    room: Room, label: np.ndarray, masks: Sequence[tuple[View, np.ndarray]], edge: float
) -> Misses:
    """The misses of all views.

    A vertex is on the outline of its part if the mesh shows the part on the one side of it and something else
    on the other, across the nearest border of the part's mask.

    Args:
        room: its coincident vertices count as one.
        label: (T,) id of each triangle, 0 without one.
        masks: views with their (H, W) ids.
        edge: of the mesh, metres.
    """
    places, triangles = room.vertices.astype(np.float64), room.triangles.astype(np.int64)
    near = in_threads(partial(_near_outlines, places, triangles, label, edge), masks)
    return _joined([_on_outlines(room, places, label, edge, each) for each in near])


def _near_outlines(
    places: np.ndarray,
    triangles: np.ndarray,
    label: np.ndarray,
    edge: float,
    masked: tuple[View, np.ndarray],
) -> _Candidates:
    """The candidates of a view and its mask; `places` (V, 3) of vertices, the rest: :func:`find_misses`."""
    view, mask = masked
    pose = np.asarray(view.camera_to_world, np.float64)
    local = (places - pose[:3, 3]) @ pose[:3, :3]
    depth = np.where(local[:, 2] > 0.0, local[:, 2], np.inf)
    focal = np.array([view.fx, view.fy])
    place = local[:, :2] / depth[:, None] * focal + (view.cx, view.cy)
    inside = (local[:, 2] > 0.0) & ((place > 1.0) & (place < (view.width - 1.0, view.height - 1.0))).all(
        axis=1
    )
    column, row = np.where(inside[:, None], place, 0.0).astype(np.int64).T
    inside &= _near_borders(mask)[row, column]
    vertex, part = _labels_of(triangles, label, inside)
    off, inward = np.zeros(len(vertex)), np.zeros((len(vertex), 2))
    near = np.zeros(len(vertex), bool)
    for number in np.intersect1d(part, mask):
        own = part == number
        distance, slope = _sampled(_signed_distance(mask == number), place[vertex[own]])
        length = np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
        near[own] = (np.abs(distance) < REACH) & (length > _LEAST_SLOPE)
        off[own], inward[own] = distance / length, slope / length[:, None]
    vertex, part, off, inward = vertex[near], part[near], off[near], inward[near]
    step = np.maximum(1.0, edge * min(view.fx, view.fy) / depth[vertex])[:, None] * inward
    # Derivative of the pixel by the place in the camera's axes.
    scaled = inward * focal / depth[vertex, None]
    along = -(scaled * local[vertex, :2]).sum(axis=1) / depth[vertex]
    gradient = np.concatenate([scaled, along[:, None]], axis=1) @ pose[:3, :3].T
    return _Candidates(view, vertex, part, place[vertex], step, gradient, off)


def _on_outlines(room: Room, places: np.ndarray, label: np.ndarray, edge: float, near: _Candidates) -> Misses:
    """The candidates that are on the outline of their part; arguments as of :func:`_near_outlines`."""
    here, beyond = (_shown(room, label, near.view, near.place + shift) for shift in (near.step, -near.step))
    kept = (here == near.part) & (beyond != near.part)
    kept &= _visible(room, near.view, places[near.vertex], edge)
    return Misses(near.vertex[kept], near.gradient[kept], near.pixels[kept])


def _joined(found: Sequence[Misses]) -> Misses:
    columns = ([getattr(each, name) for each in found] for name in ("vertex", "gradient", "pixels"))
    return Misses(*(np.concatenate(column) for column in columns))


def _near_borders(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool, pixels within reach of a border of the mask."""
    border = np.zeros(mask.shape, bool)
    border[:, 1:] |= mask[:, 1:] != mask[:, :-1]
    border[1:] |= mask[1:] != mask[:-1]
    return np.asarray(distance_transform_edt(~border) < REACH + _MARGIN) if border.any() else border


def _labels_of(triangles: np.ndarray, label: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The chosen vertices (V,) bool with each id of the triangles around them: (N,) vertices, (N,) ids."""
    used = (chosen[triangles] & (label > 0)[:, None]).reshape(-1)
    ids = int(label.max(initial=0)) + 1
    vertex, part = np.divmod(np.unique(triangles.reshape(-1)[used] * ids + np.repeat(label, 3)[used]), ids)
    return vertex, part


def _signed_distance(inside: np.ndarray) -> np.ndarray:
    """(H, W) pixels between each pixel's centre and the border, which lies half way; positive inside."""
    return np.asarray(
        np.where(inside, distance_transform_edt(inside) - 0.5, 0.5 - distance_transform_edt(~inside))
    )


def _sampled(field: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value (N,) and slope (N, 2) per pixel in x and y of a field at places (N, 2)."""
    at = place[:, ::-1].T - 0.5
    down, across = np.gradient(field)
    value, x, y = (map_coordinates(each, at, order=1, mode="nearest") for each in (field, across, down))
    return value, np.stack([x, y], axis=1)


def _shown(room: Room, label: np.ndarray, view: View, place: np.ndarray) -> np.ndarray:
    """(N,) id of the triangle that the mesh shows at places (N, 2) in a view, 0 for none."""
    x, y = ((place - (view.cx, view.cy)) / (view.fx, view.fy)).T
    direction = np.stack([x, y, np.ones_like(x)], axis=1) @ np.asarray(view.camera_to_world)[:3, :3].T
    triangle = _first_hit(room, view, direction)[0]
    return np.where(triangle >= 0, label[triangle], 0)


def _visible(room: Room, view: View, places: np.ndarray, edge: float) -> np.ndarray:
    """(N,) bool, whether places (N, 3) are not occluded by the mesh; surfaces close to them do not count."""
    direction = places - np.asarray(view.camera_to_world)[:3, 3]
    distance = np.linalg.norm(direction, axis=1)
    reached = _first_hit(room, view, direction)[1]
    return np.asarray(
        reached
        > distance - np.maximum(_BEFORE_EDGES * edge, _BEFORE_PIXELS * distance / min(view.fx, view.fy))
    )


def _first_hit(room: Room, view: View, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) triangle, -1 for none, and (N,) distance in metres along directions (N, 3) from the camera."""
    unit = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    if not len(unit):
        return np.zeros(0, np.int64), np.zeros(0)
    return first_hits(room.intersect(rays_along(np.asarray(view.camera_to_world)[:3, 3], unit)))
