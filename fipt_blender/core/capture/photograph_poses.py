# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Own poses of the photographs of RGB-D frames, whose poses were found for the depth images.

The two cameras of such frames take their images at different moments, so that a camera in the hand has moved
between them. Each photograph gets the small motion with which it agrees best with what the others show of the
measured points (Gauss-Newton on robust residuals, from coarse to fine). Depth images keep their poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..alignment.turns import turn_by
from ..run.errors import Problem, problem
from .color_camera import (
    MOST_FRAMES,
    SCALE,
    Sightings,
    details,
    disagreement,
    gradients,
    sampled,
    shown_points,
)
from .rig import DepthView, Rig, RigView

BLURS = ((8.0, 6), (4.0, 8), (2.0, 10), (1.0, 10))  # pixels, and steps
DAMPING = 0.7  # share of each step: the mean that a photograph is compared with contains what the others move
# Expected motions: radians and metres. A sighting's neighbors share its error: about so many count as one.
EXPECTED = np.array([0.02, 0.02, 0.02, 0.03, 0.03, 0.03])
SHARED = 10.0
# Larger motions are mistakes, in standard deviations of what is expected.
MOST = 4.0
# The poses are changed where the photographs agree better by this factor.
BETTER = 0.95


def with_photograph_poses(
    rig: Rig, views: Sequence[RigView], scale: float
) -> tuple[list[RigView], Problem | None]:
    """Some of a rig's photographs with their own poses, and a note; unchanged where they agree no better.

    Args:
        views: photographs of the rig, by whatever names.
        scale: metres per unit of the capture's coordinates.

    Raises:
        FiptError: an image can't be read.
    """
    frame_of = {depth.photograph.image: depth for depth in rig.depths if depth.photograph is not None}
    known = [index for index, view in enumerate(views) if view.image in frame_of]
    frames = [frame_of[views[index].image] for index in known]
    # Photographs by turns, so that each batch shows all of the room.
    batches = max(-(-len(frames) // MOST_FRAMES), 1)
    result, gains, sizes = list(views), [], []
    for first in range(batches):
        found = find_motions(frames[first::batches], scale)
        if found is None or found[1] > BETTER:
            continue
        gains.append(found[1])
        for index, motion in zip(known[first::batches], found[0], strict=True):
            moved = np.concatenate([motion[:3], motion[3:] / scale])
            result[index] = replace(
                views[index], camera_to_world=corrected_pose(views[index].camera_to_world, moved)
            )
            sizes.append(float(np.linalg.norm(motion[:3])))
    if not gains:
        return list(views), None
    return result, problem(
        "photograph-poses",
        number_of_sizes=len(sizes),
        degrees=np.degrees(np.median(sizes)),
        mean=1.0 / np.mean(gains),
    )


def find_motions(frames: Sequence[DepthView], scale: float) -> tuple[np.ndarray, float] | None:
    """How the cameras of the photographs of V frames moved; None where too few points are seen by several.

    The mean motion is zero.

    Args:
        frames: with photographs of one size and pinhole lenses.
        scale: metres per unit of the capture's coordinates.

    Returns:
        (V, 6) turn in radians and shift in metres of the points before each camera, and the robust
        disagreement of the photographs, relative to that with the given poses.
    """
    shown = shown_points(frames, scale)
    if shown is None:
        return None
    sightings, reduced = shown
    place, lens = _before_photographs(frames, sightings, reduced[0].shape[1], scale)
    motion = np.zeros((len(frames), 6))
    finest = _at_scale(reduced, BLURS[-1][0])
    before = _step(motion, finest, sightings, place, lens)[1]
    for blur, steps in BLURS:
        images = finest if blur == BLURS[-1][0] else _at_scale(reduced, blur)
        for _ in range(steps):
            motion, _ = _step(motion, images, sightings, place, lens)
    motion[(np.abs(motion / EXPECTED) > MOST).any(axis=1)] = 0.0
    after = _step(motion, finest, sightings, place, lens)[1]
    return motion, after / max(before, 1e-12)


def corrected_pose(camera_to_world: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The pose (4, 4) of a camera before which points move by a motion (6,): turn in radians, and shift."""
    moved = np.eye(4)
    moved[:3, :3] = turn_by(motion[:3])
    moved[:3, 3] = motion[3:]
    return np.asarray(camera_to_world, np.float64) @ np.linalg.inv(moved)


def _at_scale(reduced: Sequence[np.ndarray], blur: float) -> np.ndarray:
    """(V, 3, H, W) details of photographs at one scale, with their derivatives."""
    return np.stack([gradients(details(image, blur)) for image in reduced])


def _before_photographs(
    frames: Sequence[DepthView], sightings: Sightings, width: int, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) sighted points before the cameras of the photographs, metres, and (V, 4) these cameras' fx, fy,
    cx, cy for photographs of a width."""
    place, lens = np.zeros_like(sightings.place), np.zeros((len(frames), 4))
    for index, frame in enumerate(frames):
        view = frame.photograph
        assert view is not None
        relative = np.linalg.inv(view.camera_to_world) @ frame.camera_to_world
        mine = sightings.frame == index
        place[mine] = sightings.place[mine] @ relative[:3, :3].T + scale * relative[:3, 3]
        lens[index] = np.array(view.lens.parameters[:4]) * (width / view.width)
    return place, lens


def _step(
    motion: np.ndarray, images: np.ndarray, sightings: Sightings, place: np.ndarray, lens: np.ndarray
) -> tuple[np.ndarray, float]:
    """Better motions (V, 6), and the disagreement with the given ones; arguments as made above."""
    frame = sightings.frame
    own = motion[frame]
    moved = place + np.cross(own[:, :3], place) + own[:, 3:]
    fx, fy, cx, cy = lens[frame].T
    depth = np.maximum(moved[:, 2], 1e-3)
    x, y = moved[:, 0] / depth, moved[:, 1] / depth
    where = np.stack([fx * x + cx, fy * y + cy], axis=1)
    inside, (value, along_x, along_y) = sampled(images, frame, where)
    residual, weight, cost = disagreement(value, inside, sightings)
    by_x, by_y = along_x * fx / depth, along_y * fy / depth
    by_z = -(by_x * x + by_y * y)
    slope = np.stack([by_x, by_y, by_z], axis=1)
    jacobian = np.concatenate([np.cross(place, slope), slope], axis=1)
    # Without itself, the mean of n photographs differs from one of them by n / (n - 1) times as much.
    seen = np.bincount(sightings.point, weight > 0.0, sightings.count)[sightings.point]
    residual = residual * np.where(seen > 1, seen / np.maximum(seen - 1.0, 1.0), 0.0)
    better, precision = motion.copy(), np.diag(1.0 / EXPECTED**2)
    scaled = weight / (SCALE**2 * SHARED)
    bounds = np.searchsorted(frame, np.arange(len(motion) + 1))
    for index, (first, last) in enumerate(pairwise(bounds)):
        mine = jacobian[first:last] * scaled[first:last, None]
        normal = mine.T @ jacobian[first:last] + precision
        pull = mine.T @ residual[first:last] + precision @ motion[index]
        better[index] -= DAMPING * np.linalg.solve(normal, pull)
    return better - better.mean(axis=0), cost
