"""Camera poses of the example capture: held-back views by hand, training views by greedy coverage.

Poses are camera-to-world in the files' Y-up world with camera axes X left, Y up, Z forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from room_furniture import BULB_CENTRE, BULB_RADIUS
from room_shell import DEPTH, PANEL_AT, WIDTH

FOV_X = math.radians(75)
HELD_BACK = [  # position, target; Blender's world
    ((1.75, 1.30, 1.60), (-1.30, -0.35, 0.70)),
    ((-1.95, -1.25, 1.50), (1.40, 0.55, 0.75)),
    ((1.55, -1.45, 1.75), (-1.75, 1.05, 0.95)),
    ((-0.55, 1.35, 1.45), (1.20, -1.30, 0.85)),
    ((0.20, 0.45, 1.30), (2.50, -0.35, 1.15)),
    ((-1.10, 0.55, 2.05), (-2.05, 1.22, 0.95)),
]
FIRST_TRAINING = [((1.60, 1.00, 1.55), (-1.60, -0.30, 0.75))]
BULB_VIEWS = 7


def y_up(points: np.ndarray) -> np.ndarray:
    """Blender's world (Z up) to the files' world (Y up), (..., 3)."""
    points = np.asarray(points, float)
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], -1)


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """4x4 pose in the files' convention from two points in Blender's world."""
    forward = np.subtract(target, position)
    forward = forward / np.linalg.norm(forward)
    left = np.cross([0.0, 0.0, 1.0], forward)
    left /= np.linalg.norm(left)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([y_up(left), y_up(np.cross(forward, left)), y_up(forward)], axis=1)
    pose[:3, 3] = y_up(position)
    return pose


@dataclass
class Candidate:
    """A pose with what a coarse image of it sees: ids of surface cells, and whether it sees the bulb."""

    position: np.ndarray
    target: np.ndarray
    cells: np.ndarray
    sees_bulb: bool


def examine(tree: BVHTree, position: np.ndarray, target: np.ndarray, aspect: float) -> Candidate | None:
    """Cast a coarse grid of rays; None where the camera stands in or too close to something."""
    outside = abs(position[0]) > WIDTH / 2 - 0.3 or abs(position[1]) > DEPTH / 2 - 0.3
    if outside or tree.find_nearest(Vector(position))[3] < 0.28:
        return None
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    reach = math.tan(FOV_X / 2)
    cells, distances = [], []
    for y in np.linspace(-1, 1, 13) * reach * aspect:
        for x in np.linspace(-1, 1, 22) * reach:
            direction = forward + x * right + y * up
            hit, normal, _, distance = tree.ray_cast(Vector(position), Vector(direction))
            if hit is not None:
                distances.append(distance)
                axis = int(np.argmax(np.abs(normal)))
                key = np.floor(np.array(hit) / 0.25).astype(int) + 64
                cells.append(((key[0] * 128 + key[1]) * 128 + key[2]) * 6 + 2 * axis + (normal[axis] > 0))
    if np.median(distances) < 1.0 or np.quantile(distances, 0.03) < 0.35:
        return None
    to_bulb = np.subtract(BULB_CENTRE, position)
    depth = to_bulb @ forward
    inside = (
        depth > 0
        and abs(to_bulb @ right) < 0.9 * reach * depth
        and abs(to_bulb @ up) < 0.9 * reach * aspect * depth
    )
    sees = False
    if inside:
        hit = tree.ray_cast(Vector(position), Vector(to_bulb))[0]
        sees = hit is not None and (hit - Vector(BULB_CENTRE)).length < 1.5 * BULB_RADIUS
    return Candidate(position, target, np.unique(cells), bool(sees))


def sample_candidate(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A position at 0.8 to 2.2 m and a target: any direction, a fixture, or the furniture."""
    position = np.array(
        [
            rng.uniform(0.35 - WIDTH / 2, WIDTH / 2 - 0.35),
            rng.uniform(0.35 - DEPTH / 2, DEPTH / 2 - 0.35),
            rng.uniform(0.8, 2.2),
        ]
    )
    kind = rng.random()
    if kind < 0.12:
        return position, np.array([*PANEL_AT, 2.8]) + rng.normal(0, 0.4, 3)
    if kind < 0.45:
        low, high = (-2.3, -1.8, 0.0), (2.3, 1.8, 1.6)
        return position, rng.uniform(low, high)
    yaw = rng.uniform(0, 2 * math.pi)
    pitch = math.radians(
        rng.uniform(-50, -15) if kind < 0.62 else rng.uniform(15, 45) if kind < 0.78 else rng.uniform(-15, 10)
    )
    return position, position + np.array(
        [math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch)]
    )


def sample_bulb_candidate(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A position from which the bulb may show over the rim of the shade."""
    away, reach = rng.uniform(-2.0, 0.45) * math.pi / 2, rng.uniform(0.5, 1.6)
    position = np.array(
        [
            BULB_CENTRE[0] + reach * math.cos(away),
            BULB_CENTRE[1] + reach * math.sin(away),
            rng.uniform(1.75, 2.2),
        ]
    )
    return position, np.array(BULB_CENTRE) + rng.normal(0, 0.22, 3)


def training_poses(tree: BVHTree, count: int, seed: int, aspect: float) -> list[np.ndarray]:
    """`count` poses; each adds most to what the ones before it saw, with several looks into the lamp."""
    rng = np.random.default_rng([seed, 77])
    size = 40 + 9 * count
    pool = [examine(tree, *map(np.array, pair), aspect) for pair in FIRST_TRAINING]
    chosen = [candidate for candidate in pool if candidate is not None][:count]
    free = [examine(tree, *sample_candidate(rng), aspect) for _ in range(size)]
    lamp = [examine(tree, *sample_bulb_candidate(rng), aspect) for _ in range(size // 2)]
    pool = [c for c in free + lamp if c is not None]
    seen: dict[int, int] = {}
    for candidate in chosen:
        for cell in candidate.cells:
            seen[cell] = seen.get(cell, 0) + 1
    while len(chosen) < count and pool:
        of_bulb = sum(candidate.sees_bulb for candidate in chosen)
        due = of_bulb < BULB_VIEWS * len(chosen) / count * 1.3 and of_bulb < BULB_VIEWS
        eligible = [c for c in pool if c.sees_bulb] if due else pool
        eligible = eligible or pool
        gains = [sum(0.4 ** seen.get(cell, 0) for cell in c.cells) for c in eligible]
        best = eligible[int(np.argmax(gains))]
        chosen.append(best)
        pool = [c for c in pool if c is not best and np.linalg.norm(c.position - best.position) > 0.15]
        for cell in best.cells:
            seen[cell] = seen.get(cell, 0) + 1
    return [look_at(c.position, c.target) for c in chosen]


def held_back_poses(count: int) -> list[np.ndarray]:
    """The first `count` held-back poses."""
    return [look_at(np.array(position), np.array(target)) for position, target in HELD_BACK[:count]]
