"""Errors of the light of lamps: on a scan, and of lamps that photographs hardly show.

Positions on a scan are known to the width of an edge only. Close to a lamp, light falls off steeply, and a
centimetre decides whether an object beside the lamp occludes it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ..optics.lights import LUMINANCE
from ..pixels.camera_rays import rays_along
from ..pixels.grouped import rows_of_groups
from ..pixels.store import PixelStore
from ..surface.room import Room
from .emitters import Fixture, fixture_of, pixels_on

# Points on a lamp, and lamps, the brightest first.
SAMPLES, MAX_LAMPS = 8, 6
# Number of neighbouring points over which a variance is averaged, because there are few moves.
NEIGHBOURS = 27
# Lamps are not closer than this, metres.
CLOSEST = 0.02
# A lamp with fewer pure pixels is hardly seen. The bulb of the example room has 16 at
# 128 x 72 pixels, and its light is right; of the inside of its shade, which ten views show without the
# bulb, there are 3.
MIN_PURE = 10


def hardly_seen(lamps: Sequence[Fixture], pixels: PixelStore, triangles: int) -> list[tuple[int, int, float]]:
    """Number of each lamp that photographs hardly show, how many pixels see it, and the relative standard
    deviation of the radiance that they show, which is taken to be constant.

    Args:
        triangles: how many the room has.
    """
    lamp_of = fixture_of(lamps, triangles)
    on_lamps = pixels_on(pixels, lamp_of >= 0)  # few, in one pass over all pixels
    shown_by = rows_of_groups(lamp_of[pixels.triangle[on_lamps]], len(lamps))
    found = []
    for index, place in enumerate(shown_by):
        rows = on_lamps[place]
        if np.count_nonzero(pixels.pure[rows]) >= MIN_PURE:
            continue
        weight = np.asarray(pixels.weight[rows], np.float64)
        shown = np.asarray(pixels.own[rows]) @ LUMINANCE
        mean = (weight @ shown) / max(float(weight.sum()), 1e-12)
        variance = (weight @ (shown - mean) ** 2) / max(float(weight.sum()), 1e-12)
        spread = float(np.sqrt(variance)) / mean if mean > 0.0 else 1.0
        found.append((index, len(rows), min(spread, 1.0)))
    return found


def power_errors(
    room: Room,
    lamps: Sequence[Fixture],
    doubted: Sequence[tuple[int, int, float]],
    surface: tuple[np.ndarray, np.ndarray],
    seed: int,
) -> np.ndarray:
    """(N,) standard errors of L_d at surface points by the spread of the radiance of lamps hardly seen.

    Args:
        doubted: of :func:`hardly_seen`.
        surface: (N, 3) points, metres, and (N, 3) unit normals on the seen side.
    """
    rng = np.random.default_rng([seed, 29])
    variance = np.zeros(len(surface[0]))
    for index, _, spread in doubted:
        chosen = _sample(room, lamps[index], rng)
        variance += (spread * _received(room, lamps[index], chosen, np.zeros(3), *surface)) ** 2
    return np.sqrt(variance)


def light_errors(
    room: Room, lamps: Sequence[Fixture], surface: tuple[np.ndarray, np.ndarray], doubt: float, seed: int
) -> np.ndarray:
    """(N,) standard errors of L_d at surface points, in the units of the lamps' radiance.

    The variance is the mean over moves along the axes (an unscented transform of a normal distribution).

    Args:
        surface: (N, 3) points, metres, and (N, 3) unit normals on the seen side.
        doubt: standard deviation of a lamp's position along each axis, metres.
    """
    points, normals = surface
    moves = doubt * np.sqrt(3.0) * np.concatenate([np.eye(3), -np.eye(3)])
    rng = np.random.default_rng([seed, 23])
    brightest = sorted(lamps, key=lambda lamp: -lamp.area * float((lamp.radiance + lamp.back_radiance).sum()))
    variance = np.zeros(len(points))
    for lamp in brightest[:MAX_LAMPS]:
        chosen = _sample(room, lamp, rng)
        received = [_received(room, lamp, chosen, move, points, normals) for move in moves]
        variance += np.var(received, axis=0)
    around = cKDTree(points).query(points, min(NEIGHBOURS, len(points)))[1].reshape(len(points), -1)
    return np.asarray(np.sqrt(variance[around].mean(axis=1)))


def _sample(room: Room, lamp: Fixture, rng: np.random.Generator) -> np.ndarray:
    """(SAMPLES,) of its triangles, drawn by area."""
    area = np.maximum(room.areas[lamp.triangles], 1e-12)
    return np.asarray(lamp.triangles[rng.choice(len(area), SAMPLES, p=area / area.sum())])


def _received(
    room: Room, lamp: Fixture, chosen: np.ndarray, move: np.ndarray, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """(N,) L_d (irradiance over pi) by a lamp that is moved; its own triangles do not occlude it.

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
