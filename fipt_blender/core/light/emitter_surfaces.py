# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The units of the search for emitters: triangles of a modelled room, parts or patches of a scan.

A triangle of a scan is smaller than a pixel, and the light that falls on it is known less well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parts.labels import Parts, room_pieces
from ..pixels.grouped import numbered
from ..surface.room import Room
from ..surface.scan import Scan
from .cache import side_index
from .environment import Environment

# Width of the patches of a scan without part masks, in pixel widths, and largest distance between the centers
# of adjacent patches of one lamp, in widths of a patch.
PATCH, GAP = 2.0, 2.5
# Relative errors of the shadings of a modelled room and of a scan.
SHADING_ERROR, SCAN_ERROR = 0.15, 0.2
# Most independent samples that the pixels of a lamp count as: they share errors of the shadings.
MAX_SAMPLES, MAX_SAMPLES_SCAN = 50.0, 10.0
SPREAD = 0.03  # deviation of radiance over light on one surface of a modelled room, by errors of the light


@dataclass(frozen=True)
class EmitterSurfaces:
    """The units that emit as a whole or not at all, for a mesh of T triangles.

    Attributes:
        unit: (T,) int64 surface of each triangle, from 0.
        component: (T,) int larger surface, from 0; triangles that no pixel judged get the mean of theirs.
        part: (T,) int part of each triangle, negative for none; None where parts are unknown.
        reach: largest distance in pixels between the surface that a pixel shows and the one that it hits.
        gap: metres between the centers of units of one lamp at most; 0 where units are triangles.
        unseen: (T,) share of the directions in which lamps may be that nothing shows, too close for
            :mod:`.unseen_light`; None for none.
        light_error: standard deviation of the logarithm of the light, because some of it is inferred.
        shading_error: relative error of the shadings.
        most_samples: independent ones that the pixels of a lamp count as, at most.
        spread: least deviation of the logarithm of radiance over light on one surface.
        place: metres to which positions of a lamp and of what it lights are known; 0 where they are exact.
    """

    unit: np.ndarray
    component: np.ndarray
    part: np.ndarray | None
    reach: int = 0
    gap: float = 0.0
    unseen: np.ndarray | None = None
    light_error: float = 0.0
    shading_error: float = SHADING_ERROR
    most_samples: float = MAX_SAMPLES
    spread: float = SPREAD
    place: float = 0.0


def emitter_surfaces(
    room: Room, parts: Parts, footprint: float, environment: Environment | None = None
) -> EmitterSurfaces:
    """Triangles of a modelled room; of a scan its parts or, where they are unknown, patches of its segments.

    Args:
        footprint: median width of a pixel on the surfaces, metres.
        environment: with the light that is inferred; None without any.
    """
    pieces = room_pieces(room)
    part = parts.triangle_part if parts.kind == "part" else None
    unseen, light_error = (
        (None, 0.0) if environment is None else (environment.unseen, environment.unseen_error)
    )
    if room.scan is None:
        # Photographs see most of a lamp shade's outside and little of its inside, which may be one piece.
        component = pieces if part is None else numbered([pieces, part])
        units = np.arange(len(room.triangles))
        return EmitterSurfaces(units, component, part, unseen=unseen, light_error=light_error)
    # Detail finer than an edge is lost: rims of thin things face sideways, but pixels show their tops.
    reach = round(room.scan.edge / max(footprint, 1e-9))
    patch, gap = surface_patches(room.scan, pieces, PATCH * footprint), GAP * PATCH * footprint
    component = pieces
    if part is not None:
        patch = component = numbered([part >= 0, np.where(part >= 0, part, patch)])
    errors = SCAN_ERROR, MAX_SAMPLES_SCAN, SCAN_ERROR, room.scan.edge
    return EmitterSurfaces(patch, component, part, reach, gap, unseen, light_error, *errors)


def surface_patches(scan: Scan, pieces: np.ndarray, edge: float) -> np.ndarray:
    """(T,) int64 patch of each triangle of a scan: a piece of the mesh in a cube, on one of six sides.

    Args:
        pieces: (T,) int. edge: of the cubes, metres.
    """
    cube = np.floor((scan.centers - scan.centers.min(axis=0)) / max(edge, 1e-9)).astype(np.int64)
    return numbered([pieces, side_index(scan.cross), *cube.T])
