# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The room simplified in the scene: the budget is kept, small objects stay, and it can be taken back."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from fipt_blender.blend.marks import ORIGINAL_MESH
from fipt_blender.blend.room.exporting import collect_room
from fipt_blender.blend.room.simplifying import MODIFIER

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def room() -> list[bpy.types.Object]:
    """A wavy wall of 7,200 triangles and a cube, which are the scene's room."""
    collection = bpy.data.collections.new("Mine")
    bpy.context.scene.collection.children.link(collection)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=60, y_subdivisions=60)
    wall = bpy.context.object
    for vertex in wall.data.vertices:
        vertex.co.z = 0.1 * np.sin(3.0 * vertex.co.x)
    bpy.ops.mesh.primitive_cube_add(location=(0.0, 0.0, 2.0))
    objects = [wall, bpy.context.object]
    for item in objects:
        bpy.context.scene.collection.objects.unlink(item)
        collection.objects.link(item)
    bpy.context.scene.fipt.capture.room = collection
    return objects


def test_the_room_keeps_to_its_budget(room: list[bpy.types.Object]) -> None:
    wall, cube = room
    settings = bpy.context.scene.fipt.capture
    settings.triangles = 1000
    assert bpy.ops.fipt.simplify_room() == {"FINISHED"}
    assert not cube.modifiers and len(collect_room(room).triangles) == pytest.approx(1000, abs=20)
    assert len(wall.data.polygons) == 3600  # the artist's mesh is as it was
    settings.triangles = 2000
    bpy.ops.fipt.simplify_room()
    assert [modifier.name for modifier in wall.modifiers] == [MODIFIER]
    assert len(collect_room(room).triangles) == pytest.approx(2000, abs=20)
    settings.triangles = 0
    bpy.ops.fipt.simplify_room()
    assert not wall.modifiers and len(collect_room(room).triangles) == 7212


def test_a_room_with_results_or_without_meshes_is_refused(room: list[bpy.types.Object]) -> None:
    wall, _ = room
    wall[ORIGINAL_MESH] = wall.data
    with pytest.raises(RuntimeError, match="Results are applied"):
        bpy.ops.fipt.simplify_room()
    for item in room:
        bpy.data.objects.remove(item)
    assert not bpy.ops.fipt.simplify_room.poll()
