# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures on a scan: specks belong to the lamp beside them or to none; what shines and what is only lit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..scene.adjacency import Scan
from ..scene.components import graph_components

# A connected piece of emitting triangles is a fixture if it has so many of them. If its area is less than
# this share of the largest of its surface, and a fixture is within so many median edges, it belongs to that
# fixture.
LEAST_TRIANGLES = 12
FIXTURE_SHARE = 0.1
NEAR = 5.0
# A side shines if pixels see it on this share of the fixture's measured area. Through holes and at rims,
# pixels see the backs of single triangles.
SEEN_SHARE = 0.3
# Triangles of a fixture, evenly chosen, from which the light that it casts on others is computed.
SAMPLES = 400
# Factor by which a scan may make a small lamp too small, and so its light on others.
AREA_DOUBT = 3.0
# Least cosine of light from within so many median edges: thin shells and rims have no certain normal.
LEAST_COSINE, CLOSE = 0.3, 15.0


def scan_groups(scan: Scan, ids: np.ndarray, surface: np.ndarray | None) -> np.ndarray:
    """(n,) int64 fixture of each emitting triangle from 0, -1 for specks that belong to none.

    Args:
        ids: (n,) int64 emitting triangles, ascending.
        surface: (T,) int; a fixture does not extend over several. None: all are one.
    """
    place = np.full(scan.adjacency.count, -1, np.int64)
    place[ids] = np.arange(len(ids))
    of = np.zeros(len(ids), np.int64) if surface is None else surface[ids].astype(np.int64)
    pairs = place[scan.adjacency.pairs]
    pairs = pairs[(pairs >= 0).all(axis=1)]
    component = graph_components(pairs[of[pairs[:, 0]] == of[pairs[:, 1]]], len(ids))
    areas = np.linalg.norm(scan.cross[ids], axis=1)
    size, number = np.bincount(component, areas), np.bincount(component)
    surface_of = np.zeros(len(size), np.int64)
    surface_of[component] = of
    largest = np.zeros(int(surface_of.max(initial=0)) + 2)
    np.maximum.at(largest, surface_of, size)
    large = (size >= FIXTURE_SHARE * largest[surface_of]) & (number >= LEAST_TRIANGLES)
    fixture = np.where(large, np.cumsum(large) - 1, -1)
    reach = NEAR * scan.edge
    beside = _fixture_beside(scan.centers[ids], component, surface_of, fixture, reach)
    alone = (beside < 0) & (number >= LEAST_TRIANGLES)
    return np.where(alone, large.sum() + np.cumsum(alone) - 1, beside)[component]


def _fixture_beside(
    centers: np.ndarray, component: np.ndarray, surface: np.ndarray, fixture: np.ndarray, reach: float
) -> np.ndarray:
    """(C,) fixture of each component: its own, else the nearest of its surface within reach (metres), or -1.

    Args:
        centers: (n, 3) of triangles. component: (n,) int from 0.
        surface, fixture: (C,) int of the components; fixture is -1 where it is none.
    """
    result = fixture.copy()
    for value in np.unique(surface[fixture < 0]):
        of_surface = surface[component] == value
        lamp = np.flatnonzero(of_surface & (fixture[component] >= 0))
        small = np.flatnonzero(of_surface & (fixture[component] < 0))
        if len(lamp):
            distance, nearest = cKDTree(centers[lamp]).query(centers[small], distance_upper_bound=reach)
            order = np.argsort(-distance, kind="stable")
            order = order[np.isfinite(distance[order])]  # the nearest triangle of a component comes last
            result[component[small[order]]] = fixture[component[lamp[nearest[order]]]]
    return result


def seen_sides(areas: np.ndarray, seen: np.ndarray, fixture: np.ndarray) -> np.ndarray:
    """(F, 2) bool, whether each side of each fixture is seen on enough of its area.

    Args:
        areas: (n,) of its triangles, m2. seen: (n, 2) bool, whether a pixel sees the front and the back.
        fixture: (n,) int from 0, -1 for none.
    """
    inside = fixture >= 0
    count = int(fixture.max(initial=-1)) + 1
    total = np.bincount(fixture[inside], (areas * seen.any(axis=1))[inside], minlength=count)
    sides = [np.bincount(fixture[inside], (areas * column)[inside], minlength=count) for column in seen.T]
    return np.asarray(np.stack(sides, axis=1) >= SEEN_SHARE * np.maximum(total, 1e-30)[:, None])


@dataclass(frozen=True)
class Patch:
    """Sample triangles of one lamp.

    Attributes:
        centers: (S, 3) metres. normals: (S, 3) unit, of the side that shines.
        area: (S,) m2, in total that of the lamp.
        luminance: of that side.
    """

    centers: np.ndarray
    normals: np.ndarray
    area: np.ndarray
    luminance: float


def lamp_patch(scan: Scan, triangles: np.ndarray, luminance: float, front: bool) -> Patch:
    """Samples of one side of a fixture (n,) of the given luminance."""
    chosen = triangles[:: max(len(triangles) // SAMPLES, 1)]
    areas = np.linalg.norm(scan.cross[chosen], axis=1)
    normals = scan.cross[chosen] / np.maximum(areas[:, None], 1e-30) * (1.0 if front else -1.0)
    total = np.linalg.norm(scan.cross[triangles], axis=1).sum()
    return Patch(scan.centers[chosen], normals, areas * (total / max(float(areas.sum()), 1e-30)), luminance)


def most_lit(patch: Patch, lamps: list[Patch], edge: float) -> float:
    """Median over a surface of the most luminance that it could reflect: white, and lamps in full view.

    Args:
        edge: metres, median of the mesh; closer distances count as this one.
    """
    total = np.zeros(len(patch.centers))
    for lamp in lamps:
        toward = lamp.centers[None] - patch.centers[:, None]
        squared = np.maximum((toward**2).sum(axis=2), edge**2)
        cosine = np.einsum("ijk,ik->ij", toward, patch.normals) / np.sqrt(squared)
        least = np.where(squared < (CLOSE * edge) ** 2, LEAST_COSINE, 0.0)
        total += (np.maximum(cosine, least) / squared) @ lamp.area * (AREA_DOUBT * lamp.luminance / np.pi)
    return float(np.median(total))


def shining_sides(scan: Scan, lamps: list[tuple[np.ndarray, float, float]]) -> np.ndarray:
    """(F, 2) bool, which sides of fixtures shine rather than reflect the light of brighter ones close by.

    On a scan the shadings do not tell: a small bulb is too large or too small there, and what it lights at
    a few centimetres is brighter than they say.

    Args:
        lamps: triangles (n,), and the luminances of front and back of each fixture.
    """
    shines = np.zeros((len(lamps), 2), bool)
    found: list[tuple[int, Patch]] = []
    sides = [(light[side], index, side) for index, (_, *light) in enumerate(lamps) for side in (0, 1)]
    for luminance, index, side in sorted(sides, key=lambda each: (-each[0], *each[1:])):
        if not luminance > 0.0:
            continue
        patch = lamp_patch(scan, lamps[index][0], luminance, front=side == 0)
        others = [each for owner, each in found if owner != index]
        if luminance > most_lit(patch, others, scan.edge):
            shines[index, side] = True
            found.append((index, patch))
    return shines
