# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What furniture has hidden: the planes beside it, and what is known of their estimated maps.

A plane is looked at through a window, a grid of cells. A cell is known where photographs saw the surface,
and hidden where there is a surface that none saw, or a hole of the mesh that the plane closes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..image_datablocks import linear_values, tile_values
from ..marks import FILLED, MAP
from ..node_trees import node_tree
from ..room.mesh_arrays import (
    corner_uvs,
    corner_vertices,
    is_mirrored,
    polygon_slots,
    transform_points,
    triangle_loops,
    vertex_positions,
)
from ..room.originals import result_mesh
from ..room.uv_layer import UV_LAYER
from .completion import grown
from .materials import slot_estimates

LABELS = ("Base Color", "Roughness", "Metallic", "Confidence")
MOST_CELLS = 320  # on a window's longer side; the completion takes some 10 s for such a window
FINEST, COARSEST = 0.003, 0.03  # metres, limits of a cell's side
_REACH = (0.3, 0.8)  # metres around what is removed where planes are looked for: half its size within these
_MARGIN = 2.0  # of a window around what is removed, in units of that: some repetitions of a pattern
_RAYS = 6000  # from the space that is emptied, in search of planes
_PARALLEL = 0.97  # cosine (14 degrees) of the normals of one plane's hits, which a scan's noise turns
_THICKNESS = 0.015  # metres from a plane within which surfaces belong to it; twice the noise of a scan
_LEAST_SHARE = 0.03  # of the rays' hits on a plane that is looked at
_MOST_PLANES = 8
_WORN = 2  # cells beside what was hidden whose estimate has errors: mixed pixels, light from the furniture


