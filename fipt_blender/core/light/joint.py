# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitters from an emission that was fitted jointly with the materials: the paper's ablation "Joint L_e opt."
(Sec. 5.4), which the product itself never uses.

These emitters also reflect: photographs show L_r + L_e, and much of the room has some L_e. Black emitters
would make half of the room black.
"""

from __future__ import annotations

import numpy as np

from ..geometry.adjacency import weld
from ..optics.lights import LUMINANCE
from ..scene.room import Room
from .emitters import Fixture, emitter_components


def joint_fixtures(room: Room, emission: np.ndarray, threshold: float) -> list[Fixture]:
    """Fixtures of the triangles whose emission exceeds the threshold, with that emission.

    Args:
        emission: (T, 3) mean L_e of each triangle in units of the capture's median.
        threshold: of its luminance, in the same units.
    """
    brightness = emission @ LUMINANCE
    ids = np.flatnonzero((brightness > threshold) & (room.areas > 0.0))
    if not len(ids):
        return []
    corners = weld(room.vertices)[room.triangles[ids]]
    group = emitter_components(corners, brightness[ids], np.ones(len(ids), bool))
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    fixtures = []
    for members in np.split(ids[order], starts[1:]):
        area = room.areas[members]
        radiance = np.average(emission[members], axis=0, weights=area)
        middle = room.vertices[room.triangles[members]].mean(axis=1)
        centroid = np.average(middle, axis=0, weights=area)
        # The fit does not distinguish the sides.
        fixtures.append(Fixture(members, radiance, radiance, float(area.sum()), centroid, reflective=True))
    return fixtures
