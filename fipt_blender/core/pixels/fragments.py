"""Fragments: the surfaces that share a mixed pixel, with the share of the pixel that each covers.

The shares are those of 16 primary rays, stratified in both directions at once and along each axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..surface.room import Room
from .camera_rays import opaque_vector, trace_pixels
from .grouped import grouped_sums

# Row of the sample in each column of sixteenths of a pixel: one in each row and in each of 4 x 4 strata. Of
# 3000 random patterns of this kind, the one with the least error of coverage at edges and strips.
_ROWS = (14, 3, 10, 6, 12, 1, 4, 8, 11, 15, 7, 0, 5, 13, 2, 9)
# (x, y) of the samples in pixels from the centre.
SUBPIXELS = tuple(((x + 0.5) / 16.0 - 0.5, (y + 0.5) / 16.0 - 0.5) for x, y in enumerate(_ROWS))
# Label of what lies outside the mesh.
OUTSIDE = -2
# A gap in depth between samples of one label, in pixel widths on the surface, that divides two fragments.
DEPTH_GAP = 4.0


@dataclass(frozen=True)
class Fragments:
    """F fragments of M pixels.

    Attributes:
        pixel: (F,) int64 index among the M pixels, ascending.
        label: (F,) int64 label of the surface, OUTSIDE for what misses the mesh.
        coverage: (F,) float64 share of the pixel, 1 in total for each pixel.
        position: (F, 3) float64 mean of its samples, world metres; undefined outside the mesh.
    """

    pixel: np.ndarray
    label: np.ndarray
    coverage: np.ndarray
    position: np.ndarray

    def merged(self, key: np.ndarray) -> tuple[Fragments, np.ndarray]:
        """The fragments of one pixel and label that have the same key (F,) int as one.

        Returns:
            the G fragments, and (G,) the index of one that each was made of.
        """
        order = np.lexsort((key, self.label, self.pixel))
        first = np.zeros(len(order), bool)
        first[:1] = True
        for column in (self.pixel, self.label, key):
            first[1:] |= np.diff(column[order]) != 0
        group = np.cumsum(first) - 1
        coverage = np.bincount(group, self.coverage[order])
        weighted = self.position[order] * self.coverage[order, None]
        position = grouped_sums(weighted, group)
        chosen = order[first]
        made = Fragments(self.pixel[chosen], self.label[chosen], coverage, position / coverage[:, None])
        return made, chosen


def trace_fragments(room: Room, labels: mi.Int32, view: View, pixels: np.ndarray) -> Fragments:
    """The fragments of some pixels of a view.

    Args:
        labels: (T,) int label of each triangle, from -1.
        pixels: (M,) row-major indices in the view.
    """
    surface = trace_pixels(room, view, SUBPIXELS, mi.UInt32(pixels.astype(np.uint32)))
    label = dr.gather(mi.Int32, labels, surface.triangle, surface.valid)
    label = dr.select(surface.valid, label, OUTSIDE)
    camera = opaque_vector(mi.Point3f, np.asarray(view.camera_to_world)[:3, 3])
    cosine = dr.abs(dr.dot(surface.geometric_normal, dr.normalize(camera - surface.position)))
    width = surface.distance / dr.opaque(mi.Float, float(min(view.fx, view.fy))) / dr.maximum(cosine, 0.05)
    valid = np.array(surface.valid)
    depth = np.where(valid, np.array(surface.distance), 0.0)
    gap = np.where(valid, DEPTH_GAP * np.array(width), np.inf)
    position = np.where(valid[:, None], np.array(surface.position).T, 0.0).astype(np.float64)
    pixel = np.repeat(np.arange(len(pixels)), len(SUBPIXELS))
    return group_samples(pixel, np.array(label).astype(np.int64), depth, gap, position)


def group_samples(
    pixel: np.ndarray, label: np.ndarray, depth: np.ndarray, gap: np.ndarray, position: np.ndarray
) -> Fragments:
    """The fragments that samples (S,) form.

    Args:
        pixel: of each sample, from 0; all pixels have equally many. label: of its surface.
        depth: metres; samples of one pixel and label with a larger step than `gap` (S,) lie on two surfaces.
        position: (S, 3) world metres.
    """
    order = np.lexsort((depth, label, pixel))
    step = np.diff(depth[order], prepend=0.0) > gap[order]
    # The number of the surface rises at each gap in depth; `merged` separates pixels and labels.
    surface = np.empty(len(order), np.int64)
    surface[order] = np.cumsum(step)
    share = np.full(len(order), 1.0 / len(SUBPIXELS))
    return Fragments(pixel, label, share, position).merged(surface)[0]
