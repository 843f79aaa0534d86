"""Which way is up in a capture, by how its cameras were held and by the planes of its room."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import conventions
from ..alignment.turns import rotation_between, turn_by
from ..robust import deviation, student_weights
from ..run.errors import FiptError, Problem, problem
from ..run.shapes import FARTHEST_UNITS
from .corrections import corrections
from .mesh_file import read_mesh

# Length of the mean up direction of the cameras' images above which it tells which way is up; it is short
# where cameras were turned on their sides.
CLEAR = 0.3
HELD = 0.03  # radians by which cameras that are held level are off at least
SURE = 4.0  # standard errors of the cameras' common up direction by which it may be off
LEVEL = 10.0  # degrees; cameras that roll by more, or whose direction may be off by more, were not held level
CONTRADICTED = 45.0  # degrees to the axis of the format, above which it is doubted
EXACT = 0.5  # degrees; an axis of the capture is up where the planes of the room are no farther from it
REACH = 30.0  # degrees; a vertical that is farther from the cameras' is another axis of the room
# Degrees by which surfaces of a room may be off from standing or lying, round by round.
LIMITS = (45.0, 35.0, 25.0, 18.0, 12.0, 8.0, 5.0, 5.0, 5.0)
MOST = 0.5  # share of the area that stands or lies in a room with a vertical
CELLS = 40  # edges of a cell, over which normals are averaged, in the diagonal of the mesh
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Upright:
    """The vertical of a capture."""

    axis: str  # the source axis that is nearest to up, one of `conventions.UP_AXES`
    source: str  # what tells it: "option", "format", "planes" or "cameras"
    angle: float = 0.0  # degrees between up and the axis
    # (3, 3) rotation that precedes that of the axis; None where the axis itself is up
    turn: np.ndarray | None = None

    def world_from_source(self, scale: float) -> np.ndarray:
        """(4, 4) similarity from the source's coordinates, with so many metres per unit, to Blender's world.

        Raises:
            ValueError: that of `conventions.world_from_source`.
        """
        similarity = conventions.world_from_source(self.axis, scale)
        if self.turn is not None:
            similarity[:3, :3] = similarity[:3, :3] @ self.turn
        return similarity


class HeldLevel(NamedTuple):
    """How cameras were held."""

    up: np.ndarray  # (3,) their common up direction
    error: float  # degrees by which it may be off, 180 where they were not held level
    is_clear: bool  # whether its sign is known; otherwise it is that of phones turned to the left


def find_upright(poses: np.ndarray, mesh: Path | None) -> Upright:
    """The vertical of a capture whose format does not define it.

    It is the direction near to the cameras' common up direction about which the surfaces of the room stand or
    lie; without such a mesh that of the cameras. An axis of the source from which it does not clearly differ
    is kept, so that captures that stand upright stay as they are.

    Args:
        poses: (V, 4, 4), OpenCV axes.
        mesh: file in the same coordinates; one that can't be read here counts as none.
    """
    held = common_up(poses)
    found = None if mesh is None else _by_planes(mesh, held.up)
    up = held.up if found is None else found[0]
    axis = _nearest_axis(up)
    angle = _degrees(up, _direction(axis))
    source = "cameras" if found is None else "planes"
    if angle <= EXACT or (found is None and (angle <= held.error or held.error > LEVEL)):
        return Upright(axis, source)
    to_world = conventions.world_from_source(axis)[:3, :3]
    turn = rotation_between(to_world @ up, _Z)
    if found is not None:
        turn = _along_walls(turn @ to_world, *found[1:]) @ turn
    return Upright(axis, source, angle, to_world.T @ turn @ to_world)


def doubts(axis: str, poses: np.ndarray, source: str = "") -> list[Problem]:
    """A warning where cameras (V, 4, 4) were held level about another direction than a format's up axis.

    Those of OpenCV's axes instead of OpenGL's are held upside down, too.

    Args:
        source: name of the format.
    """
    held = common_up(poses)
    angle = _degrees(held.up, _direction(axis))
    nearest = angle if held.is_clear else min(angle, 180.0 - angle)
    if held.error > LEVEL or nearest <= CONTRADICTED:
        return []
    other = _nearest_axis(held.up)
    if _direction(other) @ _direction(axis) > -0.5:
        named = problem(
            "up-axis-doubtful.doubts", axis=axis.upper(), other=other.upper(), angle=angle, other_2=other
        )
        return [named]
    which = next(each.name for each in corrections(source) if each.poses is not None)
    names = axis.upper(), other.upper()
    return [problem("up-axis-doubtful.axes", axis=names[0], other=names[1], other_2=other, which=which)]


def common_up(poses: np.ndarray) -> HeldLevel:
    """The direction that is up for cameras (V, 4, 4) that were held level, in either format, tilted or not.

    A level camera has a horizontal X axis, or Y axis if it was turned on its side. The direction is the one
    most perpendicular to these axes.
    """
    axes = np.swapaxes(poses[:, :3, :2], 1, 2)  # (V, 2, 3)
    mean = -axes.mean(axis=0)
    is_clear = bool(np.linalg.norm(mean[1]) > CLEAR)
    # Phones on their sides mostly have the image's left side on top.
    start = mean[1] if is_clear or not mean[0].any() else mean[0]
    start = up = start / max(float(np.linalg.norm(start)), 1e-9)
    weights = np.ones(len(axes))
    for _ in range(5):  # which axis is the horizontal one depends on the direction; it settles at once
        horizontal = axes[np.arange(len(axes)), np.abs(axes @ up).argmin(axis=1)]
        spread = horizontal.T @ (weights[:, None] * horizontal) / weights.sum()
        # Decides only where all cameras look along one line.
        up = np.linalg.eigh(spread + 1e-3 * (np.eye(3) - np.outer(start, start)))[1][:, 0]
        off = horizontal @ up
        weights = student_weights((off / deviation(off, HELD)) ** 2)
    roll = max(float(np.sqrt(np.mean(off**2))), HELD)
    least = np.linalg.eigvalsh(horizontal.T @ horizontal)[1]  # across up, where it is known least
    error = float(np.degrees(SURE * roll / np.sqrt(max(least, 1e-9))))
    return HeldLevel(up if up @ start >= 0.0 else -up, error if roll < np.radians(LEVEL) else 180.0, is_clear)


def _by_planes(mesh: Path, near: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Up by the surfaces of a mesh: the direction (3,), and their normals (N, 3) with areas (N,).

    Args:
        near: (3,) direction to which it is near.

    Returns:
        None where the mesh is unreadable, or less than `MOST` of its area stands or lies.
    """
    try:
        vertices, triangles = read_mesh(mesh)
    except FiptError:
        return None
    if not len(triangles) or not np.abs(vertices).max() < FARTHEST_UNITS:
        return None
    normals, areas = _mean_normals(vertices, triangles, near)
    up = near
    for limit in LIMITS:
        stands = np.abs(normals @ up) < np.sqrt(0.5)
        weights = areas * np.maximum(1.0 - _off(normals, up) / limit, 0.0)
        spread = (normals * (np.where(stands, 1.0, -1.0) * weights)[:, None]).T @ normals
        # Decides only where all surfaces are parallel.
        spread += 1e-3 * areas.sum() * (np.eye(3) - np.outer(near, near))
        up = np.linalg.eigh(spread)[1][:, 0]
    up = up if up @ near > 0.0 else -up
    stable = areas[_off(normals, up) <= LIMITS[-1]].sum() > MOST * areas.sum()
    return (up, normals, areas) if stable and _degrees(up, near) <= REACH else None


