# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that are added to a scan: panes in its flat holes, prisms for things that it lost, and completions
of parts that it tore.

A flat hole is closed if photographs show neither the room nor anything bright through it: it is a window at
night, a mirror or a glossy black surface, which scanners do not see. The pane is an object of its own, whose
material is estimated like any other. A bright hole shows the outside and stays open: the environment lights
the room through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from ..capture.views import View
from ..checks.agreement import compared_pixels
from ..optics.lights import LUMINANCE
from ..parts.labels import choose_source, masks_digest
from ..parts.linked_masks import link_masks
from ..parts.masked_views import masked_views
from ..pixels.camera_rays import first_hits, trace_pixels
from ..robust import LEAST_VIEWS
from ..run.messages import Progress, unwatched, within
from ..run.run_files import (
    PANES,
    AddedSurfaces,
    mesh_digest,
    read_geometry,
    read_made,
    read_room,
)
from ..run.runfolder import RunFolder, explained_write_errors
from ..run.stage_settings import RoomSettings
from ..run.store import optional_arrays, write_arrays
from ..surface.adjacency import NONE, Surface, make_mesh
from ..surface.clean import CleanMesh
from ..surface.holes import FlatHole, flat_holes, median_edge
from ..surface.room import Room, load_room
from ..surface.stored import prepare_geometry, scanned, store_geometry
from .lost_surfaces import lost_surfaces
from .torn_parts import torn_parts, torn_round_things

# At least so many of the pixels that look into a hole, and this share of them, must meet no surface behind.
LEAST_PIXELS, LEAST_MISSED = 100, 0.5
# A hole that is brighter than this multiple of the photographs' median shows the outside.
OUTSIDE = 2.0
# The settings that switch the kinds of surfaces on.
KINDS = ("panes", "lost_surfaces", "torn_parts")


def close_holes(
    run: RunFolder,
    views: Sequence[View],
    settings: RoomSettings | None = None,
    room: Room | None = None,
    progress: Progress = unwatched,
) -> bool:
    """Write panes.npz, and extend geometry.npz, where photographs show surfaces that a scan lacks.

    Nothing changes where the mesh is no scan, where it has panes already or the artist has completed it, or
    where these masks were searched before. Mitsuba's variant must be set.

    Args:
        views: training views.
        settings: which kinds of surfaces are looked for; None: all.
        room: the run's, without outlines; read where None.

    Returns:
        whether the run's room has other surfaces now.

    Raises:
        FiptError: those of the readers of room and photographs, ``disk-full`` or ``run-unwritable``.
    """
    settings = settings or RoomSettings()
    if not run.geometry_npz.exists():
        run.panes_npz.unlink(missing_ok=True)
        return False
    changed = False
    kinds = [bool(getattr(settings, kind)) for kind in KINDS]
    searched = optional_arrays(run.panes_npz, AddedSurfaces)
    if searched is not None and (searched.kinds is None or searched.kinds.tolist() != kinds):
        run.panes_npz.unlink()
        prepare_geometry(run, settings.clean_scan, settings.close_holes_edges)
        room, changed = None, True  # it may have had them
    stored = read_room(run)
    if stored.completed or PANES in stored.object_ids:
        return changed
    cleaned = read_geometry(run, stored)
    use_masks = stored.parts in ("auto", "masks")
    masks = masks_digest(views, (view.part_ids() for view in views if use_masks))
    made = read_made(run.panes_npz, AddedSurfaces, mesh_digest(stored))
    found_nothing = made is not None and made.masks is not None and np.array_equal(made.masks, masks)
    if cleaned is None or found_nothing:
        return changed
    mesh, _ = make_mesh(cleaned.vertices, stored.triangles[scanned(stored)])
    edge = median_edge(mesh)
    holes = flat_holes(mesh, edge) if settings.panes else []
    room = room or load_room(run, outlined=False)
    looks = _looks(room, holes, views, within(progress, 0.0, 0.25))
    closed = [hole for hole, seen in zip(holes, looks, strict=True) if seen]
    added = _panes(closed) if closed else None
    whole = room if added is None else _with(room, added)
    for surface in _things(run, whole, views, edge, settings, within(progress, 0.25, 1.0)):
        added = surface if added is None else _joined(added, surface)
    nothing = np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3, 3)), np.zeros(0, np.int32)
    vertices, triangles, normals, plane = nothing if added is None else added
    with explained_write_errors(run.root):
        source, searched_for = mesh_digest(stored), np.array(kinds)
        panes = AddedSurfaces(vertices, triangles, normals, source, masks=masks, kinds=searched_for)
        write_arrays(run.panes_npz, panes)
        if added is None:
            return changed
        plane = np.where(plane == NONE, NONE, int(cleaned.plane.max(initial=-1)) + 1 + plane)
        extended = CleanMesh(
            np.concatenate([cleaned.vertices, vertices]),
            np.concatenate([cleaned.corner_normals, normals]),
            np.concatenate([cleaned.plane, plane.astype(np.int32)]),
            float(cleaned.noise),
        )
        store_geometry(run, read_room(run), extended)
    return True


