# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Moves the cameras of a capture to a mesh from another program, by the solve's points or by depth images.

From then on, the capture has the coordinates of the mesh: its up axis is found anew, its unit is the mesh's.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..alignment.mesh_file import read_mesh
from ..alignment.registration import Candidate, register
from ..alignment.surface import Surface, sample_surface, unit_of_height
from ..conventions import split_similarity, transform_poses
from ..run.errors import FiptError
from .depth_points import alignment_points
from .rig import Note, Rig

MOST_POINTS = 4000  # more do not make the alignment better, only slower
SURE = 0.97  # share of points near the mesh above which it is not tried mirrored
MIRRORED = 0.6  # score with the mesh mirrored over that without, below which it is mirrored
LEAST_INLIERS = 0.6  # of the points near the mesh; a wrong alignment leaves fewer
ALIKE = 1.3  # a second alignment whose score is at most so many times the best one's is named


def aligned_to_mesh(capture: Path, rig: Rig, mesh: Path | None) -> Rig:
    """The rig in the coordinates of a mesh, by the points of the capture that it was read from.

    Raises:
        FiptError: those of `align_rig` and `alignment_points`, or ``mesh-missing``.
    """
    if mesh is None:
        raise FiptError(
            "mesh-missing", "There is no mesh to which the cameras could be aligned.", "Choose the mesh file."
        )
    return align_rig(rig, alignment_points(capture, rig), mesh)


def align_rig(rig: Rig, points: np.ndarray, mesh: Path) -> Rig:
    """The rig in the coordinates of a mesh, with notes on how well its points fit.

    Args:
        rig: in the coordinates of the solve.
        points: (N, 3) sparse points of the solve.
        mesh: OBJ, PLY, STL or glTF file.

    Raises:
        FiptError: ``alignment-points``, ``alignment-failed``, or one of `read_mesh` and `sample_surface`.
    """
    rng = np.random.default_rng(0)
    surface = sample_surface(*read_mesh(mesh), rng)
    up = -np.mean([view.camera_to_world[:3, 1] for view in rig.views], axis=0)
    best, *others = placements(points, surface, rng, up, f"the mesh {mesh}")
    views = tuple(
        replace(view, camera_to_world=transform_poses(best.similarity, view.camera_to_world))
        for view in rig.views
    )
    notes = [_result(best, min(len(points), MOST_POINTS))]
    alike = sum(other.score <= ALIKE * best.score and other.inliers >= LEAST_INLIERS for other in others)
    if alike:
        notes.append(_ambiguous(alike))
    notes += unit_notes(surface, best.similarity, up)
    return replace(rig, views=views, up_axis=None, notes=(*rig.notes, *notes))


def placements(
    points: np.ndarray, surface: Surface, rng: np.random.Generator, up: np.ndarray, mesh: str
) -> list[Candidate]:
    """Placements of a solve's points on a mesh, the best first.

    Args:
        points: (N, 3) of the solve.
        surface: of the mesh.
        rng: chooses among many points.
        up: (3,) mean up direction of the cameras, short where they are turned in all ways.
        mesh: what the mesh is called in errors.

    Raises:
        FiptError: ``alignment-points``, ``alignment-failed``, or ``mesh-mirrored``.
    """
    chosen = points[rng.permutation(len(points))[:MOST_POINTS]]
    known_up = up if float(np.linalg.norm(up)) > 0.3 else None
    found = register(chosen, surface, rng, known_up)
    if found[0].inliers < SURE:
        mirror = np.array([-1.0, 1.0, 1.0])
        other = register(chosen * mirror, surface, rng, None if known_up is None else known_up * mirror)[0]
        if other.inliers >= LEAST_INLIERS and other.score < MIRRORED * found[0].score:
            raise FiptError(
                "mesh-mirrored",
                f"It seems that {mesh} is mirrored: with one axis negated, {100.0 * other.inliers:.0f} % of"
                f" the points of the camera solve lie near it, otherwise {100.0 * found[0].inliers:.0f} %.",
                "Export it again without negated axes, or scale its object by -1 along one axis.",
            )
    check_fit(found[0], mesh)
    return found


def check_fit(best: Candidate, mesh: str) -> None:
    """Refuse a placement that leaves many points far from the mesh.

    Raises:
        FiptError: ``alignment-failed``.
    """
    if best.inliers < LEAST_INLIERS:
        raise FiptError(
            "alignment-failed",
            f"Only {100.0 * best.inliers:.0f} % of the points of the camera solve lie near {mesh}.",
            "Check that it shows the same room, or align by pairs of points (Capture > Alignment), or by hand"
            " with FIPT Alignment.",
        )


def _result(best: Candidate, count: int) -> Note:
    scale = split_similarity(best.similarity)[0]
    return Note(
        "mesh-aligned",
        f"The cameras were aligned to the mesh. {100.0 * best.inliers:.0f} % of {count} points lie near it, "
        f"half of all within {best.error:.3g} of its units. One unit of the solve is {scale:.5g} of these.",
        "Look through some views and check that the mesh's edges lie on those of the photographs.",
    )


def _ambiguous(alike: int) -> Note:
    return Note(
        "alignment-ambiguous",
        f"The mesh fits nearly as well in {alike} other ways, since the room looks alike from other sides.",
        "Look through some views; if they are wrong, move the cameras by hand with FIPT Alignment.",
    )


def unit_notes(surface: Surface, similarity: np.ndarray, up: np.ndarray) -> list[Note]:
    """A note where the height of the mesh is that of a room in another unit than metres."""
    direction = split_similarity(similarity)[1] @ up
    axis = int(np.argmax(np.abs(direction)))
    low, high = np.percentile(surface.points[:, axis], [1.0, 99.0])
    unit = unit_of_height(float(high - low))
    if unit is None or unit[0] == "meters":
        return []
    return [
        Note(
            "mesh-unit",
            f"The mesh is {high - low:.4g} units high, so it seems to be in {unit[0]}.",
            f"Set the scale to {unit[1]:g} meters per unit if it is not set yet.",
        )
    ]