def _mean_normals(
    vertices: np.ndarray, triangles: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (N, 3) of a mesh with their areas (N,), averaged over cells against the noise of scans.

    Args:
        up: (3,) roughly; what faces it, what faces down and what stands are averaged apart.
    """
    corners = vertices[triangles]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.rint(vectors @ up / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    places = (corners.mean(axis=1) - low) / max(float(np.linalg.norm(high - low)), 1e-300)
    keys = np.floor(CELLS * places) @ [CELLS**2 * 9.0, CELLS * 6.0, 3.0] + facing
    group = np.unique(keys, return_inverse=True)[1].reshape(-1)
    sums = np.stack([np.bincount(group, 0.5 * column) for column in vectors.T], axis=1)
    areas = np.linalg.norm(sums, axis=1)
    return sums / np.maximum(areas, 1e-300)[:, None], areas


def _along_walls(rotation: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) about Z by which most walls become parallel to X and Y, up to 45 degrees.

    Args:
        rotation: (3, 3) by which the normals get Z up.
    """
    turned = normals @ rotation.T
    walls = areas * (np.abs(turned[:, 2]) < np.sin(np.radians(LIMITS[-1])))
    # Four times the azimuth is the same for all walls of a room with right angles.
    common = walls @ np.exp(4j * np.arctan2(turned[:, 1], turned[:, 0]))
    if np.abs(common) <= MOST * walls.sum():
        return np.eye(3)
    return turn_by(np.array([0.0, 0.0, -np.angle(common) / 4.0]))


def _off(normals: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(N,) degrees by which surfaces neither stand nor lie."""
    angles = np.degrees(np.arcsin(np.clip(np.abs(normals @ up), 0.0, 1.0)))
    return np.minimum(angles, 90.0 - angles)


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def _nearest_axis(up: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(up)))
    return ("-" if up[axis] < 0.0 else "") + "xyz"[axis]


def _direction(axis: str) -> np.ndarray:
    return conventions.world_from_source(axis)[2, :3]
