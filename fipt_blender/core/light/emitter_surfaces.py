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


@dataclass(frozen=True)
class EmitterSurfaces:
    """The units that emit as a whole or not at all, for a mesh of T triangles.

    Attributes:
        unit: (T,) int64 surface of each triangle, from 0.
        component: (T,) int larger surface, from 0; triangles that no pixel judged get the mean of theirs.
        part: (T,) int part of each triangle, negative for none; None where parts are unknown.
        reach: largest distance in pixels between the surface that a pixel shows and the one that it hits.
        gap: metres between the centers of units of one lamp at most, on a scan.
        light_error: standard deviation of the logarithm of the light, because some of it is inferred.
    """

    unit: np.ndarray
    component: np.ndarray
    part: np.ndarray | None
    reach: int = 0
    gap: float = 0.0
    light_error: float = 0.0


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
    error = 0.0 if environment is None else environment.unseen_error
    if room.scan is None:
        # Photographs see most of a lamp shade's outside and little of its inside, which may be one piece.
        component = pieces if part is None else numbered([pieces, part])
        return EmitterSurfaces(np.arange(len(room.triangles)), component, part, light_error=error)
    # Detail finer than an edge is lost: rims of thin things face sideways, but pixels show their tops.
    reach = round(room.scan.edge / max(footprint, 1e-9))
    patch, gap = surface_patches(room.scan, pieces, PATCH * footprint), GAP * PATCH * footprint
    if part is None:
        return EmitterSurfaces(patch, pieces, None, reach, gap, error)
    patch = numbered([part >= 0, np.where(part >= 0, part, patch)])
    return EmitterSurfaces(patch, patch, part, reach, gap, error)


def surface_patches(scan: Scan, pieces: np.ndarray, edge: float) -> np.ndarray:
    """(T,) int64 patch of each triangle of a scan: a piece of the mesh in a cube, on one of six sides.

    Args:
        pieces: (T,) int. edge: of the cubes, metres.
    """
    cube = np.floor((scan.centers - scan.centers.min(axis=0)) / max(edge, 1e-9)).astype(np.int64)
    return numbered([pieces, side_index(scan.cross), *cube.T])
