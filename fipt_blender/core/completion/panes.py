"""Surfaces that are added to a scan: panes in its flat holes, prisms for things that it lost, and completions
of parts that it tore.

A flat hole is closed if photographs show neither the room nor anything bright through it: it is a window at
night, a mirror or a glossy black surface, which scanners do not see. The pane is an object of its own, whose
material is estimated like any other. A bright hole shows the outside and stays open: the environment lights
the room through it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

import numpy as np

from ..capture.views import View
from ..checks.agreement import compared_pixels
from ..optics.lights import LUMINANCE
from ..parts.labels import choose_source
from ..parts.linked_masks import link_masks, with_masks
from ..parts.masked_views import masked_views
from ..pixels.camera_rays import first_hits, trace_pixels
from ..robust import LEAST_VIEWS
from ..run.messages import Progress, unwatched, within
from ..run.run_files import PANES, AddedSurfaces, RoomMesh
from ..run.stage_settings import CompletionSettings
from ..surface.adjacency import NONE, Surface, make_mesh
from ..surface.holes import FlatHole, flat_holes, median_edge
from ..surface.room import Room
from .lost_surfaces import lost_surfaces
from .torn_parts import torn_parts, torn_round_things

# At least so many of the pixels that look into a hole, and this share of them, must meet no surface behind.
LEAST_PIXELS, LEAST_MISSED = 100, 0.5
# A hole that is brighter than this multiple of the photographs' median shows the outside.
OUTSIDE = 2.0


@dataclass(frozen=True, eq=False)
class Completion:
    """What a scan lacks.

    Attributes:
        panes: the surfaces; None without any.
        plane: (T,) int32 plane of each of their triangles, `NONE` without one.
        linked: masks by `link_masks` on the room with them, names of files in the search's folder by those of
            views; None where these have not been linked.
    """

    panes: AddedSurfaces | None = None
    plane: np.ndarray | None = None
    linked: Mapping[str, str] | None = None


def find_lacking(
    mesh: RoomMesh,
    room: Room,
    views: Sequence[View],
    folder: Path,
    settings: CompletionSettings,
    progress: Progress = unwatched,
) -> Completion:
    """Surfaces that photographs show and a scan lacks.

    None where the mesh is no scan, where it has panes already or the artist has completed it. Mitsuba's
    variant must be set.

    Args:
        mesh: the room as Blender has written it.
        room: of it, cleaned, with its holes closed.
        views: training views.
        folder: for linked masks.
        settings: which kinds of surfaces are looked for.
    """
    if room.plane is None or mesh.completed or PANES in mesh.object_ids:
        return Completion()
    rows = np.arange(len(room.triangles)) if room.exact is None else np.flatnonzero(~room.exact)
    surface, _ = make_mesh(room.vertices, room.triangles[rows])
    edge = median_edge(surface)
    holes = flat_holes(surface, edge) if settings.panes else []
    looks = _looks(room, holes, views, within(progress, 0.0, 0.25))
    closed = [hole for hole, seen in zip(holes, looks, strict=True) if seen]
    added = [_panes(closed)] if closed else []
    whole = _with(room, added[0]) if added else room
    things, linked = _things(whole, views, folder, edge, settings, within(progress, 0.25, 1.0))
    added += things
    if not added:
        return Completion(linked=linked)
    vertices, triangles, normals, plane = reduce(_joined, added)
    first = int(room.plane.max(initial=-1)) + 1
    plane = np.where(plane == NONE, NONE, first + plane).astype(np.int32)
    return Completion(AddedSurfaces(vertices, triangles, normals), plane, linked)


def _things(
    room: Room,
    views: Sequence[View],
    folder: Path,
    edge: float,
    settings: CompletionSettings,
    progress: Progress,
) -> tuple[list[Surface], dict[str, str] | None]:
    """Surfaces that the scan lacks: lost things, from the photographs, then torn parts, from masks or these.

    Lost things come first, because linked masks would assign them to the surface behind them. The second
    value is `Completion.linked`.
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
        return found, None
    for surface in found:
        room = _with(room, surface)
    files = link_masks(room, views, folder)
    looking, label = masked_views(room, with_masks(views, files))
    torn = torn_parts(room, label, looking, edge, within(progress, 0.8, 1.0)) if settings.torn_parts else []
    linked = {name: path.relative_to(folder).as_posix() for name, path in files.items()}
    return found + torn, None if torn else linked


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
