"""What furniture has hidden: the planes beside it, and what is known of their estimated maps.

A plane is looked at through a window, a grid of cells. A cell is known where photographs saw the surface,
and hidden where there is a surface that none saw, or a hole of the mesh that the plane closes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..image_datablocks import image_values, linear_values
from ..marks import FILLED, MAP
from ..node_trees import node_tree
from ..room.mesh_arrays import (
    barycentric,
    corner_uvs,
    corner_vertices,
    is_mirrored,
    polygon_slots,
    triangle_loops,
    world_positions,
)
from ..room.rays import corner_tree
from ..room.uv_layer import UV_LAYER
from .completion import grown
from .materials import slot_estimates

_COLUMNS = {"Base Color": slice(0, 3), "Roughness": 3, "Metallic": 4, "Confidence": 5}  # of maps' values
FINEST, MOST_CELLS = 0.004, 280  # metres of a cell's side, at least; cells of a window's longer side, at most
_REACH = (0.3, 0.8)  # metres around what is removed where planes are looked for: half its size within these
_MARGIN = 2.0  # of a window around what is removed, in units of that: some repetitions of a pattern
_RAYS = 6000  # from the space that is emptied, in search of planes
_PARALLEL = 0.97  # cosine (14 degrees) of the normals of one plane's hits, which a scan's noise turns
_THICKNESS = 0.015  # metres from a plane within which surfaces belong to it; twice the noise of a scan
_LEAST_SHARE = 0.03  # of the rays' hits on a plane that is looked at
_MOST_PLANES = 8
# Cells beside what was hidden whose estimate has errors: mixed pixels, light from the furniture. With 2,
# their blotches go on behind it, which costs 2 dB in two of six places.
_WORN = 8


class Room:
    """The surfaces that stay, for rays, and their maps.

    Args:
        items: objects with estimated materials, in Object Mode.

    Attributes:
        materials: the estimated ones of the objects' slots, None for the artist's.
        slot: (T,) place in it of each triangle.
        filled: (T,) bool, completes what was hidden.
    """

    def __init__(self, items: Sequence[bpy.types.Object]) -> None:
        self.materials: list[bpy.types.Material | None] = []
        found: list[tuple[np.ndarray, ...]] = []
        for item in items:
            mesh = item.data
            loops, polygons = triangle_loops(mesh, is_mirrored(item))
            layer = mesh.uv_layers.get(UV_LAYER)
            uv = np.zeros((len(mesh.loops), 2)) if layer is None else corner_uvs(mesh, layer)
            slot = np.minimum(polygon_slots(mesh)[polygons], max(len(mesh.materials) - 1, 0))
            filled = np.full(len(loops), FILLED in item)
            corners = world_positions(item)[corner_vertices(mesh)[loops]]
            found.append((corners, uv[loops], slot + len(self.materials), filled))
            self.materials += slot_estimates(mesh) or [None]
        self.corners, self._uvs, self.slot, self.filled = map(np.concatenate, zip(*found, strict=True))
        self._tree = corner_tree(self.corners)
        self._pixels: dict[str, np.ndarray] = {}

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

    def maps(self, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(N, 6) f32 base colour (scene-linear), roughness, metallic and confidence of the base colour.

        Args:
            triangles: (N,) on which the points lie; those without an estimate get 0.
            points: (N, 3).
        """
        values = np.zeros((len(triangles), 6), np.float32)
        uv = np.einsum("nk,nkc->nc", barycentric(points, self.corners[triangles]), self._uvs[triangles])
        for slot in np.unique(self.slot[triangles]).tolist():
            rows, material = np.flatnonzero(self.slot[triangles] == slot), self.materials[slot]
            for label, column in _COLUMNS.items() if material is not None else ():
                node = node_tree(material).nodes[MAP.format(label)]
                found = (
                    np.tile(node.outputs["Color"].default_value[:3], (len(rows), 1))
                    if node.bl_idname == "ShaderNodeRGB"  # a part of one value
                    else self._texels(node.image, label, uv[rows])
                )
                values[rows, column] = found if label == "Base Color" else found[:, 0]
        return values

    def _texels(self, image: bpy.types.Image, label: str, uv: np.ndarray) -> np.ndarray:
        """(N, 3) values of an image at UVs (N, 2)."""
        if image.name not in self._pixels:
            read = linear_values if label == "Base Color" else image_values
            self._pixels[image.name] = read(image)
        pixels = self._pixels[image.name]
        size = np.array([pixels.shape[1], pixels.shape[0]])
        x, y = np.clip((uv * size).astype(int), 0, size - 1).T
        return pixels[y, x][:, [0, 1, 2] if pixels.shape[2] > 2 else [0, 0, 0]]


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

    def axes(self) -> np.ndarray:
        """(2, 3) unit vectors on it, whose cross product is the normal; of a wall, the first one is level."""
        level = np.cross([0.0, 0.0, 1.0], self.normal)
        first = level if np.linalg.norm(level) > 0.1 else np.cross([0.0, 1.0, 0.0], self.normal)
        first = first / np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])


