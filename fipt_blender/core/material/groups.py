"""Groups that take the place of parts where no part masks exist: regions of one base colour.

Cells of a surface (a connected piece of the mesh, or a segment of a scan) are joined by the posterior odds of
one material against two. A group that is too small costs little, because groups share their gloss by
probability (:func:`.mixture.infer_materials`); two materials in one group cost more.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..parts.components import graph_components
from ..parts.labels import Parts
from ..parts.modelled_parts import strongest_votes
from ..parts.smooth_parts import Votes
from ..pixels.grouped import grouped_sums, numbered, pairs_of
from ..run.store import Gaps

NO_GROUP = -1  # in place of a group
# Added to base colours before they are compared, because their errors are about as large on dark surfaces as
# on bright ones.
COLOR_LIFT = 0.05
# Largest number of groups, so that arrays over pairs of groups do not grow with the capture.
MAX_GROUPS = 2000
# Standard deviation of the base colours of regions of one material, in stops: errors of the light.
SIMILAR_COLOR = 0.15
# That of the base colour by a single pixel, in stops.
PIXEL_ERROR = 0.3
# Squared difference of base colours, in variances, at which one material and two are equally probable: two
# materials are two stops apart or so, and adjacent cells of a surface are mostly of one material.
EVEN_ODDS = 6.0
# A triangle belongs to a group that has this share of its pixels, or to the most frequent one if it has fewer
# than `TELLING_PIXELS`. Groups with fewer count less in what similar ones are expected to be.
AGREED, TELLING_PIXELS = 0.9, 100.0


@dataclass(frozen=True)
class Units:
    """The finest known division of the mesh into surfaces.

    Attributes:
        triangle: (T,) int32 unit of each triangle from 0, NO_PART without one.
        single: (units,) bool, whether it is of one material.
        fixed: (units, 2) roughness and metallic that hints have decided, NaN elsewhere; None without hints.
    """

    triangle: np.ndarray
    single: np.ndarray
    fixed: Gaps | None = None

    def is_single(self, unit: np.ndarray) -> np.ndarray:
        """Whether units (any shape; negative for none) are of one material."""
        return np.append(self.single, False)[np.maximum(unit, -1)]


def stops(color: np.ndarray) -> np.ndarray:
    """Base colours (..., 3) as they are compared: logarithms in base 2."""
    return np.asarray(np.log2(color + COLOR_LIFT))


def neighbours(surface: np.ndarray, cube: np.ndarray) -> np.ndarray:
    """(E, 2) int64 pairs of cells on one surface (C,) whose cubes (C, 3) int are the same or touch."""
    cube = cube - cube.min(axis=0, initial=0) + 1
    shape = cube.max(axis=0, initial=0) + 2
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    key = numbered([surface]) * int(np.prod(shape)) + cube @ strides
    order = np.argsort(key, kind="stable")
    ascending, pairs = key[order], [np.zeros((0, 2), np.int64)]
    steps = [step for step in itertools.product((-1, 0, 1), repeat=3) if step >= (0, 0, 0)]
    for step in steps:
        wanted = key + strides @ step
        low, high = (np.searchsorted(ascending, wanted, side) for side in ("left", "right"))
        for number in range(int((high - low).max(initial=0))):
            found = np.flatnonzero(low + number < high)
            pairs.append(np.stack([found, order[low[found] + number]], axis=1))
    return np.concatenate(pairs)


def join_cells(color: np.ndarray, pixels: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(C,) int64 region of each cell, from 0: pairs join as long as one material is more probable than two.

    In each round the regions join that are each other's most similar neighbours.

    Args:
        color: (C, 3) base colour. pixels: (C,) by which it was found. pairs: (E, 2) adjacent cells.
    """
    sums, count = stops(color) * pixels[:, None], pixels.astype(np.float64)
    region: np.ndarray = np.arange(len(count))
    while True:
        apart = pairs[:, 0] != pairs[:, 1]
        one, other, _ = pairs_of(pairs[apart].min(axis=1), pairs[apart].max(axis=1))
        mean = sums / count[:, None]
        squared = ((mean[one] - mean[other]) ** 2).mean(axis=1)
        odds = squared / (SIMILAR_COLOR**2 + PIXEL_ERROR**2 * (1.0 / count[one] + 1.0 / count[other]))
        alike = odds < EVEN_ODDS
        pairs, odds = np.stack([one, other], axis=1)[alike], odds[alike]
        if not len(pairs):
            return region
        best = np.full(len(count), np.inf)
        for side in pairs.T:
            np.minimum.at(best, side, odds)
        joined = graph_components(pairs[(odds[:, None] <= best[pairs]).all(axis=1)], len(count))
        sums, count = grouped_sums(sums, joined), np.bincount(joined, count).astype(np.float64)
        region, pairs = joined[region], joined[pairs]


def group_units(parts: Parts, surface: np.ndarray, votes: Votes, materials: np.ndarray) -> Units:
    """Units where no parts are known: what a surface has of one gloss; classes where pixels disagree.

    Triangles that no pixel sees are like most of their surface.

    Args:
        parts: semantic classes, or none.
        surface: (T,) int surface of each triangle, of one class.
        votes: the number of pixels that see a triangle and belong to a group.
        materials: (G, 2) roughness and metallic of the groups.
    """
    gloss = np.unique(materials, axis=0, return_inverse=True)[1].reshape(-1)
    votes = Votes(votes.triangle, gloss[votes.label], votes.weight)
    own, share, total = strongest_votes(np.arange(len(surface)), votes)
    agreed = (share >= AGREED) | (total < TELLING_PIXELS)
    label = np.where(agreed, own, NO_GROUP)
    label = np.where(total > 0.0, label, strongest_votes(surface, votes)[0][surface])
    unit, classes = parts.triangle_part.astype(np.int64), int(parts.triangle_part.max(initial=-1)) + 1
    unit[label >= 0] = classes + numbered([surface[label >= 0], label[label >= 0]])
    return Units(unit.astype(np.int32), np.arange(max(int(unit.max(initial=-1)) + 1, classes)) >= classes)
