# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What emits as a whole in the search for emitters: a triangle of a modelled room, a part or patch of a scan.

A triangle of a scan is smaller than a pixel, and the light that falls on it is known less well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..scene.adjacency import Scan
from ..scene.grouped import numbered
from ..scene.labels import Parts, room_pieces
from ..scene.pixels import PixelStore
from ..scene.room import Room

# Least relative residual of a surface that emits: the share of its radiance that reflection can't explain.
LEAST_RESIDUAL = 0.3
# The same on a scan: its shadings are wrong by up to a factor of two, most of all close to lamps.
LEAST_RESIDUAL_SCAN = 0.5
# Light that is only inferred comes from infinity. A lamp that nobody saw, close to a surface, makes it
# brighter than that by about so much.
UNSEEN_DOUBT = 2.0
# Edge of the patches of a scan without part masks, in pixel widths.
PATCH = 2.0


@dataclass(frozen=True)
class EmitterSurfaces:
    """The surfaces that emit as a whole, for a mesh of T triangles.

    Attributes:
        unit: (T,) int64 surface of each triangle, from 0.
        component: (T,) int of larger surfaces, from 0: what no pixel judged emits if most around it does.
        least_residual: share of its radiance that reflection must leave unexplained.
        footprint: median width of a pixel on the surfaces, metres.
        reach: number of pixels by which the surface that a pixel shows may be beside the one that it hits.
    """

    unit: np.ndarray
    component: np.ndarray
    least_residual: float
    footprint: float
    reach: int = 0

    @cached_property
    def single(self) -> bool:
        """Whether every triangle is a surface of its own."""
        return int(self.unit.max(initial=-1)) + 1 == len(self.unit)

    def most(self, chosen: np.ndarray, pixels: PixelStore) -> np.ndarray:
        """(T,) bool, triangles of surfaces of which most pixels see one of those chosen ((T,) bool)."""
        if self.single:
            return chosen
        count = np.zeros(len(chosen))
        for index in range(len(pixels.views)):
            triangle = np.asarray(pixels.triangle[pixels.rows(index)])
            count += np.bincount(triangle[triangle >= 0], minlength=len(chosen))
        share = np.bincount(self.unit, count * chosen) / np.maximum(np.bincount(self.unit, count), 1.0)
        result: np.ndarray = (share > 0.5)[self.unit]
        return result


def emitter_surfaces(
    room: Room, parts: Parts, footprint: float, unseen_light: float = 0.0
) -> EmitterSurfaces:
    """Triangles of a modelled room; of a scan its parts or, where they are unknown, patches of its segments.

    Args:
        footprint: median width of a pixel on the surfaces, metres.
        unseen_light: share of the light on the surfaces that is only inferred.
    """
    pieces = room_pieces(room)
    least = LEAST_RESIDUAL if room.scan is None else LEAST_RESIDUAL_SCAN
    least += (1.0 - least) * (1.0 - UNSEEN_DOUBT**-unseen_light)
    if room.scan is None:
        # Photographs see most of a lamp shade's outside and little of its inside, which may be one piece.
        component = numbered([pieces, parts.triangle_part]) if parts.kind == "part" else pieces
        return EmitterSurfaces(np.arange(len(room.triangles)), component, least, footprint)
    # Detail finer than an edge is lost: rims of thin things face sideways, and pixels show what is beside.
    reach = round(room.scan.edge / max(footprint, 1e-9))
    patch = surface_patches(room.scan, pieces, PATCH * footprint)
    if parts.kind == "part":
        known = parts.triangle_part >= 0
        patch = numbered([known, np.where(known, parts.triangle_part, patch)])
        return EmitterSurfaces(patch, patch, least, footprint, reach)
    return EmitterSurfaces(patch, pieces, least, footprint, reach)


def surface_patches(scan: Scan, pieces: np.ndarray, edge: float) -> np.ndarray:
    """(T,) int64 patch of each triangle of a scan: a piece of the mesh in a cube, on one of six sides.

    Args:
        pieces: (T,) int. edge: of the cubes, metres.
    """
    cross, centers = scan.cross, scan.centers
    axis = np.abs(cross).argmax(axis=1)
    side = 2 * axis + (cross[np.arange(len(cross)), axis] < 0.0)
    cube = np.floor((centers - centers.min(axis=0)) / max(edge, 1e-9)).astype(np.int64)
    return numbered([pieces, side, *cube.T])
