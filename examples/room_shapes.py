"""Shapes the example room is built of: bevelled boxes, turned profiles, tubes, cushions, sheets.

A `Form` gathers pieces into one Blender object. Metres, Z up. Runs in Blender or with bpy as a module.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import bmesh
import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

Point = tuple[float, float, float]
UV_DENSITY = 2.0  # repeats of a tiling texture per metre
SHARP_ANGLE = math.radians(42)


class Form:
    """One object under construction; every piece names its material."""

    def __init__(self, name: str, at: Point = (0, 0, 0), turn: float = 0.0, uv: bool = True) -> None:
        """`at` and `turn` (degrees about Z) place everything in the form; without `uv` no UVs are kept."""
        self.name, self.keep_uv = name, uv
        self.bm = bmesh.new()
        self.uv = self.bm.loops.layers.uv.new("UVMap")
        self.materials: list[str] = []
        self.place = Matrix.Translation(at) @ Matrix.Rotation(math.radians(turn), 4, "Z")

    def _slot(self, material: str) -> int:
        if material not in self.materials:
            self.materials.append(material)
        return self.materials.index(material)

    def _matrix(self, at: Point, turn: Point) -> Matrix:
        return (
            self.place @ Matrix.Translation(at) @ Euler([math.radians(t) for t in turn]).to_matrix().to_4x4()
        )

    def box(
        self,
        size: Point,
        at: Point,
        material: str,
        bevel: float = 0.006,
        turn: Point = (0, 0, 0),
        uv_tile: tuple[float, float, float] | None = None,
        segments: int = 2,
    ) -> None:
        """A bevelled box centred at `at`. UVs: box projection, or the square `uv_tile` (u, v, side)."""
        piece = bmesh.new()
        layer = piece.loops.layers.uv.new("UVMap")
        bmesh.ops.create_cube(piece, size=1.0)
        bmesh.ops.scale(piece, vec=size, verts=piece.verts)
        if bevel > 0:
            width = min(bevel, 0.45 * min(size))
            bmesh.ops.bevel(
                piece,
                geom=piece.edges[:],
                offset=width,
                segments=segments,
                profile=0.5,
                affect="EDGES",
                offset_type="OFFSET",
                clamp_overlap=True,
            )
        piece.normal_update()
        for face in piece.faces:
            axis = max(range(3), key=lambda k: abs(face.normal[k]))
            # the longer side of the box runs along u, like the grain of a board
            across, along = sorted((k for k in range(3) if k != axis), key=lambda k: size[k])
            for loop in face.loops:
                u, v = loop.vert.co[along], loop.vert.co[across]
                if uv_tile is None:
                    loop[layer].uv = (u * UV_DENSITY + at[0], v * UV_DENSITY + at[2])
                else:
                    inside = [min(max(c / size[k] + 0.5, 0.02), 0.98) for c, k in ((v, across), (u, along))]
                    loop[layer].uv = [uv_tile[k] + inside[k] * uv_tile[2] for k in range(2)]
        self._join(piece, material, self._matrix(at, turn))

    def lathe(
        self,
        profile: Sequence[tuple[float, float]],
        at: Point,
        material: str,
        segments: int = 24,
        turn: Point = (0, 0, 0),
    ) -> None:
        """A profile of (radius, height), turned about Z; listed upwards on the outside it faces outwards."""
        rings = np.asarray(profile, float)
        angle = np.linspace(0, 2 * math.pi, segments + 1)
        points = np.empty((len(rings), segments + 1, 3))
        points[..., 0] = rings[:, :1] * np.cos(angle)
        points[..., 1] = rings[:, :1] * np.sin(angle)
        points[..., 2] = rings[:, 1:]
        self.sheet(points, at, material, turn, weld=True)

    def tube(self, path: Sequence[Point], radius: float, material: str, segments: int = 8) -> None:
        """A round bar along a polyline in the form's coordinates, closed at its ends."""
        points = np.asarray(path, float)
        tangent = np.gradient(points, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        helper = np.eye(3)[np.abs(tangent).max(axis=0).argmin()]  # the axis that the bar never runs along
        side = np.cross(tangent, helper)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        up = np.cross(side, tangent)
        angle = np.linspace(0, 2 * math.pi, segments + 1)
        ring = np.cos(angle)[:, None] * side[:, None] - np.sin(angle)[:, None] * up[:, None]
        body = points[:, None] + radius * ring
        ends = [np.repeat(points[k][None, None], segments + 1, 1) for k in (0, -1)]
        self.sheet(np.concatenate([ends[0], body, ends[1]]), (0, 0, 0), material, weld=True)

    def cushion(
        self,
        size: Point,
        at: Point,
        material: str,
        turn: Point = (0, 0, 0),
        puff: float = 0.15,
        cells: int = 7,
        roundness: float = 5.0,
    ) -> None:
        """A filled cushion: a superellipsoid of exponent `roundness` that swells by `puff` x height."""
        piece = bmesh.new()
        layer = piece.loops.layers.uv.new("UVMap")
        bmesh.ops.create_cube(piece, size=2.0)
        bmesh.ops.subdivide_edges(piece, edges=piece.edges[:], cuts=cells - 1, use_grid_fill=True)
        for vertex in piece.verts:
            c = np.array(vertex.co)
            c = c * np.abs(c).max() / (np.abs(c) ** roundness).sum() ** (1 / roundness)
            c[2] += puff * np.sign(c[2]) * (1 - c[0] ** 2) * (1 - c[1] ** 2) * abs(c[2])
            vertex.co = Vector(c * np.asarray(size) / 2)
        piece.normal_update()
        for face in piece.faces:
            axis = max(range(3), key=lambda k: abs(face.normal[k]))
            u, v = [k for k in range(3) if k != axis]
            for loop in face.loops:
                loop[layer].uv = (loop.vert.co[u] * UV_DENSITY, loop.vert.co[v] * UV_DENSITY)
        self._join(piece, material, self._matrix(at, turn))

    def pillow(
        self, width: float, height: float, depth: float, at: Point, material: str, turn: Point
    ) -> None:
        """A throw pillow lying in its XY plane: two cloth sides that meet in a seam, pinched corners."""
        grid = np.linspace(-1, 1, 11)
        x, y = np.meshgrid(grid, grid, indexing="ij")
        pinch = 1 - 0.10 * (1 - np.abs(x * y)) * (x**2 + y**2) / 2
        swell = ((1 - x**4) * (1 - y**4)) ** 0.55
        for sign in (1, -1):
            wrinkle = 0.04 * np.sin(5 * x + 2 * y) * swell
            points = np.stack(
                [x * pinch * width / 2, y * pinch * height / 2, sign * depth / 2 * (swell + wrinkle)], -1
            )
            self.sheet(points if sign < 0 else points.swapaxes(0, 1), at, material, turn)

    def sheet(
        self, points: np.ndarray, at: Point, material: str, turn: Point = (0, 0, 0), weld: bool = False
    ) -> None:
        """A grid of points (N, M, 3) as quads, UVs 0 to 1 over it. `weld` merges doubles."""
        piece = bmesh.new()
        layer = piece.loops.layers.uv.new("UVMap")
        rows, columns = points.shape[:2]
        verts = [[piece.verts.new(p) for p in row] for row in points]
        for i in range(rows - 1):
            for j in range(columns - 1):
                corners = ((i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j))
                face = piece.faces.new([verts[a][b] for a, b in corners])
                for loop, (a, b) in zip(face.loops, corners, strict=True):
                    loop[layer].uv = (b / (columns - 1), a / (rows - 1))
        if weld:
            bmesh.ops.remove_doubles(piece, verts=piece.verts[:], dist=1e-5)
            bmesh.ops.dissolve_degenerate(piece, dist=1e-6, edges=piece.edges[:])
        self._join(piece, material, self._matrix(at, turn))

    def _join(self, piece: bmesh.types.BMesh, material: str, matrix: Matrix) -> None:
        slot = self._slot(material)
        source = piece.loops.layers.uv["UVMap"]
        verts = {v: self.bm.verts.new(matrix @ v.co) for v in piece.verts}
        for face in piece.faces:
            copy = self.bm.faces.new([verts[v] for v in face.verts])
            copy.material_index, copy.smooth = slot, True
            for new, old in zip(copy.loops, face.loops, strict=True):
                new[self.uv].uv = old[source].uv
        piece.free()

    def finish(self) -> bpy.types.Object:
        """The object in the scene: triangles, sharp edges by angle, area-weighted normals."""
        bmesh.ops.triangulate(self.bm, faces=self.bm.faces[:])
        mesh = bpy.data.meshes.new(self.name)
        self.bm.to_mesh(mesh)
        self.bm.free()
        if not self.keep_uv:
            mesh.uv_layers.remove(mesh.uv_layers["UVMap"])
        for name in self.materials:
            mesh.materials.append(bpy.data.materials[name])
        mesh.set_sharp_from_angle(angle=SHARP_ANGLE)
        thing = bpy.data.objects.new(self.name, mesh)
        bpy.context.scene.collection.objects.link(thing)
        thing.modifiers.new("Weighted normals", "WEIGHTED_NORMAL").keep_sharp = True
        return thing
