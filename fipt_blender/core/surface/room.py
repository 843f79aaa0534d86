"""The room's mesh as arrays and as a Mitsuba scene for ray queries.

Blender writes room.npz (docs/run_folder.md); mesh files are not read here. All surfaces are double-sided:
normals are flipped towards the viewer, so that inverted normals have no effect.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..run.errors import FiptError
from ..run.run_files import CLOSING, RoomMesh, read_capture, read_room
from ..run.runfolder import RunFolder
from ..run.threads import cached_property
from .adjacency import face_vectors
from .scan import Scan, find_scan

# Distance at which rays start above a scan, in units of its noise.
OFFSET_NOISE = 2.0
# Rays in all directions from cameras, at most so many of these, and the margin around where rays end, as a
# share of the longest side. Bounds longer than WIDE median distances of the ends leave out outlying ones, up
# to the last of these shares at each side. Of a mesh that surrounds no camera, fewer rays than FULL meet it.
DIRECTIONS, MAX_CAMERAS, MARGIN, WIDE, FULL = 1024, 64, 0.15, 10.0, 0.5
OUTLYING = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.03, 0.05)
NO_OBJECT = -1


@dataclass  # not frozen: Dr.Jit's loops write their state back to it
class Surface:
    """Where rays met the room, as Dr.Jit arrays of one width.

    Attributes:
        valid: whether anything was hit.
        position: metres, world space.
        distance: metres along the (unit) ray direction.
        triangle: room triangle index.
        geometric_normal: unit, by the triangle's winding.
        normal: unit shading normal on the side that the ray came from.
        front: whether the ray came from the side that the geometric normal points to.
    """

    valid: mi.Bool
    position: mi.Point3f
    distance: mi.Float
    triangle: mi.UInt32
    geometric_normal: mi.Normal3f
    normal: mi.Normal3f
    front: mi.Bool


_ARRAYS = {
    "vertices": np.float32,
    "triangles": np.int32,
    "corner_normals": np.float32,
    "triangle_object": np.int32,
    "triangle_material": np.int32,
}


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
        parts: source of part ids: auto, masks, semantics, materials, objects, loose or none.
        noise: standard deviation of a scan's distance from its smooth fit, metres; 0 for an exact mesh.
        plane: (T,) int32 plane of each triangle of a scan, -1 without one; None for an exact mesh.
        exact: (T,) bool, triangles of exact objects that the artist added to a scan; None without any.
        cameras: (C, 3) float64 positions, metres; None where none is known.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    triangle_object: np.ndarray
    triangle_material: np.ndarray
    objects: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()
    parts: str = "masks"
    noise: float = 0.0
    plane: np.ndarray | None = None
    exact: np.ndarray | None = None
    cameras: np.ndarray | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Without the cached Mitsuba objects, which belong to one process."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @property
    def mesh_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the bounding box of all used vertices, each (3,) float64, metres."""
        used = self.vertices[self.triangles.reshape(-1)].astype(np.float64)
        return used.min(axis=0), used.max(axis=0)

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The part of `mesh_bounds` that surrounds the cameras: the extent of grids and tolerances.

        Terrain, other buildings and stray triangles, in which few rays from the cameras end, are outside of
        it and share its outermost cells. Without cameras, or in a mesh around none, it is all of the mesh.
        """
        low, high = self.mesh_bounds
        if self.cameras is None or not len(self.cameras):
            return low, high
        start = self.cameras[:: -(-len(self.cameras) // MAX_CAMERAS)]
        z = 1.0 - (2.0 * np.arange(DIRECTIONS) + 1.0) / DIRECTIONS  # a Fibonacci lattice
        turn, radius = np.arange(DIRECTIONS) * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - z**2)
        way = np.tile(np.stack([np.cos(turn) * radius, np.sin(turn) * radius, z], axis=1), (len(start), 1))
        start = np.repeat(start, DIRECTIONS, axis=0)
        ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(way.T.astype(np.float32)))
        hit = self.scene.ray_intersect_preliminary(ray, coherent=False)
        valid = np.array(hit.is_valid())
        if valid.mean() < FULL:
            return low, high
        distance = np.array(hit.t)[valid].astype(np.float64)
        end = start[valid] + way[valid] * distance[:, None]
        for share in OUTLYING:
            near, far = np.quantile(end, [share, 1.0 - share], axis=0)
            near, far = np.minimum(near, start.min(axis=0)), np.maximum(far, start.max(axis=0))
            margin = MARGIN * float((far - near).max())
            near, far = np.maximum(low, near - margin), np.minimum(high, far + margin)
            if float((far - near).max()) <= WIDE * np.median(distance):
                break
        return near, far

    @cached_property
    def _faces(self) -> tuple[np.ndarray, np.ndarray]:
        return face_vectors(np.asarray(self.vertices, np.float64), self.triangles)

    @property
    def normals(self) -> np.ndarray:
        """(T, 3) float64 unit geometric normals; (0, 0, 1) for triangles without area."""
        return self._faces[0]

    @property
    def areas(self) -> np.ndarray:
        """(T,) float64 triangle areas in square metres."""
        return self._faces[1]

    def points_on(self, triangles: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(..., 3) points on triangles (...), uniformly distributed if u and v (...) are so in [0, 1)."""
        root = np.sqrt(u)
        corners = self.vertices[self.triangles[triangles]]
        weights = (1.0 - root, root * (1.0 - v), root * v)
        return sum(weight[..., None] * corners[..., c, :] for c, weight in enumerate(weights))

    @property
    def closing(self) -> np.ndarray:
        """(T,) bool, triangles by which the engine closed small holes of a scan."""
        index = self.objects.index(CLOSING) if CLOSING in self.objects else NO_OBJECT
        return self.triangle_object == index

    @cached_property
    def scan(self) -> Scan | None:
        """The surface of a scanned mesh, None for a modelled one; takes seconds for a million triangles."""
        return find_scan(self.vertices, self.triangles, self.noise, self.exact)

    @property
    def place(self) -> float:
        """Standard deviation of the position of surfaces and borders, metres; 0 for a modelled mesh."""
        return 0.0 if self.scan is None else self.scan.place

    @cached_property
    def scene(self) -> mi.Scene:
        """A Mitsuba scene of the mesh alone; the variant must be set."""
        mesh = mi.Mesh("room", len(self.vertices), len(self.triangles))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(np.ascontiguousarray(self.vertices, np.float32).reshape(-1))
        parameters["faces"] = mi.UInt32(np.ascontiguousarray(self.triangles, np.uint32).reshape(-1))
        parameters.update()
        return mi.load_dict({"type": "scene", "room": mesh})

    @cached_property
    def _shading(self) -> tuple[mi.Float, mi.Float]:
        """Geometric normal of each triangle and shading normal of each corner, as flat Dr.Jit arrays."""
        geometric = self.normals.astype(np.float32)
        corner = np.ascontiguousarray(self.corner_normals, np.float32).reshape(-1)
        return mi.Float(geometric.reshape(-1)), mi.Float(corner)

    def intersect(self, ray: mi.Ray3f, active: mi.Bool | bool = True) -> Surface:
        """First surface along each ray, with one traversal of the scene.

        Args:
            ray: with unit directions.
            active: which rays to trace.
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
        # At silhouettes interpolated normals may point away from the viewer; the geometric normal can't.
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
        """Distance in metres by which secondary rays start above a surface.

        5e-5 of the room's diagonal; on a scan more, so that rays do not hit the bump beside them.
        """
        low, high = self.bounds
        return max(float(5e-5 * np.linalg.norm(high - low)), OFFSET_NOISE * self.noise)


def load_room(run: RunFolder, cleaned: bool = True) -> Room:
    """The room of a run, with what its last estimation has made of it where it is a scan.

    Args:
        run: the run folder.
        cleaned: whether a scan has its cleaned geometry.
    """
    if not run.room_npz.exists():
        raise FiptError("mesh-missing.load-room", room_npz=run.room_npz)
    stored = read_room(run)
    return make_room(stored if cleaned else replace(stored, scan=None), _camera_positions(run))


def make_room(mesh: RoomMesh, cameras: np.ndarray | None = None) -> Room:
    """The room of a mesh, with its cleaned geometry where it has one; `cameras`: as of `Room`."""
    scan = mesh.scan
    if scan is not None:
        mesh = replace(mesh, vertices=scan.vertices, corner_normals=scan.corner_normals)
    room = Room(
        **{name: np.asarray(getattr(mesh, name), kind) for name, kind in _ARRAYS.items()},
        noise=float(scan.noise) if scan else 0.0,
        plane=scan.plane.astype(np.int32) if scan else None,
        objects=mesh.objects,
        materials=mesh.materials,
        parts=mesh.parts,
        exact=mesh.triangle_exact,
        cameras=cameras,
    )
    if not np.isfinite(room.vertices).all():
        raise FiptError("mesh-damaged")
    if not room.areas.max(initial=0.0) > 0.0:
        raise FiptError("mesh-empty.load-room")
    return room


def _camera_positions(run: RunFolder) -> np.ndarray | None:
    """(C, 3) of capture.json, metres; None without one."""
    if not run.capture_json.exists():
        return None
    poses = [view.camera_to_world for view in read_capture(run.capture_json).views]
    return np.array(poses, np.float64).reshape(-1, 4, 4)[:, :3, 3]
