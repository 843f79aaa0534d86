# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""After an estimation: results are applied, the room is seen from inside, walls are hidden from behind."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from fipt_blender.jobs import running, session

pytestmark = pytest.mark.usefixtures("registered")


@pytest.mark.parametrize("wanted", [True, False])
def test_the_results_of_an_estimation_are_applied_if_the_artist_wants_that(scene, wanted):
    folder = Path(scene.fipt.run_folder)
    scene.fipt.estimate.apply_when_finished = wanted
    session.after_job(running.RunningJob("Estimate", "estimate", scene.name, folder, state="cancelled"))
    assert not scene.fipt.materials.object_count
    session.after_job(running.RunningJob("Estimate", "estimate", scene.name, folder, state="finished"))
    assert bool(scene.fipt.materials.object_count) is wanted


def test_results_wait_where_the_artist_is_in_edit_mode(scene):
    bpy.context.view_layer.objects.active = bpy.data.objects["cube"]
    bpy.ops.object.mode_set(mode="EDIT")
    folder = Path(scene.fipt.run_folder)
    session.after_job(running.RunningJob("Estimate", "estimate", scene.name, folder, state="finished"))
    assert not scene.fipt.materials.object_count
    bpy.ops.object.mode_set(mode="OBJECT")
