# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Range images from photographs alone: a plane sweep (R. Collins, CVPR 1996) with normalised correlation,
smoothed along scanlines (H. Hirschmueller, Stereo Processing by Semiglobal Matching, PAMI 2008).

Walls without texture take the depth of what surrounds them. What fewer than two other range images confirm
is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from .range_image import RangeImage

PLANES = 96  # equally spaced in inverse depth
NEIGHBOURS = 6  # photographs that a photograph is compared with; the better half of them counts at each pixel
WINDOW = 5  # pixels, side of the window of correlation
NOISE = 0.01  # standard deviation of gray (0 to 1) below which a window has no texture
# Penalties of a step to the next plane and of a larger one, in units of 1 - correlation; the latter falls
# with the difference of gray over `EDGE`, where surfaces end.
STEP, JUMP, EDGE = 0.06, 0.8, 0.05
# Baselines over the median depth: the best one, and the widest.
BASELINE, WIDEST = 0.12, 0.6
LEAST_ALIGNED = 0.6  # cosine between the axes of cameras that see the same
CONFIRMED = 2  # range images that must agree
AGREE = 1.5  # planes, within which they do


@dataclass(frozen=True, eq=False)
class Shot:
    """A photograph without distortion: (H, W) float32 gray from 0 to 1, pinhole intrinsics in its pixels and
    (4, 4) camera to world, OpenCV axes; (H, W, 3) float32 color."""

    gray: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_world: np.ndarray
    color: np.ndarray | None = None

    @property
    def rays(self) -> np.ndarray:
        """(3, H, W) local directions of pixels at depth 1."""
        height, width = self.gray.shape
        y, x = np.mgrid[:height, :width] + 0.5
        return np.stack([(x - self.cx) / self.fx, (y - self.cy) / self.fy, np.ones_like(x)])

    def seen_from(self, other: Shot) -> tuple[np.ndarray, np.ndarray]:
        """(3, 3) and (3,): local coordinates here of a local point p of the other are R p + t."""
        turn = self.camera_to_world[:3, :3].T
        away = other.camera_to_world[:3, 3] - self.camera_to_world[:3, 3]
        return turn @ other.camera_to_world[:3, :3], turn @ away

    def pixels(self, local: np.ndarray) -> np.ndarray:
        """(2, ...) row and column of local points (3, ...), 0 at the centre of the first pixel."""
        depth = np.where(local[2] > 1e-6, local[2], np.nan)
        return np.stack([self.fy * local[1] / depth + self.cy, self.fx * local[0] / depth + self.cx]) - 0.5


def range_images(
    shots: Sequence[Shot],
    reaches: Sequence[tuple[float, float]],
    progress: Callable[[float], None] = lambda fraction: None,
) -> list[RangeImage]:
    """The range images of photographs; 0 where fewer than `CONFIRMED` others agree.

    Args:
        reaches: nearest and farthest depth that each shows.
    """
    inverse = [np.linspace(1.0 / far, 1.0 / near, PLANES) for near, far in reaches]
    chosen = [neighbours(shots, index, 2.0 / float(each[0] + each[-1])) for index, each in enumerate(inverse)]
    found = []
    for index, (shot, planes) in enumerate(zip(shots, inverse, strict=True)):
        costs = _sweep(shot, [shots[other] for other in chosen[index]], planes)
        found.append(_winner(_smoothed(costs, shot.gray), planes))
        progress((index + 1) / (len(shots) + 1))
    result = []
    for index, shot in enumerate(shots):
        tolerance = AGREE * float(inverse[index][1] - inverse[index][0])
        others = [(shots[other], found[other]) for other in chosen[index]]
        good = _agreeing(shot, found[index], others, tolerance) >= CONFIRMED
        depth = np.where(good, 1.0 / found[index], 0.0).astype(np.float32)
        camera = shot.fx, shot.fy, shot.cx, shot.cy, shot.camera_to_world
        result.append(RangeImage(depth, *camera, shot.color))
    progress(1.0)
    return result


