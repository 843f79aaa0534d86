"""What the engine makes of a run's scan, as an estimation makes it, written to results/scan.npz."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fipt_blender.core.capture.views import View
from fipt_blender.core.completion.panes import Completion, find_lacking
from fipt_blender.core.estimate.room_stages import room_so_far, scan_so_far
from fipt_blender.core.parts.outlines import outline_parts
from fipt_blender.core.run.messages import Progress, unwatched
from fipt_blender.core.run.run_files import AddedSurfaces, Geometry, read_exported, scan_arrays, with_added
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.stage_settings import CompletionSettings, OutlineSettings, ScanSettings
from fipt_blender.core.run.store import write_arrays
from fipt_blender.core.surface.cleaning import Holes, clean_room
from fipt_blender.core.surface.room import Room, load_room


def clean_run(run: RunFolder, clean: bool = True, most_edges: int = 0) -> Holes | None:
    """Clean the run's room, and close its small holes; returns these."""
    mesh = read_exported(run)
    made = clean_room(mesh, settings=ScanSettings(clean, most_edges))
    _write(run, scan_so_far(mesh, made.cleaned, made.closing))
    return made.holes


def complete_run(
    run: RunFolder,
    views: Sequence[View],
    settings: CompletionSettings | None = None,
    most_edges: int = 0,
    outlines: bool = False,
    progress: Progress = unwatched,
) -> Room:
    """The run's room, cleaned, with what it lacks, and with outlines where wanted."""
    mesh = read_exported(run)
    made = clean_room(mesh, settings=ScanSettings(close_holes_edges=most_edges))
    room = room_so_far(mesh, scan_so_far(mesh, made.cleaned, made.closing))
    found, outlined = Completion(), None
    if settings is not None:
        found = find_lacking(mesh, room, views, run.linked, settings, progress)
    if outlines:
        outlined = outline_parts(room, views, settings=OutlineSettings())
    _write(run, scan_so_far(mesh, made.cleaned, made.closing, found.panes, found.plane, outlined))
    return load_room(run)


def with_panes(run: RunFolder, closing: AddedSurfaces | None = None, higher: float = 0.0) -> np.ndarray:
    """Put a quad into the run as the engine puts panes into holes of a scan, which this room need not be, and
    perhaps what closes holes; the cleaned copy may lie higher. Returns its vertices."""
    vertices = np.array([[0, 0, 3], [1, 0, 3], [1, 1, 3], [0, 1, 3]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (2, 3, 1))
    panes, room = AddedSurfaces(vertices, triangles, normals), read_exported(run)
    whole = with_added(room, closing, panes)
    region = np.full(len(whole.triangles), -1, np.int32)
    cleaned = Geometry(whole.vertices + np.float32([0, 0, higher]), whole.corner_normals, region, 0.01)
    write_arrays(run.scan_npz, scan_arrays(room, closing, panes, cleaned))
    return vertices


def _write(run: RunFolder, scan) -> None:
    run.scan_npz.unlink(missing_ok=True)
    if scan is not None:
        write_arrays(run.scan_npz, scan)
