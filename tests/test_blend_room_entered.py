# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""After an estimation: results are applied, the room is seen from inside, walls are hidden from behind."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from fipt_blender.blend.capture import look
from fipt_blender.blend.marks import VIEW
from fipt_blender.jobs import running, session

pytestmark = pytest.mark.usefixtures("registered")


def add_views(scene: bpy.types.Scene, *splits: str) -> None:
    """A view of each split, with a camera at the centre of `make_scene`'s cube."""
    for index, split in enumerate(splits):
        camera = bpy.data.objects.new(f"view {index}", bpy.data.cameras.new("camera"))
        camera.location = (0.0, 5.0, 0.0)
        scene.collection.objects.link(camera)
        view = scene.fipt.capture.views.add()
        view.name = view.camera = camera.name
        view.split = split
        camera[VIEW] = view.name
    bpy.context.view_layer.update()


@pytest.mark.parametrize(("inward", "share"), [(False, 0.0), (True, 1.0)])
def test_walls_that_face_inwards_are_hidden_from_behind(monkeypatch, inward, share):
    scene = bpy.context.scene
    add_views(scene, "train")
    bpy.ops.mesh.primitive_cube_add(location=(0.0, 5.0, 0.0))
    cube = bpy.context.object
    if inward:
        cube.data.flip_normals()
    material = bpy.data.materials.new("wall")
    cube.data.materials.append(material)
    assert look.inward_share([cube], cube.location) == share
    monkeypatch.setattr(look, "room_with_results", lambda scene: [cube])
    look.cull_outside(scene)
    assert material.use_backface_culling is look.is_culled(scene) is inward


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