def neighbours(shots: Sequence[Shot], index: int, depth: float) -> list[int]:
    """The other photographs that a photograph is best compared with, by their baselines over a depth."""
    pose = shots[index].camera_to_world
    scored = []
    for other, shot in enumerate(shots):
        away = float(np.linalg.norm(shot.camera_to_world[:3, 3] - pose[:3, 3])) / depth
        aligned = float(shot.camera_to_world[:3, 2] @ pose[:3, 2])
        if other != index and 0.0 < away < WIDEST and aligned > LEAST_ALIGNED:
            scored.append((abs(np.log(away / BASELINE)) + 2.0 * (1.0 - aligned), other))
    return [other for _, other in sorted(scored)[:NEIGHBOURS]]


def _sweep(shot: Shot, others: Sequence[Shot], planes: np.ndarray) -> np.ndarray:
    """(D, H, W) float32 costs: 1 - correlation with the better half of the others, 0 to 1."""
    rays, gray = shot.rays, shot.gray
    mean = uniform_filter(gray, WINDOW)
    deviation = np.sqrt(np.maximum(uniform_filter(gray**2, WINDOW) - mean**2, 0.0) + NOISE**2)
    costs = np.ones((len(planes), *gray.shape), np.float32)
    cameras = [(other, *other.seen_from(shot)) for other in others]
    turned = [np.tensordot(turn, rays, 1) for _, turn, _ in cameras]
    for number, inverse in enumerate(planes):
        each = np.full((max(len(others), 1), *gray.shape), 2.0, np.float32)
        for slot, (other, _, away) in enumerate(cameras):
            where = other.pixels(turned[slot] + inverse * away[:, None, None])
            seen = map_coordinates(other.gray, np.nan_to_num(where, nan=-9.0), order=1, cval=-1.0)
            inside = seen >= 0.0
            middle = uniform_filter(seen, WINDOW)
            spread = np.sqrt(np.maximum(uniform_filter(seen**2, WINDOW) - middle**2, 0.0) + NOISE**2)
            shared = uniform_filter(seen * gray, WINDOW) - mean * middle
            each[slot] = np.where(inside, 1.0 - shared / (deviation * spread), 2.0)
        each.sort(axis=0)
        costs[number] = np.clip(each[: (len(each) + 1) // 2].mean(axis=0), 0.0, 1.0)
    return costs


def _smoothed(costs: np.ndarray, gray: np.ndarray) -> np.ndarray:
    """Costs (D, H, W) summed along paths from four sides, which pay for changes of depth."""
    total = np.zeros_like(costs)
    for axis in (1, 2):
        lines = np.moveaxis(costs, axis, 0)  # (lines, D, across)
        shades = np.moveaxis(gray, axis - 1, 0)
        sums = np.moveaxis(total, axis, 0)
        for order in (range(len(lines)), range(len(lines) - 1, -1, -1)):
            before, last = None, 0
            for place in order:
                path = lines[place].copy()
                if before is not None:
                    least = before.min(axis=0)
                    jump = JUMP / (1.0 + np.abs(shades[place] - shades[last]) / EDGE)
                    best = np.minimum(before, least + np.maximum(jump, STEP))
                    best[1:] = np.minimum(best[1:], before[:-1] + STEP)
                    best[:-1] = np.minimum(best[:-1], before[1:] + STEP)
                    path += best - least
                sums[place] += path
                before, last = path, place
    return total


def _winner(costs: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(H, W) inverse depth of least cost, between planes by a parabola."""
    best = np.clip(costs.argmin(axis=0), 1, len(planes) - 2)
    left, middle, right = (np.take_along_axis(costs, (best + step)[None], axis=0)[0] for step in (-1, 0, 1))
    curve = np.maximum(left + right - 2.0 * middle, 1e-6)
    shift = np.clip(0.5 * (left - right) / curve, -0.5, 0.5)
    return np.asarray(planes[0] + (best + shift) * (planes[1] - planes[0]))


def _agreeing(
    shot: Shot, inverse: np.ndarray, others: Sequence[tuple[Shot, np.ndarray]], tolerance: float
) -> np.ndarray:
    """(H, W) number of other range images, as inverse depths, that have the same surface."""
    count = np.zeros(inverse.shape, np.int16)
    points = shot.rays / inverse
    for other, depths in others:
        turn, away = other.seen_from(shot)
        local = np.tensordot(turn, points, 1) + away[:, None, None]
        where = np.nan_to_num(other.pixels(local), nan=-9.0)
        there = map_coordinates(depths, where, order=0, cval=np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            count += np.abs(1.0 / local[2] - there) < tolerance
    return count
