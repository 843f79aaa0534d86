"""Fixtures on a scan: which specks belong to a lamp beside them, and which sides of a lamp shine."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..parts.components import graph_components
from ..surface.scan import Scan

# A connected piece of emitting triangles is a fixture if it has at least this many of them. If its area is
# less than this share of the largest of its surface, and a fixture is within this many median edges, it
# belongs to that fixture.
MIN_TRIANGLES = 12
FIXTURE_SHARE = 0.1
NEAR = 5.0
# A side shines if pixels see it on this share of the fixture's measured area. Through holes and at rims,
# pixels see the backs of single triangles.
SEEN_SHARE = 0.3


def scan_groups(scan: Scan, ids: np.ndarray, surface: np.ndarray | None) -> np.ndarray:
    """(n,) int64 fixture of each emitting triangle from 0, -1 for specks that belong to none.

    Args:
        ids: (n,) int64 emitting triangles, ascending.
        surface: (T,) int; a fixture does not extend over several. None: all are one.
    """
    place = np.full(len(scan.centers), -1, np.int64)
    place[ids] = np.arange(len(ids))
    of = np.zeros(len(ids), np.int64) if surface is None else surface[ids].astype(np.int64)
    pairs = place[scan.mesh.dual_edges]
    pairs = pairs[(pairs >= 0).all(axis=1)]
    component = graph_components(pairs[of[pairs[:, 0]] == of[pairs[:, 1]]], len(ids))
    areas = np.linalg.norm(scan.cross[ids], axis=1)
    size, number = np.bincount(component, areas), np.bincount(component)
    surface_of = np.zeros(len(size), np.int64)
    surface_of[component] = of
    largest = np.zeros(int(surface_of.max(initial=0)) + 2)
    np.maximum.at(largest, surface_of, size)
    large = (size >= FIXTURE_SHARE * largest[surface_of]) & (number >= MIN_TRIANGLES)
    fixture = np.where(large, np.cumsum(large) - 1, -1)
    reach = NEAR * scan.edge
    beside = _fixture_beside(scan.centers[ids], component, surface_of, fixture, reach)
    alone = (beside < 0) & (number >= MIN_TRIANGLES)
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
