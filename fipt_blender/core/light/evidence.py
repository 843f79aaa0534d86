# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles emit, by what single pixels testify (after the paper's Sec. 4.4 "Emitter extraction").

A pixel speaks for emission where the surface at its centre must send more than reflection explains. A pixel
sees more than that surface: its neighbours' light spills into it, and at edges it shows what lies behind. So
light that may come from elsewhere is evidence of nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..render.lights import LUMINANCE
from ..scene.labels import room_pieces
from ..scene.pixels import PixelStore
from ..scene.room import Room
from .views import ShadingStore

# Share of a surface's radiance that reflection must leave unexplained.
LEAST_EXCESS = 0.3
# Share of a pixel's light that neighbours may lend it though its corners see one surface: half where surfaces
# in one plane meet at its centre, 16 to 30 % by a camera's blur (a Gaussian of half a pixel).
SPILL = 0.5
# A mixed pixel within one step of a lamp that has this share of its radiance shows that lamp's light.
LAMPLIGHT = 0.5
# Highlights move with the view: without the mask's word, or with mixed pixels alone, so many views must agree
# that a triangle emits.
LEAST_VIEWS = 2
# Triangles that no pixel judged emit where this share of the judged area of their piece of mesh does.
MOSTLY = 0.5


def find_emission(
    room: Room,
    pixels: PixelStore,
    shadings: ShadingStore,
    marked: np.ndarray,
    constant: np.ndarray,
    estimate: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """(T,) bool, triangles that emit: most pixels that judge them say so, or their piece of mesh does.

    What the emission mask marks emits where the estimate leaves radiance unexplained. The mask's L1 term
    (paper Eq. 13) keeps lamps dark that are little brighter than what they are lit by, so any triangle emits
    that is brighter than a surface of any material would be (:func:`most_reflected`), in two views at least.

    Args:
        shadings: of all pixels.
        marked: (T,) bool, triangles where the emission mask is above its threshold.
        constant: (T,) bool, triangles of parts that shine alike from everywhere: they emit in any case.
        estimate: (R,) pixels to their (R, 3) reflected radiance L_r of the estimate.
    """
    votes = Votes(*np.zeros((3, len(marked)), np.int64))
    mixed = []
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        triangle, radiance = np.asarray(pixels.triangle[rows]), np.asarray(pixels.radiance[rows])
        reflected = _reflected(pixels, shadings, rows, triangle, radiance, marked, estimate)
        excess = unexplained(radiance, reflected) >= LEAST_EXCESS
        hit = triangle >= 0
        votes.add(triangle[hit & ~excess], against=True)
        size = pixels.views[index].height, pixels.views[index].width
        light = radiance @ LUMINANCE
        pure = np.asarray(pixels.pure[rows])
        own = own_share(light, brightest_beside(light, size))
        sure = unexplained(radiance * own[:, None], reflected) >= LEAST_EXCESS
        votes.add(triangle[hit & excess & pure & sure])
        mixed.append(np.flatnonzero(hit & excess & ~pure) + rows.start)
    emits = votes.emits & (marked | (votes.views >= LEAST_VIEWS))
    _ask_mixed(pixels, votes, emits, mixed)
    emits |= votes.emits & (votes.views >= LEAST_VIEWS)
    judged = emits | (votes.judged & ~votes.emits)
    return complete(room.areas, room_pieces(room), emits | constant, judged | constant)


def outshining(pixels: PixelStore, shadings: ShadingStore, triangles: int) -> np.ndarray:
    """(triangles,) bool, those that are brighter in any pixel than a white surface: all that may emit."""
    found = np.zeros(triangles, bool)
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        triangle = np.asarray(pixels.triangle[rows])
        white = np.asarray(shadings.diffuse[rows], np.float32)
        bright = unexplained(np.asarray(pixels.radiance[rows]), white) >= LEAST_EXCESS
        found[triangle[bright & (triangle >= 0)]] = True
    return found


@dataclass(frozen=True)
class Votes:
    """Pixels for and against emission, and views with pixels for it: (T,) int64 each."""

    number_for: np.ndarray
    number_against: np.ndarray
    views: np.ndarray

    def add(self, triangle: np.ndarray, against: bool = False) -> None:
        """Count pixels of one view that see the triangles given."""
        number = np.bincount(triangle, minlength=len(self.views))
        if against:
            np.add(self.number_against, number, out=self.number_against)
        else:
            np.add(self.number_for, number, out=self.number_for)
            np.add(self.views, number > 0, out=self.views)

    @property
    def emits(self) -> np.ndarray:
        """(T,) bool."""
        return self.number_for > self.number_against

    @property
    def judged(self) -> np.ndarray:
        """(T,) bool, by any pixel."""
        return self.number_for + self.number_against > 0


def _reflected(
    pixels: PixelStore,
    shadings: ShadingStore,
    rows: slice,
    triangle: np.ndarray,
    radiance: np.ndarray,
    marked: np.ndarray,
    estimate: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """(n, 3) what reflection explains of a view's pixels; of white surfaces where that is enough."""
    reflected = np.array(shadings.diffuse[rows], np.float32)  # a copy, to be written to
    bright = (triangle >= 0) & (unexplained(radiance, reflected) >= LEAST_EXCESS)
    on_marked = (triangle >= 0) & marked[np.maximum(triangle, 0)]
    asked = np.flatnonzero(bright & ~on_marked)
    specular = np.asarray(shadings.specular[asked + rows.start], np.float32)
    reflected[asked] = most_reflected(reflected[asked], specular)
    asked = np.flatnonzero(on_marked)
    reflected[asked] = estimate(asked + rows.start)
    return reflected


def most_reflected(diffuse: np.ndarray, specular: np.ndarray) -> np.ndarray:
    """(N, 3) the most that a surface of any base colour, roughness and metallic reflects (paper Eq. 5).

    Args:
        diffuse: (N, 3) L_d. specular: (N, K, 2, 3) L_s0 and L_s1.
    """
    s0, s1 = specular[:, :, 0], specular[:, :, 1]
    return (np.maximum(diffuse[:, None] + 0.04 * s0, s0) + s1).max(axis=1)


def unexplained(radiance: np.ndarray, reflected: np.ndarray) -> np.ndarray:
    """(N,) share of the luminance of (N, 3) radiances that reflection leaves, channel by channel."""
    light = radiance @ LUMINANCE
    return np.maximum(radiance - reflected, 0.0) @ LUMINANCE / np.maximum(light, 1e-12)


def brightest_beside(light: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(n,) highest value among the 3 × 3 pixels around each of a view of `size` (height, width)."""
    wide = np.pad(light.reshape(size), 1, mode="edge")
    wide = np.maximum(np.maximum(wide[:-2], wide[1:-1]), wide[2:])
    return np.maximum(np.maximum(wide[:, :-2], wide[:, 1:-1]), wide[:, 2:]).reshape(-1)


def own_share(light: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """(n,) least share of a pure pixel's light that is its own surface's, whatever spills in."""
    own = (light - SPILL * beside) / (1.0 - SPILL)
    return np.clip(own / np.maximum(light, 1e-12), 0.0, 1.0)


def _ask_mixed(pixels: PixelStore, votes: Votes, emits: np.ndarray, mixed: list[np.ndarray]) -> None:
    """Let mixed pixels judge what none else judged: lamps so small or thin that no pixel sees them alone.

    Such a pixel must be the brightest around, and far from what is known to shine: the lamps found so far,
    and whatever lies outside.

    Args:
        emits: (T,) bool, lamps found so far.
        mixed: for each view its mixed pixels (indices among all) that reflection does not explain.
    """
    lamp = np.append(emits, True)  # at -1: outside
    open_ = ~votes.judged
    for index, rows in enumerate(mixed):
        rows = rows[open_[pixels.triangle[rows]]]
        if not len(rows):
            continue
        all_rows = pixels.rows(index)
        size = pixels.views[index].height, pixels.views[index].width
        light = np.asarray(pixels.radiance[all_rows]) @ LUMINANCE
        known = light * lamp[np.maximum(pixels.triangle[all_rows], -1)]
        near = rows - all_rows.start
        most, lamplight = (brightest_beside(each, size)[near] for each in (light, known))
        votes.add(pixels.triangle[rows[(light[near] >= most) & (lamplight < LAMPLIGHT * light[near])]])


def complete(areas: np.ndarray, piece: np.ndarray, emits: np.ndarray, judged: np.ndarray) -> np.ndarray:
    """(T,) bool, what emits, and triangles that no pixel judged where most of their piece does.

    Args:
        areas: (T,) square metres.
        piece: (T,) int connected piece of the mesh, from 0.
        emits, judged: (T,) bool.
    """
    judged_area = np.bincount(piece, areas * judged)
    mostly = np.bincount(piece, areas * (judged & emits)) > MOSTLY * np.maximum(judged_area, 1e-30)
    return emits | (~judged & mostly[piece])
