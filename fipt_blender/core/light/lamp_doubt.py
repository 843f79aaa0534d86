# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How wrong the light of lamps may be on a scan, whose places are known to the width of an edge only.

Close to a lamp, light falls off steeply, and what stands beside the lamp hides it or not by a centimetre.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ..scene.camera_rays import rays_along
from ..scene.room import Room
from .emitters import Fixture

# Standard deviations that count as the error: what the lamp lights beside it (its shade, the top of a table)
# has the same error and lights the surroundings, too. Calibrated on the example room, scanned at 2 cm.
DEVIATIONS = 3.0
# Points on a lamp, and lamps, the brightest first.
SAMPLES, MOST_LAMPS = 8, 6
# Points over which a variance is averaged, those around a point among them: moves are few.
NEIGHBOURS = 27
# Lamps are not closer than this, metres.
CLOSEST = 0.02


def light_errors(
    room: Room, lamps: Sequence[Fixture], surface: tuple[np.ndarray, np.ndarray], doubt: float, seed: int
) -> np.ndarray:
    """(N,) standard errors of L_d at surface points, in the units of the lamps' radiance.

    The variance is the mean over moves along the axes (an unscented transform of a normal distribution).

    Args:
        surface: (N, 3) points, metres, and (N, 3) unit normals on the seen side.
        doubt: standard deviation of a lamp's place along each axis, metres.
    """
    points, normals = surface
    moves = doubt * np.sqrt(3.0) * np.concatenate([np.eye(3), -np.eye(3)])
    rng = np.random.default_rng([seed, 23])
    brightest = sorted(lamps, key=lambda lamp: -lamp.area * float((lamp.radiance + lamp.back_radiance).sum()))
    variance = np.zeros(len(points))
    for lamp in brightest[:MOST_LAMPS]:
        triangles = lamp.triangles
        area = np.maximum(room.areas[triangles], 1e-12)
        chosen = triangles[rng.choice(len(triangles), SAMPLES, p=area / area.sum())]
        received = [_received(room, lamp, chosen, move, points, normals) for move in moves]
        variance += np.var(received, axis=0)
    around = cKDTree(points).query(points, min(NEIGHBOURS, len(points)))[1].reshape(len(points), -1)
    return np.asarray(DEVIATIONS * np.sqrt(variance[around].mean(axis=1)))


def _received(
    room: Room, lamp: Fixture, chosen: np.ndarray, move: np.ndarray, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """(N,) L_d (irradiance over pi) by a lamp that is moved; its own triangles do not hide it.

    Args:
        chosen: (S,) of its triangles, drawn by area.
    """
    corners = room.vertices[room.triangles[chosen]].astype(np.float64)
    places = corners.mean(axis=1) + move
    own = np.zeros(len(room.triangles) + 1, bool)
    own[lamp.triangles] = True
    start = points + room.offset * normals
    total = np.zeros(len(points))
    for place, normal in zip(places, room.normals[chosen], strict=True):
        toward = place - start
        distance = np.linalg.norm(toward, axis=1)
        direction = toward / np.maximum(distance, 1e-9)[:, None]
        leaving = -direction @ normal
        radiance = np.where(leaving > 0.0, lamp.radiance.mean(), lamp.back_radiance.mean())
        cosines = np.maximum((direction * normals).sum(axis=1), 0.0) * np.abs(leaving)
        surface = room.intersect(rays_along(start, direction))
        hit = np.where(np.array(surface.valid), np.array(surface.triangle), len(room.triangles))
        seen = own[hit] | (hit == len(room.triangles)) | (np.array(surface.distance) >= distance)
        total += np.where(seen, radiance * cosines / np.maximum(distance, CLOSEST) ** 2, 0.0)
    return total * lamp.area / (np.pi * len(places))
