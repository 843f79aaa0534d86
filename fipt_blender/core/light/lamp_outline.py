# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines of lamps on a scan, from the photographs.

Borders of part masks are off by about a pixel, and so is a lamp of small triangles: its area, and with it its
power, would be too large by several percent. In the photographs, radiance falls from that of the lamp to that
of its surroundings over the width of a pixel; the outline lies where it is halfway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from ..capture.views import View
from ..optics.lights import LUMINANCE
from ..scene.adjacency import Scan
from ..scene.components import graph_components
from ..scene.grouped import grouped_median
from ..scene.pixels import PixelStore

# Triangles within this many pixel widths of a lamp may belong to it.
REACH = 2.0
# A triangle belongs to the lamp if it shows more than this share of the lamp's radiance in the mean view.
INSIDE = 0.5
# A view counts if it sees the triangle's front at this cosine at least, ...
LEAST_COSINE = 0.2
# ... and its pixel there hits the mesh within this many pixel widths and median edges of the triangle.
NEAR_WIDTHS, NEAR_EDGES = 3.0, 1.0


@dataclass(frozen=True)
class _Candidates:
    """K triangles that may belong to a lamp.

    Attributes:
        triangle: (K,) int64. centers, normals: (K, 3) metres, unit.
        lamp: (K,) int64 connected piece of emitting triangles, from 0, that is nearest.
        edge: median edge of the mesh, metres.
    """

    triangle: np.ndarray
    centers: np.ndarray
    normals: np.ndarray
    lamp: np.ndarray
    edge: float


def outlined(scan: Scan, pixels: PixelStore, probability: np.ndarray, footprint: float) -> np.ndarray:
    """(T,) float32 probability that triangles emit, with the outlines of lamps that photographs show.

    Inside an outline it is that of the lamp, outside 1 minus that.

    Args:
        probability: (T,) without outlines; from 1/2 on, triangles emit.
        footprint: median width of a pixel on the surfaces, metres.
    """
    emits = probability > 0.5
    if not emits.any():
        return probability
    candidates, piece = _candidates(scan, emits, REACH * footprint)
    radiance = _piece_luminance(pixels, piece)
    total, weights = np.zeros((2, len(candidates.triangle)))
    for index, view in enumerate(pixels.views):
        rows = pixels.rows(index)
        hit = np.where(np.asarray(pixels.triangle[rows] >= 0)[:, None], pixels.position[rows], np.inf)
        place, weight = _seen(candidates, view, hit)
        image = (np.asarray(pixels.radiance[rows]) @ LUMINANCE).reshape(view.height, view.width)
        shown = map_coordinates(image, place[::-1] - 0.5, order=1, mode="nearest")
        total += weight * np.minimum(shown / np.maximum(radiance[candidates.lamp], 1e-12), 1.0)
        weights += weight
    known = (weights > 0.0) & (radiance[candidates.lamp] > 0.0)
    likely = np.zeros(len(radiance), np.float32)
    np.maximum.at(likely, piece[emits], probability[emits])
    inside = total > INSIDE * weights
    wrong = known & (inside != emits[candidates.triangle])
    of_lamp = likely[candidates.lamp]
    result = probability.copy()
    result[candidates.triangle[wrong]] = np.where(inside, of_lamp, 1.0 - of_lamp)[wrong]
    return result


def _candidates(scan: Scan, emits: np.ndarray, reach: float) -> tuple[_Candidates, np.ndarray]:
    """Triangles within reach (metres) of emitting ones, and (T,) int64 connected piece of those, else -1."""
    ids = np.flatnonzero(emits)
    piece = np.full(len(emits), -1, np.int64)
    piece[ids] = np.arange(len(ids))
    pairs = piece[scan.adjacency.pairs]
    piece[ids] = graph_components(pairs[(pairs >= 0).all(axis=1)], len(ids))
    distance, nearest = cKDTree(scan.centers[ids]).query(scan.centers, distance_upper_bound=reach)
    near = np.flatnonzero(np.isfinite(distance))
    normals = scan.cross[near] / np.maximum(np.linalg.norm(scan.cross[near], axis=1), 1e-30)[:, None]
    return _Candidates(near, scan.centers[near], normals, piece[ids[nearest[near]]], scan.edge), piece


def _piece_luminance(pixels: PixelStore, piece: np.ndarray) -> np.ndarray:
    """(P,) median luminance of the pixels that hit each piece of lamps, 0 without any; piece (T,) int."""
    of, value = [], []
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        triangle = np.asarray(pixels.triangle[rows])
        own = np.where(triangle >= 0, piece[np.maximum(triangle, 0)], -1)
        on = np.flatnonzero(own >= 0)
        of.append(own[on])
        value.append(np.asarray(pixels.radiance[rows.start + on]) @ LUMINANCE)
    return grouped_median(np.concatenate(value), np.concatenate(of), int(piece.max(initial=-1)) + 1)


def _seen(candidates: _Candidates, view: View, hit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a view sees the triangles, (2, K) pixels (x, y), and the weight (K,) of its observation of them.

    A view resolves an outline the better the smaller its pixels are on the surface.

    Args:
        hit: (H * W, 3) surface points of the view's pixels, infinite where they miss the mesh.
    """
    pose = np.asarray(view.camera_to_world, np.float64)
    toward = pose[:3, 3] - candidates.centers
    distance = np.maximum(np.linalg.norm(toward, axis=1), 1e-9)
    cosine = (toward * candidates.normals).sum(axis=1) / distance
    width = distance / min(view.fx, view.fy)
    local = -toward @ pose[:3, :3]
    depth = np.maximum(local[:, 2], 1e-9)
    place = np.stack([view.fx * local[:, 0] / depth + view.cx, view.fy * local[:, 1] / depth + view.cy])
    size = np.array([[view.width], [view.height]])
    inside = (local[:, 2] > 0.0) & ((place >= 0.5) & (place <= size - 0.5)).all(axis=0)
    column, row = np.clip(place, 0, size - 1).astype(np.int64)
    off = np.linalg.norm(hit[row * view.width + column] - candidates.centers, axis=1)
    near = off < NEAR_WIDTHS * width + NEAR_EDGES * candidates.edge
    return place, np.where(inside & near & (cosine > LEAST_COSINE), cosine / width**2, 0.0)
