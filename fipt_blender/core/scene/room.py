# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The room's mesh as arrays and as a Mitsuba scene for ray queries.

Blender writes room.npz (docs/architecture.md); nothing here reads mesh files. All surfaces are double-sided:
normals are flipped to the side that is looked at, so inverted ones do no harm.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..job.errors import FiptError
from ..job.runfolder import RunFolder, read_json


@dataclass  # not frozen: Dr.Jit's loops write their state back into it
class Surface:
    """Where rays met the room, as Dr.Jit arrays of one width.

    Attributes:
        valid: Bool, whether anything was hit.
        position: Point3f, metres, world space.
        distance: Float, metres along the (unit) ray direction.
        triangle: UInt32, room triangle index.
        geometric_normal: Normal3f, unit, as the triangle is wound.
        normal: Normal3f, unit shading normal on the side that the ray came from.
        front: Bool, whether the ray came from the side the geometric normal points to.
    """

    valid: Any
    position: Any
    distance: Any
    triangle: Any
    geometric_normal: Any
    normal: Any
    front: Any


@dataclass(frozen=True)
class Room:
    """The mesh of one room in Blender's world space (Z up, metres).

    Attributes:
        vertices: (V, 3) float32.
        triangles: (T, 3) int32.
        corner_normals: (T, 3, 3) float32 unit shading normals.
        triangle_object: (T,) int32 index into `objects`.
        triangle_material: (T,) int32 index into `materials`, -1 without.
        objects: object names.
        materials: material names.
        parts: where part ids come from: objects, materials, masks or none.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    triangle_object: np.ndarray
    triangle_material: np.ndarray
    objects: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()
    parts: str = "masks"

    def __getstate__(self) -> dict[str, Any]:
        """Without what is made of it here: Mitsuba's objects belong to one process."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the box around all used vertices, each (3,) float64."""
        used = self.vertices[self.triangles.reshape(-1)].astype(np.float64)
        return used.min(axis=0), used.max(axis=0)

    @cached_property
    def areas(self) -> np.ndarray:
        """(T,) float64 triangle areas in square metres."""
        corners = self.vertices.astype(np.float64)[self.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return 0.5 * np.linalg.norm(cross, axis=1)

    @cached_property
    def scene(self) -> Any:
        """A Mitsuba scene with the mesh alone; needs the variant to be set."""
        mesh = mi.Mesh("room", len(self.vertices), len(self.triangles))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(np.ascontiguousarray(self.vertices, np.float32).reshape(-1))
        parameters["faces"] = mi.UInt32(np.ascontiguousarray(self.triangles, np.uint32).reshape(-1))
        parameters.update()
        return mi.load_dict({"type": "scene", "room": mesh})

    @cached_property
    def _shading(self) -> tuple[Any, Any]:
        geometric = triangle_normals(self.vertices, self.triangles).astype(np.float32)
        corner = np.ascontiguousarray(self.corner_normals, np.float32).reshape(-1)
        return mi.Float(geometric.reshape(-1)), mi.Float(corner)

    def intersect(self, ray: Any, active: Any = True) -> Surface:
        """First surface along each ray (one traversal of the scene).

        Args:
            ray: Ray3f with unit directions.
            active: Bool lanes to trace.
        """
        hit = self.scene.ray_intersect_preliminary(ray, coherent=False, active=mi.Bool(active))
        valid = hit.is_valid() & mi.Bool(active)
        geometric_table, corner_table = self._shading
        triangle = dr.select(valid, hit.prim_index, 0)
        geometric = dr.gather(mi.Normal3f, geometric_table, triangle, valid)
        u, v = hit.prim_uv.x, hit.prim_uv.y
        n0 = dr.gather(mi.Normal3f, corner_table, triangle * 3, valid)
        n1 = dr.gather(mi.Normal3f, corner_table, triangle * 3 + 1, valid)
        n2 = dr.gather(mi.Normal3f, corner_table, triangle * 3 + 2, valid)
        smooth = dr.normalize(n0 * (1.0 - u - v) + n1 * u + n2 * v)
        toward = -ray.d
        front = dr.dot(geometric, toward) > 0.0
        side = dr.select(front, geometric, -geometric)
        smooth = dr.select(dr.dot(smooth, side) < 0.0, -smooth, smooth)
        # Interpolated normals may turn away from the viewer at silhouettes; the flat one can't.
        usable = dr.isfinite(smooth.x) & (dr.dot(smooth, toward) > 1e-3)
        normal = dr.select(usable, smooth, side)
        return Surface(
            valid=valid,
            position=dr.fma(ray.d, hit.t, ray.o),
            distance=hit.t,
            triangle=triangle,
            geometric_normal=geometric,
            normal=normal,
            front=front,
        )

    @cached_property
    def offset(self) -> float:
        """Distance in metres by which secondary rays start above a surface (5e-5 of the room's diagonal)."""
        low, high = self.bounds
        return float(5e-5 * np.linalg.norm(high - low))

    def leave(self, surface_position: Any, geometric_normal: Any, direction: Any) -> Any:
        """Ray3f that leaves a surface in `direction` without meeting the same surface again."""
        side = dr.mulsign(mi.Vector3f(geometric_normal), dr.dot(geometric_normal, direction))
        return mi.Ray3f(surface_position + side * self.offset, direction)


def triangle_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T, 3) float64 unit geometric normals; (0, 0, 1) for triangles without area."""
    corners = np.asarray(vertices, np.float64)[np.asarray(triangles)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.where(length > 1e-30, cross / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])


def load_room(run: RunFolder) -> Room:
    """Read room.npz and room.json.

    Raises:
        FiptError: ``mesh-missing``, ``mesh-damaged`` or ``mesh-empty``.
    """
    if not run.room_npz.exists():
        raise FiptError("mesh-missing", f"{run.room_npz} does not exist.", "Export the room's mesh first.")
    try:
        with np.load(run.room_npz, allow_pickle=False) as data:
            arrays = {name: data[name] for name in data.files}
        room = Room(
            vertices=np.asarray(arrays["vertices"], np.float32),
            triangles=np.asarray(arrays["triangles"], np.int32),
            corner_normals=np.asarray(arrays["corner_normals"], np.float32),
            triangle_object=np.asarray(arrays["triangle_object"], np.int32),
            triangle_material=np.asarray(arrays["triangle_material"], np.int32),
            **_names(run),
        )
    except (KeyError, ValueError, OSError) as error:
        raise FiptError(
            "mesh-damaged", f"{run.room_npz} can't be read ({error}).", "Export it again."
        ) from None
    check_room(room)
    return room


def _names(run: RunFolder) -> dict[str, Any]:
    data = read_json(run.room_json)
    return {
        "objects": tuple(data.get("objects", ())),
        "materials": tuple(data.get("materials", ())),
        "parts": str(data.get("parts", "masks")),
    }


def check_room(room: Room) -> None:
    """Raise FiptError ``mesh-empty`` or ``mesh-damaged`` where no ray could be traced."""
    if not len(room.triangles) or not room.areas.max(initial=0.0) > 0.0:
        raise FiptError("mesh-empty", "The room's mesh has no surface.", "Choose a mesh with faces.")
    if room.triangles.min() < 0 or room.triangles.max() >= len(room.vertices):
        raise FiptError("mesh-damaged", "The room's mesh refers to missing vertices.", "Export it again.")
    if not np.isfinite(room.vertices).all():
        raise FiptError(
            "mesh-damaged",
            "The room's mesh has vertices at infinity.",
            "Remove them (Mesh > Clean Up) and export it again.",
        )
