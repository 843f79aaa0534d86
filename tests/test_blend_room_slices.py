"""Exporting the room in slices: same result as at once, while the artist works; nothing is left behind."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from fipt_blender.blend.marks import ORIGINAL_MESH
from fipt_blender.blend.room import exporting
from fipt_blender.blend.room.originals import set_result_mesh, shows_original
from fipt_blender.blend.room.simplifying import MODIFIER
from fipt_blender.core.run.errors import FiptError
from samples.at_once import collect_room
from samples.counted import counted_calls


@pytest.fixture
def objects():
    """A large grid, and some cubes with modifiers and materials."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=150, y_subdivisions=150, size=4.0)
    made = [bpy.context.object]
    for index in range(5):
        bpy.ops.mesh.primitive_cube_add(location=(index, 0, 1))
        item = bpy.context.object
        item.modifiers.new("Bevel", "BEVEL").width = 0.1
        item.data.materials.append(bpy.data.materials.new(f"paint {index}"))
        made.append(item)
    return made


def names() -> dict[str, list[str]]:
    return {kind: sorted(getattr(bpy.data, kind).keys()) for kind in ("objects", "meshes", "materials")}


def test_slices_share_the_work_and_give_the_same_room(objects):
    before = names()
    at_once = collect_room(objects)
    slices, work = exporting.collect_room(objects), []
    while True:
        try:
            with counted_calls() as counted:
                next(slices)
        except StopIteration as end:
            room = end.value
            break
        finally:
            work.append(counted.calls)
        bpy.data.objects.new("the artist's", None)  # may invalidate pointers, not names
    assert len(work) > len(objects) + 2 and max(work) < 0.25 * sum(work), work
    np.testing.assert_equal(vars(room), vars(at_once))
    assert names()["meshes"] == before["meshes"]


def interrupt(objects, change) -> str:
    slices = exporting.collect_room(objects)
    for _ in range(2):
        next(slices)
    change()
    with pytest.raises(FiptError) as caught:
        for _ in slices:
            pass
    return caught.value.code


def test_changing_the_room_meanwhile_is_refused(objects):
    assert interrupt(objects, lambda: bpy.data.objects.remove(bpy.data.objects["Cube.001"])) == "room-changed"


def test_an_object_in_edit_mode_is_refused(objects):
    def edit():
        bpy.context.view_layer.objects.active = bpy.data.objects["Cube.002"]
        bpy.ops.object.mode_set(mode="EDIT")

    assert interrupt(objects, edit) == "room-edited"
    bpy.ops.object.mode_set(mode="OBJECT")


def test_results_are_not_exported_and_stay_shown(objects):
    expected = collect_room(objects)
    ours = bpy.data.meshes.new("ours")
    ours.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    set_result_mesh(objects[1], ours)
    room = collect_room(objects)
    np.testing.assert_equal(vars(room), vars(expected))
    assert objects[1].data == ours and not shows_original(objects[1])


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
