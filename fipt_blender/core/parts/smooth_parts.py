"""Parts on a scan, whose borders do not coincide with those of the masks: a random walk smooths the votes.

The votes of the pixels walk from triangle to triangle, hardly over creases. Each triangle takes the label of
which most votes arrive (Grady, "Random walks for image segmentation", with restarts at every vote).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from ..pixels.grouped import pairs_of, strongest
from ..surface.adjacency import Mesh
from ..surface.scan import averaged_normals
from .components import graph_components

# Share of the votes that goes on to the neighbours at each step; the walk is about three triangles long.
ONWARD = 0.9
# Steps after which the votes that still walk are negligible.
STEPS = 24
# Angle between normals (radians) at which an edge passes e^-1 of the votes, and the least share that passes.
CREASE = 0.35
LEAST_PASSED = 0.01
# Rings over which the normals of a scan are averaged before creases are looked for.
CREASE_RINGS = 2
# Votes of less weight, in pixels, are dropped: they decide nothing and cost memory.
FORGOTTEN = 1e-4
# A component of one label is a speck if it has less than this share of the label's area, and less area than
# this many median triangles.
SPECK_SHARE = 0.1
SPECK_TRIANGLES = 25.0


@dataclass(frozen=True)
class Votes:
    """The votes of the pixels, K pairs of a triangle and a label.

    Attributes:
        triangle: (K,) int64.
        label: (K,) int64.
        weight: (K,) float64, in pixels.
    """

    triangle: np.ndarray
    label: np.ndarray
    weight: np.ndarray


def smooth_labels(votes: Votes, mesh: Mesh, cross: np.ndarray) -> np.ndarray:
    """(T,) int64 label of each triangle after a random walk; -1 where no vote arrives.

    Args:
        cross: (T, 3) normals with the areas as lengths.
    """
    labels, column = np.unique(votes.label, return_inverse=True)
    one, other = averaged_normals(mesh, cross, CREASE_RINGS)[mesh.dual_edges.T]
    angle = np.arccos(np.clip((one * other).sum(axis=1), -1.0, 1.0))
    # A walk passes an edge by its length, less at creases.
    passage = mesh.dual_lengths * np.maximum(np.exp(-((angle / CREASE) ** 2)), LEAST_PASSED)
    sums = _walk(votes, column, len(labels), mesh.dual_matrix(passage))
    row = np.repeat(np.arange(len(mesh.triangles)), np.diff(sums.indptr))
    found = strongest(row, sums.indices, sums.data, len(mesh.triangles))
    found = without_specks(found, mesh, np.linalg.norm(cross, axis=1))
    known = found >= 0
    found[known] = labels[found[known]]
    return found


def _walk(votes: Votes, column: np.ndarray, labels: int, passage: csr_array) -> csr_array:
    """(T, L) votes that arrive at each triangle."""
    total = np.asarray(passage.sum(axis=1)).ravel()
    step = diags_array(ONWARD / np.maximum(total, 1e-30)).tocsr() @ passage
    shape = (passage.shape[0], labels)
    start = csr_array((votes.weight, (votes.triangle, column)), shape=shape)
    sums = start
    for _ in range(STEPS):
        sums = start + step @ sums
        sums.data[sums.data < FORGOTTEN] = 0.0
        sums.eliminate_zeros()
    return sums


def without_specks(label: np.ndarray, mesh: Mesh, area: np.ndarray) -> np.ndarray:
    """(T,) labels from 0 (-1: none) in which specks have the label with which they share the longest border.

    A speck is a component much smaller than the label's others, so that small parts stay.

    Args:
        area: (T,) of the triangles, in any unit.
    """
    one, other = mesh.dual_edges.T
    inside = label[one] == label[other]
    component = graph_components(mesh.dual_edges[inside], len(label))
    size = np.bincount(component, area)
    of_label = np.bincount(np.maximum(label, 0), area * (label >= 0))
    least = np.minimum(SPECK_SHARE * of_label, SPECK_TRIANGLES * np.median(area))
    speck = (size < least[np.maximum(label, 0)][_first(component)])[component] & (label >= 0)
    # Borders between specks and other components; a speck takes the label with the longest total border.
    border = ~inside & (speck[one] ^ speck[other])
    within = np.where(speck[one], one, other)[border]
    beyond = np.where(speck[one], other, one)[border]
    valid = label[beyond] >= 0
    of, next_to, place = pairs_of(component[within[valid]], label[beyond[valid]])
    length = np.bincount(place, mesh.dual_lengths[border][valid])
    taken = strongest(of, next_to, length, len(size), "high")
    replaced = speck & (taken[component] >= 0)
    return np.where(replaced, taken[component], label)


def _first(component: np.ndarray) -> np.ndarray:
    """(C,) int64 the first triangle of each component (T,), numbered from 0."""
    return np.unique(component, return_index=True)[1]
