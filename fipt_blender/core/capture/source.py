"""A capture as it is read, and where its mesh comes from: a file, fewer of its triangles, or depth images."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..conventions import transform_points
from ..depth.cleaning import collapsed
from ..depth.extraction import FusedMesh
from ..depth.ply import write_ply
from ..run.errors import FiptError, Problem, problem
from ..run.messages import Reporter
from ..run.runfolder import RunFolder
from .checks import judge_size
from .depth_images import checked_depths
from .files import stand_in
from .formats.registry import read_points, read_rig
from .mesh_file import read_mesh
from .options import CaptureOptions
from .relation import Related, relate
from .rig import Rig

# Depth images are measured in metres, and often show a part of a room: only their unit can be wrong, which is
# 1, 0.25 or 0.2 mm, so that sizes within this factor are plausible.
MEASURED = 3.0


@dataclass(frozen=True, eq=False)
class Source(Related):
    """A capture as it was read, and where its mesh comes from."""

    mesh: Path | None  # the mesh file; None without one
    # What is used instead of the file: fewer triangles or other coordinates; None for the file
    made: FusedMesh | None

    @property
    def is_fused(self) -> bool:
        """Whether its mesh is that of its depth images."""
        return self.mesh is None and bool(self.rig.depths)


def read_source(capture: Path, options: CaptureOptions, reporter: Reporter) -> Source:
    """Read cameras and mesh, and warn of what the user should know of them."""
    rig = _with_names(read_rig(capture, options.format, options), options)
    mesh = _mesh(rig, options)
    rig = replace(rig, depths=checked_depths(rig.depths))
    solved = np.zeros((0, 3))
    with suppress(FiptError):  # the format has none
        solved = read_points(capture, rig.source, sure=True)
    related = relate(capture, rig, mesh, solved, options)
    notes, made = list(related.rig.notes), None
    vertices, triangles = related.vertices, related.triangles
    if vertices is not None and len(triangles) and (related.moved or 0 < options.triangles < len(triangles)):
        made = fewer_triangles(vertices, triangles, options.triangles)
        remedy = "Its material slots, colors and UVs are not kept."
        if not related.moved:
            remedy += " Set the triangles to 0 to use the mesh itself."
        notes.append(
            problem(
                "mesh-simplified",
                mesh=mesh,
                number_of_triangles=len(made.triangles),
                number_of_triangles_2=len(triangles),
                remedy=remedy,
            )
        )
    for note in notes:
        reporter.warn(note)
    return Source(**vars(related), mesh=mesh, made=made)


def write_mesh(run: RunFolder, source: Source) -> Path | None:
    """The mesh file of a capture, written where it was made here; None without one."""
    if source.made is not None:
        write_ply(run.simplified_ply, source.made)
        return run.simplified_ply
    return source.mesh


def size_note(
    capture: Path, source: Source, mesh: Path | None, world_from_source: np.ndarray
) -> Problem | None:
    """A warning where the room can't have the size that it has, by its mesh or else by the solve's points.

    Args:
        mesh: the capture's mesh file, if it has one.
        world_from_source: (4, 4) similarity.
    """
    points = source.vertices
    if points is None:
        try:
            points = read_mesh(mesh)[0] if mesh is not None else read_points(capture, source.rig.source)
        except FiptError:  # told where it is used, or the format has no points
            return None
    slack = MEASURED if source.is_fused else 1.0
    if not len(points):
        return None
    return judge_size(transform_points(world_from_source, points), slack)


def _with_names(rig: Rig, options: CaptureOptions) -> Rig:
    """The rig with a layer and a color space named for its photographs."""
    named = partial(replace, layer=options.layer, colorspace=options.colorspace)
    depths = (replace(depth, photograph=depth.photograph and named(depth.photograph)) for depth in rig.depths)
    return replace(rig, views=tuple(map(named, rig.views)), depths=tuple(depths))


def _mesh(rig: Rig, options: CaptureOptions) -> Path | None:
    if options.mesh is not None and not options.mesh.is_file():
        raise FiptError("mesh-missing.read-mesh", path=options.mesh)
    mesh = options.mesh or rig.mesh
    if mesh is not None and (error := stand_in(mesh)) is not None:
        raise error
    return None if mesh is None else mesh.absolute()


def fewer_triangles(vertices: np.ndarray, triangles: np.ndarray, most: int) -> FusedMesh:
    """A mesh with at most about so many triangles; all of them with 0."""
    if not 0 < most < len(triangles):
        return FusedMesh(vertices.astype(np.float32), triangles.astype(np.int32))
    # Formats with a vertex for each face corner would fall apart into single triangles.
    welded, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[triangles]
    fewer = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)].astype(np.int32)
    if len(fewer) > most:
        welded, fewer = collapsed(welded, fewer, most)
    return FusedMesh(welded.astype(np.float32), fewer)
