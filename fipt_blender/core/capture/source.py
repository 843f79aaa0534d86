# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture as it is read, and where its mesh comes from: a file, fewer of its triangles, or depth images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..conventions import transform_points
from ..depth.extraction import FusedMesh
from ..depth.ply import write_ply
from ..depth.simplification import collapsed
from ..run.errors import FiptError
from ..run.messages import Reporter
from ..run.runfolder import RunFolder
from .checks import judge_size
from .color_camera import with_color_camera
from .depth_images import Fusion, checked_depths
from .formats.registry import read_points, read_rig
from .mesh_file import read_mesh
from .options import CaptureOptions
from .rig import Note, Rig

# Depth images are measured in metres, and often show a part of a room: only their unit can be wrong, which is
# 1, 0.25 or 0.2 mm, so that sizes within this factor are plausible.
MEASURED = 3.0


@dataclass(frozen=True)
class Source:
    """A capture as it was read, and where its mesh comes from.

    Attributes:
        rig: cameras and images.
        mesh: the mesh file; None without one.
        simplified: the same with fewer triangles, which is used instead; None where that is not wanted.
    """

    rig: Rig
    mesh: Path | None
    simplified: FusedMesh | None


def read_source(capture: Path, options: CaptureOptions, reporter: Reporter) -> Source:
    """Read cameras and mesh, and warn of what the user should know of them.

    Raises:
        FiptError: those of the readers, ``mesh-missing``.
    """
    rig = _with_layer(read_rig(capture, options.format, options), options.layer)
    mesh = _mesh(rig, options)
    rig = replace(rig, depths=checked_depths(rig.depths))
    if rig.one_camera:
        rig = with_color_camera(rig, options.scale)
    notes = list(rig.notes)
    simplified, budget = None, options.triangles
    if budget and mesh is not None and (fewer := simplified_mesh(mesh, budget)) is not None:
        simplified = fewer[0]
        notes.append(fewer[1])
    for note in notes:
        reporter.warning(note.code, note.text, note.remedy)
    return Source(rig, mesh, simplified)


def mesh_fusion(run: RunFolder, source: Source, options: CaptureOptions) -> Fusion | None:
    """What fuses the mesh of depth images; None where there is another one, or no depths."""
    if source.mesh is None and source.rig.depths:
        return Fusion(run, source.rig.depths, options.fusion, options.scale)
    return None


def write_mesh(run: RunFolder, source: Source, fusion: Fusion | None, fused: FusedMesh | None) -> Path | None:
    """The mesh file of the capture, written where it was made here; None without a mesh.

    Args:
        fused: by `fusion`, None where the mesh of an earlier start is kept.
    """
    if fusion is not None:
        return run.fused_ply if fused is None else fusion.keep(fused)
    if source.simplified is not None:
        write_ply(run.simplified_ply, source.simplified)
        return run.simplified_ply
    return source.mesh


def size_note(capture: Path, source: Source, mesh: Path | None, world_from_source: np.ndarray) -> Note | None:
    """A warning where the room can't have the size that it has, by its mesh or else by the solve's points.

    Args:
        mesh: the capture's mesh file, if it has one.
        world_from_source: (4, 4) similarity.
    """
    try:
        points = read_mesh(mesh)[0] if mesh is not None else read_points(capture, source.rig.source)
    except FiptError:  # told where it is used, or the format has no points
        return None
    slack = MEASURED if source.mesh is None and source.rig.depths else 1.0
    return judge_size(transform_points(world_from_source, points), slack) if len(points) else None


def _with_layer(rig: Rig, layer: str) -> Rig:
    """The rig with a layer named for its photographs."""
    named = partial(replace, layer=layer)
    depths = (replace(depth, photograph=depth.photograph and named(depth.photograph)) for depth in rig.depths)
    return replace(rig, views=tuple(map(named, rig.views)), depths=tuple(depths))


def _mesh(rig: Rig, options: CaptureOptions) -> Path | None:
    if options.mesh is None:
        return None if rig.mesh is None else rig.mesh.absolute()
    if not options.mesh.is_file():
        raise FiptError("mesh-missing", f"The mesh {options.mesh} does not exist.", "Correct the path.")
    return options.mesh.absolute()


def simplified_mesh(path: Path, triangles: int) -> tuple[FusedMesh, Note] | None:
    """The mesh of a file with at most about `triangles` triangles; None where it has no more.

    Raises:
        FiptError: one of `read_mesh`.
    """
    vertices, faces = read_mesh(path)
    if len(faces) <= triangles:
        return None
    # Formats with a vertex for each face corner would fall apart into single triangles.
    welded, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    fewer = faces.astype(np.int32)
    if len(fewer) > triangles:
        welded, fewer = collapsed(welded, fewer, triangles)
    text = f"The mesh {path} was simplified from {len(faces):,} to {len(fewer):,} triangles."
    remedy = "Its material slots, colors and UVs are not kept. Set the triangles to 0 to use the mesh itself."
    return FusedMesh(welded.astype(np.float32), fewer), Note("mesh-simplified", text, remedy)
