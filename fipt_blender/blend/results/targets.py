"""New result meshes for the room's objects, and what each of their faces shows of the run's room.

An object whose faces are those that were exported gets a mesh made anew from its own one. A result mesh that
the artist has modelled stays as it is, in a copy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bmesh
import bpy
import numpy as np

from ...bridge.step import Slices
from ...core.run.errors import FiptError
from ...core.run.run_files import Geometry, RoomMesh
from ..lights.fixtures import divide
from ..marks import SPLIT_OFF
from ..room.mesh_arrays import is_mirrored, remove_polygons, transform_points, triangle_loops
from ..room.mesh_digest import is_edited
from ..room.originals import result_mesh
from ..room.result_meshes import clean_result_mesh, evaluations, make_mesh
from ..room.transfer import Counterparts, Surfaces, copy_same, exported, find_nearest, same_polygons
from ..slices import find_object


@dataclass(frozen=True)
class Target:
    """An object of the room with its new result mesh.

    Attributes:
        index: of the object in the room; several have the same one where the artist has separated it.
        name, mesh_name: names, since an undo between two slices may replace all data.
        found: what the faces of the mesh show.
        modifiers: names of those that are part of the mesh; None where the artist has modelled it.
        is_copy: whether another target has the object's name and lamps.
    """

    index: int
    name: str
    mesh_name: str
    found: Counterparts
    modifiers: list[str] | None
    is_copy: bool


class TargetBuilder:
    """Makes the result meshes of a run's objects.

    Args:
        room: the run's room.
        geometry: the cleaned geometry of a scan, if it is wanted.
        fixture: (T,) index of the fixture of each triangle, -1 for none.
        charts: the chart of each triangle (T,) in the atlas; called where the nearest surface is searched.

    Attributes:
        made: names of all new meshes, also of those that are not needed any more.
    """

    def __init__(
        self,
        room: RoomMesh,
        geometry: Geometry | None,
        fixture: np.ndarray,
        charts: Callable[[], np.ndarray],
    ) -> None:
        self._room, self._geometry, self._fixture, self._charts = room, geometry, fixture, charts
        self._searched: Surfaces | None = None
        self.made: list[str] = []

    def build(self, index: int, name: str, is_copy: bool) -> Slices[Target]:
        """The target of one object.

        Args:
            index: of the object in the room.
            name: of the object.
            is_copy: whether it was copied or separated from another target.
        """
        item = find_object(name)
        present = result_mesh(item)
        modelled = present if present is not None and (is_copy or is_edited(present)) else None
        split = set(modelled.get(SPLIT_OFF, ())) if modelled is not None and not is_copy else set()
        try:
            reference, found, modifiers = self._as_exported(index, item, split)
        except FiptError as error:
            if error.code != "room-changed":
                raise
            reference = None
        if modelled is not None:
            mesh = self._note(modelled.copy())
            found_now = self._modelled(index, item, mesh, split, reference and (reference, found))
            yield from self._search(index, name, mesh.name, found_now)
            return Target(index, name, mesh.name, found_now, None, is_copy)
        if reference is not None:
            return Target(index, name, reference.name, found, modifiers, is_copy)
        return (yield from self._changed(index, name, is_copy))

    def _note(self, mesh: bpy.types.Mesh) -> bpy.types.Mesh:
        self.made.append(mesh.name)
        return mesh

    def _as_exported(
        self, index: int, item: bpy.types.Object, split: set[int]
    ) -> tuple[bpy.types.Mesh, Counterparts, list[str]]:
        """The mesh with the exported faces, those divided of which a fixture has some triangles."""
        made, modifiers = make_mesh(self._room, index, item)
        mesh = self._note(made)
        if self._geometry is not None:
            clean_result_mesh(mesh, item, self._room, index, self._geometry)
        rows = np.flatnonzero(self._room.triangle_object == index)
        _, polygon = triangle_loops(mesh, False)
        first = np.searchsorted(polygon, np.arange(len(mesh.polygons)))
        was_split = np.isin(np.arange(len(rows)), list(split))
        first = divide(mesh, 2 * self._fixture[rows] + was_split, first)
        return mesh, exported(mesh, is_mirrored(item), rows, first), modifiers

    def _modelled(
        self,
        index: int,
        item: bpy.types.Object,
        mesh: bpy.types.Mesh,
        split: set[int],
        reference: tuple[bpy.types.Mesh, Counterparts] | None,
    ) -> Counterparts:
        """The counterparts of a mesh that the artist has modelled, which gets earlier lamps back."""
        if reference is None:
            if split:
                _append(mesh, self._lamps(index, item))
            return Counterparts.none(mesh)
        other, of_other = reference
        rows = np.flatnonzero(self._room.triangle_object == index)
        local = np.searchsorted(rows, of_other.triangle)
        missing = np.isin(local, list(split)) & (same_polygons(other, mesh) < 0)
        if missing.any():
            lamps = other.copy()
            remove_polygons(lamps, ~missing)
            _append(mesh, lamps)
        found = Counterparts.none(mesh)
        copy_same(mesh, found, other, of_other)
        bpy.data.meshes.remove(other)
        return found

    def _lamps(self, index: int, item: bpy.types.Object) -> bpy.types.Mesh:
        """The lamps' triangles of an object as they were exported, in its own space."""
        rows = np.flatnonzero((self._room.triangle_object == index) & (self._fixture >= 0))
        inverse = np.linalg.inv(self._matrix(index))
        points = transform_points(self._room.vertices[self._room.triangles[rows]].reshape(-1, 3), inverse)
        faces = np.arange(len(points)).reshape(-1, 3)
        mesh = bpy.data.meshes.new("lamps")
        mesh.from_pydata(points.tolist(), [], (faces[:, ::-1] if is_mirrored(item) else faces).tolist())
        return mesh

    def _changed(self, index: int, name: str, is_copy: bool) -> Slices[Target]:
        """The target of an object whose own faces or modifiers have changed since it was exported.

        Of the meshes with all modifiers, without the last one and so on, that with most area of counterparts
        is taken; of equal ones that with the fewest modifiers, since the others stay live.
        """
        item = find_object(name)
        tried = [(self._note(mesh).name, modifiers) for mesh, modifiers in evaluations(item)]
        best: tuple[float, Target] | None = None
        for mesh_name, modifiers in tried:
            found = Counterparts.none(bpy.data.meshes[mesh_name])
            yield from self._search(index, name, mesh_name, found)
            mesh = find_mesh(mesh_name)
            area = np.empty(len(mesh.polygons), np.float32)
            mesh.polygons.foreach_get("area", area)
            share = float(area[found.triangle >= 0].sum()) / max(float(area.sum()), 1e-30)
            if best is None or share >= best[0] - 1e-4:
                best = share, Target(index, name, mesh_name, found, modifiers, is_copy)
        assert best is not None
        for mesh_name, _ in tried:
            if mesh_name != best[1].mesh_name:
                bpy.data.meshes.remove(find_mesh(mesh_name))
        return best[1]

    def _search(self, index: int, name: str, mesh_name: str, found: Counterparts) -> Slices[None]:
        """Search the nearest surfaces where the object was exported; where none is there, where it is now."""
        if (found.triangle >= 0).all():
            return
        if self._searched is None:
            vertices = self._room.vertices if self._geometry is None else self._geometry.vertices
            self._searched = Surfaces(vertices, self._room.triangles, self._charts())
        yield from find_nearest(find_mesh(mesh_name), found, self._matrix(index), self._searched)
        if (found.triangle < 0).all():
            matrix = np.array(find_object(name).matrix_world, np.float64)
            yield from find_nearest(find_mesh(mesh_name), found, matrix, self._searched)

    def _matrix(self, index: int) -> np.ndarray:
        """4x4, the object's space to the world when it was exported; the engine's are in the world's."""
        matrices = self._room.matrices
        return np.array(matrices[index], np.float64) if index < len(matrices) else np.eye(4)


def find_mesh(name: str) -> bpy.types.Mesh:
    """A prepared mesh of an earlier slice."""
    mesh = bpy.data.meshes.get(name)
    if mesh is None:
        raise FiptError("apply-interrupted")
    return mesh


def _append(mesh: bpy.types.Mesh, more: bpy.types.Mesh) -> None:
    """Add the geometry and layers of another mesh, which is removed."""
    bm = bmesh.new()
    bm.from_mesh(mesh)
    bm.from_mesh(more)
    bm.to_mesh(mesh)
    bm.free()
    mesh.update()
    bpy.data.meshes.remove(more)
