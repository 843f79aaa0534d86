"""Usual mistakes of programs that export cameras and meshes: one table of what corrects each.

Each is tried by :mod:`.mistakes`, one at a time, and applied by its name (`--correct`). Poses are camera to
world with OpenCV's axes, as readers return them; what a file stores is one step away, by its format.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from ..alignment.turns import quaternion_rotation, turn_by
from ..conventions import CAMERA_AXES
from ..run.errors import FiptError


class Stored(NamedTuple):
    """How a format stores poses."""

    axes: str = "opencv"  # of its cameras, one of `CAMERA_AXES`
    inverse: bool = False  # whether poses lead from the world to the camera
    # Of quaternions, what leads from the order that is expected to the other usual one; 0 without
    roll: int = 0


# Formats that people write themselves; of others, poses are camera to world with OpenCV's axes.
STORED = {
    **dict.fromkeys(("transforms", "polycam", "3d-scanner-app"), Stored("opengl")),
    "record3d": Stored("opengl", roll=-1),
    "bundler": Stored("opengl", inverse=True),
    "colmap": Stored(inverse=True, roll=1),
    "opensfm": Stored(inverse=True),
    "nvm": Stored(roll=1),
    "stray-scanner": Stored(roll=-1),
}
# What a mesh is multiplied by, whose unit is another one than that of the cameras.
UNITS = (0.001, 0.01, 0.0254, 0.3048, 1.0 / 0.3048, 1.0 / 0.0254, 100.0, 1000.0)
NONE = "none"  # for files that are right however they look


@dataclass(frozen=True, eq=False)
class Correction:
    """What undoes a mistake."""

    name: str  # of the option
    says: str  # what is true of the files then
    poses: Callable[[np.ndarray], np.ndarray] | None = None  # from poses (V, 4, 4) to the right ones
    mesh: np.ndarray | None = None  # similarity or mirror (4, 4) from the mesh file to the right one


def corrections(source: str) -> list[Correction]:
    """All single corrections of captures of a format: those of cameras, units, turns, and mirrors."""
    found = [_of_axes(STORED.get(source, Stored()).axes, axes) for axes in CAMERA_AXES]
    found = [each for each in found if each.poses is not None] + _of_poses(STORED.get(source, Stored()))
    for unit in UNITS:
        place = np.diag([unit, unit, unit, 1.0])
        found.append(Correction(f"scale-{unit:.6g}", f"the mesh is scaled by {unit:.4g}", mesh=place))
    found += _turns()
    for axis in range(3):
        mirror = np.diag([-1.0 if axis == other else 1.0 for other in range(4)])
        found.append(
            Correction(f"mirror-{'xyz'[axis]}", f"the mesh is mirrored along {'XYZ'[axis]}", mesh=mirror)
        )
    return found


def both(source: str) -> list[Correction]:
    """Pairs of corrections that are usual together: inverse poses of other axes, a unit with Y and Z up."""
    known = {each.name: each for each in corrections(source)}
    pairs = [("inverse", name) for name in known if name.startswith("axes-")]
    pairs += [
        (turn, name) for turn in ("turn-x90", "turn-x270") for name in known if name.startswith("scale-")
    ]
    return [_joined(known[one], known[other]) for one, other in pairs]


def named(source: str, names: str) -> list[Correction]:
    """The corrections with these names, in their order."""
    known = {each.name: each for each in corrections(source)}
    wanted = [name.strip() for name in names.split("+") if name.strip() not in ("", NONE)]
    if unknown := [name for name in wanted if name not in known]:
        error = f"{NONE}, or of these, joined by +: {', '.join(known)}"
        raise FiptError("setting-invalid.converted", value=unknown[0], name="correct", error=error)
    return [known[name] for name in wanted]


def _joined(one: Correction, other: Correction) -> Correction:
    name, says = f"{one.name}+{other.name}", f"{one.says}, and {other.says}"
    if one.poses is not None and other.poses is not None:
        first, second = one.poses, other.poses
        return Correction(name, says, lambda poses: second(first(poses)))
    assert one.mesh is not None and other.mesh is not None, "both are of cameras, or of the mesh"
    return Correction(name, says, mesh=other.mesh @ one.mesh)


def _of_axes(stored: str, axes: str) -> Correction:
    """Cameras of other axes than those that the format has."""
    says, matrix = CAMERA_AXES[axes]
    change = CAMERA_AXES[stored][1] @ matrix
    poses = None if axes == stored else lambda poses: poses @ change
    return Correction(f"axes-{axes}", f"the cameras have the axes {says}", poses)


def _of_poses(stored: Stored) -> list[Correction]:
    """What goes wrong with the matrices or quaternions that a file stores."""
    axes = CAMERA_AXES[stored.axes][1]

    def changed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        def poses(read: np.ndarray) -> np.ndarray:
            matrix = read @ axes
            if stored.inverse:
                return np.asarray(np.linalg.inv(change(np.linalg.inv(matrix))) @ axes)
            return np.asarray(change(matrix) @ axes)

        return poses

    way = "from the camera to the world" if stored.inverse else "from the world to the camera"
    centre = "the cameras' positions" if stored.inverse else "those of the inverse matrices, not positions"
    found = [
        Correction("inverse", f"the poses lead {way}", changed(np.linalg.inv)),
        Correction("transpose", "the rotations are transposed", changed(_transposed)),
        Correction("translation", f"the translations are {centre}", changed(_translated)),
    ]
    if stored.roll:
        order = "x, y, z, w" if stored.roll > 0 else "w, x, y, z"
        says = f"the quaternions are stored in the order {order}"
        found.append(Correction("quaternion", says, changed(lambda poses: _rolled(poses, stored.roll))))
    return found


def _transposed(poses: np.ndarray) -> np.ndarray:
    result = poses.copy()
    result[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    return result


def _translated(poses: np.ndarray) -> np.ndarray:
    """Poses whose last column is that of their inverse."""
    result = poses.copy()
    result[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], poses[:, :3, 3])
    return result


def _rolled(poses: np.ndarray, roll: int) -> np.ndarray:
    """Poses whose quaternions' numbers are in another order."""
    result = poses.copy()
    quaternions = np.array([_quaternion(pose[:3, :3]) for pose in poses]).reshape(-1, 4)
    result[:, :3, :3] = np.moveaxis(quaternion_rotation(np.roll(quaternions, roll, axis=1).T), -1, 0)
    return result


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """The quaternion w, x, y, z of a rotation (3, 3), by the eigenvector of its matrix (Bar-Itzhack 2000)."""
    r, trace = rotation, float(np.trace(rotation))
    upper = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 1:], matrix[1:, 0] = trace, upper, upper
    matrix[1:, 1:] = r + r.T - trace * np.eye(3)
    return np.asarray(np.linalg.eigh(matrix)[1][:, 3])


def _turns() -> list[Correction]:
    """The 23 turns by right angles, those about one axis first."""
    steps = [(axis, degrees) for axis in range(3) for degrees in (90, 180, 270)]
    found: list[Correction] = []
    seen = [np.eye(3)]
    for turns in [*((step,) for step in steps), *product(steps, steps)]:
        matrix = _turn(turns)
        if not any(np.allclose(matrix, other) for other in seen):
            seen.append(matrix)
            name = "-".join(f"{'xyz'[axis]}{degrees}" for axis, degrees in turns)
            says = " and then ".join(f"by {degrees} degrees about {'XYZ'[axis]}" for axis, degrees in turns)
            place = np.eye(4)
            place[:3, :3] = matrix
            found.append(Correction(f"turn-{name}", f"the mesh is turned {says}", mesh=place))
    return found


def _turn(turns: Sequence[tuple[int, int]]) -> np.ndarray:
    matrix = np.eye(3)
    for axis, degrees in turns:
        matrix = np.round(turn_by(np.radians(degrees) * np.eye(3)[axis])) @ matrix
    return matrix