def _things(
    run: RunFolder,
    room: Room,
    views: Sequence[View],
    edge: float,
    settings: RoomSettings,
    progress: Progress,
) -> list[Surface]:
    """Surfaces that the scan lacks: lost things, from the photographs, then torn parts, from masks or these.

    Lost things come first, because linked masks would assign them to the surface behind them.
    """
    found: list[Surface] = []
    masked = choose_source(room, views) == "masks"
    if len(views) >= LEAST_VIEWS and (settings.lost_surfaces or (settings.torn_parts and not masked)):
        pixels = compared_pixels(room, views, edge)
        if settings.lost_surfaces:
            found, pixels = lost_surfaces(room, pixels, within(progress, 0.1, 0.7))
        if settings.torn_parts and not masked:
            found += torn_round_things(room, pixels, edge)
    if not masked:
        return found
    for surface in found:
        room = _with(room, surface)
    looking, label = masked_views(room, link_masks(run, room, views))
    torn = settings.torn_parts
    return found + (torn_parts(room, label, looking, edge, within(progress, 0.8, 1.0)) if torn else [])


def _with(room: Room, surface: Surface) -> Room:
    """The room with one more object."""
    count = len(surface[1])
    joined = _joined((room.vertices, room.triangles, room.corner_normals, np.zeros(0)), surface)
    return replace(
        room,
        vertices=joined[0],
        triangles=joined[1],
        corner_normals=joined[2],
        triangle_object=np.append(room.triangle_object, np.full(count, len(room.objects), np.int32)),
        triangle_material=np.append(room.triangle_material, np.full(count, -1, np.int32)),
        plane=None if room.plane is None else np.append(room.plane, np.full(count, NONE, np.int32)),
        exact=None if room.exact is None else np.append(room.exact, np.zeros(count, bool)),
    )


def _joined(one: Surface, other: Surface) -> Surface:
    moved = other[1] + np.int32(len(one[0]))
    pairs = zip(one, (other[0], moved, *other[2:]), strict=True)
    vertices, triangles, normals, plane = (np.concatenate(pair) for pair in pairs)
    return vertices, triangles, normals, plane


def _panes(holes: Sequence[FlatHole]) -> Surface:
    """The panes of all holes, each with a plane of its own."""
    surfaces = []
    for number, hole in enumerate(holes):
        vertices, triangles = hole.pane()
        normals = np.tile(hole.axes[2].astype(np.float32), (len(triangles), 3, 1))
        surfaces.append((vertices, triangles, normals, np.full(len(triangles), number)))
    return reduce(_joined, surfaces)


def _looks(room: Room, holes: Sequence[FlatHole], views: Sequence[View], progress: Progress) -> list[bool]:
    """Whether the photographs show that each hole is a surface."""
    counts = [0] * len(holes)  # pixels that look into a hole, and luminance of those that meet no surface
    missed: list[list[np.ndarray]] = [[] for _ in holes]
    medians = []
    for number, view in enumerate(views if holes else ()):
        progress(number / len(views))
        luminance = view.radiance().reshape(-1, 3) @ LUMINANCE
        medians.append(np.median(luminance))
        reached = first_hits(trace_pixels(room, view))[1]
        origin, directions = view.camera_to_world[:3, 3], view.rays()[1]
        for index, hole in enumerate(holes):
            enters, distance = hole.crossed(origin, directions)
            enters &= reached > distance
            counts[index] += int(enters.sum())
            missed[index].append(luminance[enters & np.isinf(reached)])
    found = []
    for count, values in zip(counts, map(np.concatenate, missed), strict=True):
        enough = len(values) >= max(LEAST_PIXELS, LEAST_MISSED * count)
        found.append(enough and float(np.median(values)) < OUTSIDE * float(np.median(medians)))
    return found
