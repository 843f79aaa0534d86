# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Placements of the cameras that the engine has found: the best one is taken, others can be chosen."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.run.contents import Placements
from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..marks import VIEW
from .pairs import imported_cameras, move_cameras, place_camera, solve_pairs


def take_alignment(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Move the cameras as RUN/align/align.json says.

    Raises:
        FiptError: ``file-missing``, ``file-damaged`` or ``alignment-own-cameras``.
    """
    aligned = read_document(run.align / "align.json", Placements, "Align the cameras again.")
    settings = scene.fipt.alignment
    settings.candidates.clear()
    for placement in aligned.candidates:
        candidate = settings.candidates.add()
        candidate.matrix = np.ravel(placement.similarity).tolist()
        candidate.error, candidate.inliers = placement.error, placement.inliers
    settings.active_candidate, settings.summary = 0, aligned.text
    if aligned.candidates:
        move_cameras(scene, np.array(aligned.candidates[0].similarity))
    for item in imported_cameras(scene):
        if item[VIEW] in aligned.poses:
            place_camera(item, np.array(aligned.poses[item[VIEW]]))
    _moved(scene)


def choose_placement(scene: bpy.types.Scene, index: int) -> None:
    """Move the cameras from the placement in which they are to another one of the list.

    Raises:
        FiptError: ``alignment-placement`` or ``alignment-own-cameras``.
    """
    settings = scene.fipt.alignment
    if index >= len(settings.candidates):
        raise FiptError(
            "alignment-placement",
            f"There is no placement {index}; the list has {len(settings.candidates)}.",
            "Choose one of the list.",
        )
    now, chosen = (
        np.array(settings.candidates[number].matrix, np.float64).reshape(4, 4)
        for number in (settings.active_candidate, index)
    )
    move_cameras(scene, chosen @ np.linalg.inv(now))
    settings.active_candidate = index
    _moved(scene)


def _moved(scene: bpy.types.Scene) -> None:
    """What depended on the cameras' poses is no longer known."""
    solve_pairs(scene)
    capture = scene.fipt.capture
    for view in capture.views:
        view.checked, view.warning, view.misfit = False, "", -1.0
    capture.misfit = capture.unseen_share = -1.0
    capture.count_views()
