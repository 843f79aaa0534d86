# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points by which a capture is aligned to a mesh: the solve's sparse points, or those of its depth images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..run.errors import FiptError
from .depth_images import check_unit, read_depth
from .formats.registry import FORMATS, read_points
from .rig import DepthView, Rig

_STEEP = 0.05  # relative difference between neighbouring depths above which a pixel lies at an edge


def alignment_points(capture: Path, rig: Rig) -> np.ndarray:
    """Points (N, 3) in the coordinates of the rig.

    Raises:
        FiptError: ``alignment-points`` where the capture has neither, or one of the readers'.
    """
    if rig.depths and getattr(FORMATS[rig.source], "points", None) is None:
        return depth_points(rig.depths, np.random.default_rng(0))
    return read_points(capture, rig.source, sure=True)


def depth_points(views: Sequence[DepthView], rng: np.random.Generator) -> np.ndarray:
    """Points (N, 3) that some of the depth images measure, in metres and the coordinates of their poses.

    Pixels beside edges are left out, where depth cameras measure between both sides.

    Raises:
        FiptError: those of `read_depth` and `check_unit`; ``depth-empty`` where no pixel is left.
    """
    count = min(60, len(views))  # evenly spread; more do not make an alignment better
    chosen = [replace(views[index * len(views) // count], photograph=None) for index in range(count)]
    images = [read_depth(view, 1.0) for view in chosen]
    check_unit(images[:: max(1, count // 8)])
    points = []
    for image in images:
        positions = replace(image, depth=np.where(_inside(image.depth), image.depth, 0.0)).points()[0]
        points.append(positions[rng.permutation(len(positions))[:200]])
    found = np.concatenate(points)
    if not len(found):
        raise FiptError(
            "depth-empty",
            "The depth images measure no surface away from its edges.",
            "Check the depth images, or align by pairs of points.",
        )
    return found


def _inside(depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: measured, and so are the four neighbours, at similar depths."""
    inside = np.zeros(depth.shape, bool)
    middle = depth[1:-1, 1:-1]
    around = (depth[:-2, 1:-1], depth[2:, 1:-1], depth[1:-1, :-2], depth[1:-1, 2:])
    near = [(other > 0.0) & (np.abs(other - middle) <= _STEEP * middle) for other in around]
    inside[1:-1, 1:-1] = (middle > 0.0) & np.logical_and.reduce(near)
    return inside