def _reach(points: np.ndarray) -> float:
    """How far around removed points (N, 3) planes are looked for, metres."""
    return float(np.clip(0.5 * np.ptp(points, axis=0).max(), *_REACH))


def planes_beside(room: Room, points: np.ndarray) -> list[Plane]:
    """The planes beside removed points (N, 3), those first that are seen most from their place."""
    random, reach = np.random.default_rng(0), _reach(points)
    low, high = points.min(axis=0), points.max(axis=0)
    directions = random.normal(size=(_RAYS, 3))
    directions[::2] = np.eye(3)[random.integers(3, size=_RAYS // 2)] * random.choice([-1, 1], (_RAYS // 2, 1))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    triangle, hits, normals = room.cast(random.uniform(low, high, (_RAYS, 3)), directions, 3.0 * reach)
    normals *= -np.sign(np.einsum("ni,ni->n", normals, directions))[:, None]
    chosen = (triangle >= 0) & ((hits > low - reach) & (hits < high + reach)).all(axis=1)
    hits, normals = hits[chosen], normals[chosen]
    least = max(_LEAST_SHARE * len(hits), 20.0)
    planes: list[Plane] = []
    while len(hits) > least and len(planes) < _MOST_PLANES:
        seeds = random.integers(len(hits), size=48)
        best = max((_on_plane(hits, normals, normals[k], hits[k]) for k in seeds), key=np.count_nonzero)
        if best.sum() < least:
            break
        normal = np.median(normals[best], axis=0)
        normal /= np.linalg.norm(normal)
        plane = Plane(normal, float(np.median(hits[best] @ normal)))
        # Rays that start behind a wall, in which the furniture is a little, see its back.
        if not any(_is_back(plane, each) for each in planes):
            planes.append(plane)
        left = ~best & ~_on_plane(hits, normals, normal, plane.offset * normal)
        hits, normals = hits[left], normals[left]
    return planes


def _is_back(plane: Plane, other: Plane) -> bool:
    same_place = abs(plane.offset + other.offset) < 2.0 * _THICKNESS
    return bool(plane.normal @ other.normal < -_PARALLEL) and same_place


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
    height, reach, axes = plane.height(points), _reach(points), plane.axes()
    near = points[(height > -_THICKNESS) & (height < height.min() + 2.0 * reach)] @ axes.T
    if height.min() > reach or not len(near):
        return None
    low, high = near.min(axis=0) - _MARGIN * reach, near.max(axis=0) + _MARGIN * reach
    size = max(FINEST, float((high - low).max()) / MOST_CELLS)
    columns, rows = np.ceil((high - low) / size).astype(int).tolist()
    flat = low + size * (np.indices((rows, columns))[::-1].reshape(2, -1).T + 0.5)
    centers = plane.normal * plane.offset + flat @ axes
    towards = np.broadcast_to(-plane.normal, centers.shape)
    triangle, hits, normals = room.cast(centers + _THICKNESS * plane.normal, towards, 2.0 * _THICKNESS)
    there = (triangle >= 0) & (normals @ plane.normal > 0.5)
    slot, values = np.where(there, room.slot[triangle], -1), np.zeros((len(centers), 6), np.float32)
    values[there] = room.maps(triangle[there], hits[there])
    known = there & ((values[:, 5] > 0.0) | room.filled[triangle])
    unseen = there & ~known
    unseen[~there] = _closes(room, plane, others, centers[~there])
    behind = ((flat > near.min(axis=0) - 2.0 * size) & (flat < near.max(axis=0) + 2.0 * size)).all(axis=1)
    grid = (rows, columns)
    known, unseen, hidden = known.reshape(grid), unseen.reshape(grid), (unseen & behind).reshape(grid)
    while (more := grown(hidden) & unseen).sum() > hidden.sum():  # what is connected with it
        hidden = more
    if hidden.sum() < 9:
        return None
    worn = grown(hidden, _WORN) & known
    origin = plane.normal * plane.offset + low @ axes
    above = np.where(there, plane.height(hits), 0.0).reshape(grid)
    maps = values[:, :5].reshape(*grid, 5)
    return Window(plane, origin, size, maps, known & ~worn, hidden | worn, slot.reshape(grid), above)


def _closes(room: Room, plane: Plane, others: Sequence[Plane], points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) without a surface a plane closes: nothing of the room is behind them."""
    crossing = [other for other in others if abs(float(other.normal @ plane.normal)) < 0.9]
    inside = np.ones(len(points), bool)
    for other in crossing:
        inside &= other.height(points) > -_THICKNESS
    towards = np.broadcast_to(-plane.normal, points.shape)
    triangle, _, normals = room.cast(points + _THICKNESS * plane.normal, towards, 100.0)
    return inside & ((triangle < 0) | (normals @ plane.normal < 0.0))
