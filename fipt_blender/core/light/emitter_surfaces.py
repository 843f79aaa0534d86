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
# Relative errors: of the shadings of a modelled room and of a scan, and of radiance that was unmixed, beside
# its standard error, or that of photographs that are not HDR.
SHADING_ERROR, SCAN_ERROR, RADIANCE_ERROR = 0.15, 0.2, 0.3
# Most independent samples that the pixels of a lamp count as: they share errors of the shadings.
MAX_SAMPLES, MAX_SAMPLES_SCAN = 50.0, 10.0
# Deviation of radiance over light on one surface of an exact mesh, by noise and errors of the light. Clipped
# pixels are constant in any case.
SPREAD, CLIPPED_SPREAD = 0.03, 1e6
# Where inferred lamps are close, one is likelier than the surface that it lights by HIDDEN, in
# full from this share of the directions on.
MUCH_UNSEEN, HIDDEN = 0.1, 2.0


@dataclass(frozen=True)
class EmitterSurfaces:
    """The units that emit as a whole or not at all, for a mesh of T triangles.

    Attributes:
        unit: (T,) int64 surface of each triangle, from 0.
        component: (T,) int larger surface, from 0; triangles that no pixel judged get the mean of theirs.
        alike: (T,) int surface that has one radiance if it emits: part or presumed lamp; negative for none.
        unseen: (T,) share of the directions in which inferred lamps are close; 0 on presumed lamps, as what
            a hidden lamp lights is not of one radiance.
        error: relative standard error of the most that a surface reflects.
        spread: least deviation of the logarithm of radiance over light on one surface.
        max_samples: independent ones that the pixels of a lamp count as, at most.
        reach: largest distance in pixels between the surface that a pixel shows and the one that it hits.
        gap: metres between the centers of units of one lamp at most; 0 where units are triangles.
    """

    unit: np.ndarray
    component: np.ndarray
    alike: np.ndarray
    unseen: np.ndarray
    error: float = SHADING_ERROR
    spread: float = SPREAD
    max_samples: float = MAX_SAMPLES
    reach: int = 0
    gap: float = 0.0


def emitter_surfaces(
    room: Room,
    parts: Parts,
    footprint: float,
    environment: Environment | None = None,
    hdr: bool = True,
    presumed: np.ndarray | None = None,
) -> EmitterSurfaces:
    """Triangles of a modelled room; of a scan its parts or, where they are unknown, patches of its segments.

    Args:
        footprint: median width of a pixel on the surfaces, metres.
        environment: with the light that is inferred; None without any.
        hdr: whether all photographs are.
        presumed: (T,) bool, lamps by their radiance alone; None: none.
    """
    presumed = np.zeros(len(room.triangles), bool) if presumed is None else presumed
    pieces = room_pieces(room)
    known = parts.kind == "part"
    part = parts.triangle_part if known else np.full(len(pieces), -1)
    alike = part if known else np.where(presumed, pieces, -1)
    unseen, light_error = np.zeros(len(pieces)), 0.0
    if environment is not None and environment.unseen is not None:
        unseen, light_error = np.where(presumed, 0.0, environment.unseen), environment.unseen_error
    shading = SHADING_ERROR if room.scan is None else SCAN_ERROR
    error = float(np.sqrt(shading**2 + light_error**2 + (0.0 if hdr else RADIANCE_ERROR**2)))
    if room.scan is None:
        # Photographs see most of a lamp shade's outside and little of its inside, which may be one piece.
        component, unit = numbered([pieces, part]), np.arange(len(room.triangles))
        return EmitterSurfaces(unit, component, alike, unseen, error, SPREAD if hdr else CLIPPED_SPREAD)
    # Detail finer than an edge is lost: rims of thin things face sideways, but pixels show their tops.
    reach = round(room.scan.edge / max(footprint, 1e-9))
    patch, gap = surface_patches(room.scan, pieces, PATCH * footprint), GAP * PATCH * footprint
    unit = numbered([part >= 0, np.where(part >= 0, part, patch)])
    component, spread = unit if known else pieces, SCAN_ERROR if hdr else CLIPPED_SPREAD
    return EmitterSurfaces(unit, component, alike, unseen, error, spread, MAX_SAMPLES_SCAN, reach, gap)


def surface_patches(scan: Scan, pieces: np.ndarray, edge: float) -> np.ndarray:
    """(T,) int64 patch of each triangle of a scan: a piece of the mesh in a cube, on one of six sides.

    Args:
        pieces: (T,) int. edge: of the cubes, metres.
    """
    cube = np.floor((scan.centers - scan.centers.min(axis=0)) / max(edge, 1e-9)).astype(np.int64)
    return numbered([pieces, side_index(scan.cross), *cube.T])