class Room:
    """The surfaces that stay, for rays, and their maps.

    Args:
        items: objects with estimated materials, in Object Mode.
    """

    def __init__(self, items: Sequence[bpy.types.Object]) -> None:
        corners, uvs, slots, filled = [], [], [], []
        self.materials: list[bpy.types.Material | None] = []
        self._colors: dict[str, list[np.ndarray]] = {label: [] for label in LABELS}
        for item in items:
            mesh = result_mesh(item) or item.data
            loops, polygons = triangle_loops(mesh, is_mirrored(item))
            matrix = np.array(item.matrix_world, np.float64)
            points = transform_points(vertex_positions(mesh), matrix)
            corners.append(points[corner_vertices(mesh)[loops]])
            layer = mesh.uv_layers.get(UV_LAYER)
            uv = np.zeros((len(mesh.loops), 2)) if layer is None else corner_uvs(mesh, layer)
            uvs.append(uv[loops])
            slot = np.minimum(polygon_slots(mesh)[polygons], max(len(mesh.materials) - 1, 0))
            slots.append(slot + len(self.materials))
            self.materials += slot_estimates(mesh) or [None]
            filled.append(np.full(len(loops), FILLED in item))
            for label, listed in self._colors.items():
                values = np.ones((len(mesh.loops), 4), np.float32)
                if MAP.format(label) in mesh.attributes:
                    mesh.attributes[MAP.format(label)].data.foreach_get("color", values.ravel())
                listed.append(values[loops])
        self.corners, self._uvs = np.concatenate(corners), np.concatenate(uvs)
        self.slot, self.filled = np.concatenate(slots), np.concatenate(filled)
        count = len(self.corners)
        self._tree = BVHTree.FromPolygons(
            self.corners.reshape(-1, 3).tolist(),
            np.arange(3 * count).reshape(-1, 3).tolist(),
            all_triangles=True,
        )
        self._images: dict[tuple[str, int], np.ndarray] = {}

    def cast(
        self, origins: np.ndarray, directions: np.ndarray, distance: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first hits of rays (N, 3): triangle (-1 for none), point and unit normal of the face (N, 3)."""
        triangle = np.full(len(origins), -1)
        points, normals = np.zeros((len(origins), 3)), np.zeros((len(origins), 3))
        for row, (origin, direction) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
            point, normal, index, _ = self._tree.ray_cast(origin, direction, distance)
            if index is not None:
                triangle[row], points[row], normals[row] = index, point, normal
        return triangle, points, normals

    def cell_size(self, triangles: np.ndarray) -> float:
        """Side of a texel on these triangles, metres, median; without images that of a coarse cell."""
        sizes = []
        for triangle in np.unique(triangles)[:200]:
            image = self._image_node(self.slot[triangle], "Base Color")
            if image is None:
                continue
            first, second, third = self._uvs[triangle] * np.array(image.size)
            area = np.linalg.norm(np.cross(*np.diff(self.corners[triangle], axis=0)))
            texels = abs(float(np.cross(second - first, third - first)))
            if texels > 0.0 and area > 0.0:
                sizes.append(float(np.sqrt(area / texels)))
        return float(np.median(sizes)) if sizes else COARSEST

    def maps(self, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(N, 6) f32 base colour (scene-linear), roughness, metallic and confidence of the base colour.

        Args:
            triangles: (N,) on which the points lie; those without an estimate get 0.
            points: (N, 3).
        """
        values = np.zeros((len(triangles), 6), np.float32)
        weights = _barycentric(points, self.corners[triangles])
        for slot in np.unique(self.slot[triangles]).tolist():
            rows = np.flatnonzero(self.slot[triangles] == slot)
            if self.materials[slot] is None:
                continue
            for label, column in zip(LABELS, (slice(0, 3), 3, 4, 5), strict=True):
                found = self._values(slot, label, triangles[rows], weights[rows])
                values[rows, column] = found[:, :3] if label == "Base Color" else found[:, 0]
        return values

    def _image_node(self, slot: int, label: str) -> bpy.types.Image | None:
        material = self.materials[slot]
        node = None if material is None else node_tree(material).nodes.get(MAP.format(label))
        return getattr(node, "image", None)

    def _values(self, slot: int, label: str, triangles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """(N, 3 or 4) values of a map."""
        node = node_tree(self.materials[slot]).nodes[MAP.format(label)]
        image = self._image_node(slot, label)
        if image is None:
            if node.bl_idname == "ShaderNodeRGB":
                return np.tile(np.array(node.outputs["Color"].default_value[:]), (len(triangles), 1))
            colors = np.concatenate(self._colors[label])
            return np.einsum("nk,nkc->nc", weights, colors[triangles])
        uv = np.einsum("nk,nkc->nc", weights, self._uvs[triangles])
        tile = np.floor(uv).astype(int)
        if image.source != "TILED":
            tile[:] = 0
        values = np.zeros((len(uv), 4), np.float32)
        for column, row in np.unique(tile, axis=0).tolist():
            rows = np.flatnonzero((tile == [column, row]).all(axis=1))
            pixels = self._pixels(image, label, 1001 + column + 10 * row)
            size = np.array([pixels.shape[1], pixels.shape[0]])
            x, y = np.clip(((uv[rows] - tile[rows]) * size).astype(int), 0, size - 1).T
            values[rows] = (
                np.resize(pixels[y, x], (len(rows), 4)) if pixels.shape[2] == 4 else _grey(pixels[y, x])
            )
        return values

    def _pixels(self, image: bpy.types.Image, label: str, number: int) -> np.ndarray:
        key = image.name, number
        if key not in self._images:
            whole = image.source != "TILED" and label == "Base Color"
            self._images[key] = linear_values(image) if whole else tile_values(image, number)
        return self._images[key]


def _grey(values: np.ndarray) -> np.ndarray:
    """Values (N, 1 to 3) with four channels."""
    return np.concatenate([values, np.repeat(values[:, -1:], 4 - values.shape[1], axis=1)], axis=1)


def _barycentric(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N, 3) weights of the corners of triangles (N, 3, 3) at points (N, 3) on them."""
    edges = triangles - np.roll(triangles, -1, axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    opposite = [
        np.einsum(
            "ni,ni->n",
            np.cross(triangles[:, (k + 1) % 3] - points, triangles[:, (k + 2) % 3] - points),
            normal,
        )
        for k in range(3)
    ]
    weights = np.maximum(np.stack(opposite, axis=1), 0.0)
    return weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)


@dataclass(frozen=True)
class Plane:
    """A plane of the room.

    Attributes:
        normal: (3,) unit, towards the room.
        offset: of its points along the normal, metres.
    """

    normal: np.ndarray
    offset: float

    def height(self, points: np.ndarray) -> np.ndarray:
        """Distances (N,) of points (N, 3) in front of it, metres."""
        return points @ self.normal - self.offset

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Two unit vectors (3,) on it, whose cross product is the normal; the first one is level."""
        level = np.cross([0.0, 0.0, 1.0], self.normal)
        first = level / np.linalg.norm(level) if np.linalg.norm(level) > 0.1 else np.array([1.0, 0.0, 0.0])
        first = first - self.normal * (first @ self.normal)
        first /= np.linalg.norm(first)
        return first, np.cross(self.normal, first)


def reach_around(points: np.ndarray) -> float:
    """How far around removed points (N, 3) their room is looked at, metres: half their size."""
    return float(np.clip(0.5 * np.ptp(points, axis=0).max(), *_REACH))


def planes_beside(room: Room, points: np.ndarray) -> list[Plane]:
    """The planes beside removed points (N, 3), those first that are seen most from their place."""
    random = np.random.default_rng(0)
    reach = reach_around(points)
    origins = random.uniform(points.min(axis=0), points.max(axis=0), (_RAYS, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    free = random.normal(size=(_RAYS, 3))
    directions = np.where(
        (np.arange(_RAYS) % 2 == 0)[:, None],
        axes[random.integers(6, size=_RAYS)],
        free / np.linalg.norm(free, axis=1, keepdims=True),
    )
    triangle, hits, normals = room.cast(origins, directions, 3.0 * reach)
    normals = -normals * np.sign(np.einsum("ni,ni->n", normals, directions))[:, None]
    outside = np.maximum(np.maximum(points.min(axis=0) - hits, hits - points.max(axis=0)), 0.0).max(axis=1)
    chosen = (triangle >= 0) & (outside < reach)
    hits, normals = hits[chosen], normals[chosen]
    least = max(_LEAST_SHARE * len(hits), 20.0)
    planes: list[Plane] = []
    while len(hits) > least and len(planes) < _MOST_PLANES:
        seeds = random.integers(len(hits), size=48)
        votes = [_on_plane(hits, normals, normals[seed], hits[seed]) for seed in seeds]
        best = votes[int(np.argmax([vote.sum() for vote in votes]))]
        if best.sum() < least:
            break
        normal = np.median(normals[best], axis=0)
        plane = Plane(normal / np.linalg.norm(normal), float(np.median(hits[best] @ normal)))
        normal = plane.normal
        # Rays that start behind a wall, in which the furniture is a little, see its back.
        if not any(
            each.normal @ normal < -_PARALLEL and abs(each.offset + plane.offset) < 2 * _THICKNESS
            for each in planes
        ):
            planes.append(plane)
        left = ~_on_plane(hits, normals, normal, hits[best].mean(axis=0))
        hits, normals = hits[left & ~best], normals[left & ~best]
    return planes


def _on_plane(hits: np.ndarray, normals: np.ndarray, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
    return (normals @ normal > _PARALLEL) & (np.abs((hits - point) @ normal) < _THICKNESS)


@dataclass(frozen=True)
class Window:
    """A plane's cells around what was removed.

    Attributes:
        plane: of the cells.
        origin: (3,) the window's lowest corner in the world, metres.
        size: side of a cell, metres.
        values: (H, W, 5) f32 base colour, roughness and metallic.
        known: (H, W) bool: seen by photographs.
        hidden: (H, W) bool: to be completed.
        slot: (H, W) int64 place in `Room.materials`, -1 without a surface.
        height: (H, W) of the surface in front of the plane, metres; 0 without one.
    """

    plane: Plane
    origin: np.ndarray
    size: float
    values: np.ndarray
    known: np.ndarray
    hidden: np.ndarray
    slot: np.ndarray
    height: np.ndarray


def window_of(room: Room, plane: Plane, others: Sequence[Plane], points: np.ndarray) -> Window | None:
    """The window of a plane behind removed points (N, 3); None where they have hidden nothing of it."""
    first, second = plane.axes()
    height = plane.height(points)
    reach = reach_around(points)
    near = points[(height > -_THICKNESS) & (height < height.min() + 2.0 * reach)]
    if height.min() > reach or not len(near):
        return None
    low, high = (np.array([limit(near @ first), limit(near @ second)]) for limit in (np.min, np.max))
    margin = _MARGIN * reach
    sides = high - low + 2.0 * margin
    triangle = _under(room, plane, _grid(plane, low - margin, sides / 16.0, (16, 16)).reshape(-1, 3))[0]
    size = room.cell_size(triangle[triangle >= 0])
    size = max(float(np.clip(size, FINEST, COARSEST)), float(sides.max()) / MOST_CELLS)
    rows, columns = np.ceil(sides[::-1] / size).astype(int).tolist()
    shape = (rows, columns)
    centers = _grid(plane, low - margin, np.array([size, size]), shape)
    triangle, hits = _under(room, plane, centers.reshape(-1, 3))
    there = triangle >= 0
    slot, values = np.full(len(triangle), -1), np.zeros((len(triangle), 6), np.float32)
    slot[there] = room.slot[triangle[there]]
    values[there] = room.maps(triangle[there], hits[there])
    known = there & ((values[:, 5] > 0.0) | room.filled[triangle])
    closing = ~there & _closes(room, plane, others, centers.reshape(-1, 3), there)
    known, unseen = known.reshape(shape), (there & ~known | closing).reshape(shape)
    place = np.indices(shape)
    behind = np.ones(shape, bool)
    for axis, index in ((0, 1), (1, 0)):
        position = (place[axis] + 0.5) * size - margin
        behind &= (position >= -2 * size) & (position <= high[index] - low[index] + 2 * size)
    hidden = _connected(unseen, unseen & behind)
    if hidden.sum() < 9:
        return None
    worn = grown(hidden, _WORN) & known
    hidden, known = hidden | worn, known & ~worn
    origin = plane.normal * plane.offset + first * (low[0] - margin) + second * (low[1] - margin)
    above = np.where(there, plane.height(hits), 0.0).reshape(shape)
    grid = values[:, :5].reshape(*shape, 5)
    return Window(plane, origin, size, grid, known, hidden, slot.reshape(shape), above)


def _grid(plane: Plane, low: np.ndarray, step: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(H, W, 3) centres of cells on a plane."""
    first, second = plane.axes()
    rows = low[1] + step[1] * (np.arange(shape[0]) + 0.5)
    columns = low[0] + step[0] * (np.arange(shape[1]) + 0.5)
    flat = columns[None, :, None] * first + rows[:, None, None] * second
    return np.asarray(plane.normal * plane.offset + flat)


def _under(room: Room, plane: Plane, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangle (N,) of the surface on a plane at points (N, 3), -1 for none, and its points (N, 3)."""
    towards = np.broadcast_to(-plane.normal, points.shape)
    triangle, hits, normals = room.cast(points + _THICKNESS * plane.normal, towards, 2.0 * _THICKNESS)
    return np.where(normals @ plane.normal > 0.5, triangle, -1), hits


def _closes(
    room: Room, plane: Plane, others: Sequence[Plane], points: np.ndarray, there: np.ndarray
) -> np.ndarray:
    """Points (N, 3) of holes that the plane closes: outside of it is nothing of the room."""
    result = ~there
    for other in others:
        if other is not plane and abs(float(other.normal @ plane.normal)) < 0.9:
            result &= other.height(points) > -_THICKNESS
    chosen = np.flatnonzero(result)
    towards = np.broadcast_to(-plane.normal, (len(chosen), 3))
    triangle, _, normals = room.cast(points[chosen] + _THICKNESS * plane.normal, towards, 100.0)
    result[chosen] = (triangle < 0) | (normals @ plane.normal < 0.0)
    return result


def _connected(mask: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """The cells of a mask (H, W) that are connected with seeds."""
    found = seeds
    while True:
        more = grown(found) & mask
        if (more == found).all():
            return found
        found = more
