"""The same mesh file imported again: nothing piles up, and nothing of the artist's is lost."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from fipt_blender.blend.capture import mesh_import
from fipt_blender.blend.capture.facing import face_cameras
from fipt_blender.blend.capture.importing import import_mesh
from fipt_blender.blend.marks import VIEW
from fipt_blender.core import conventions
from samples import artist

pytestmark = pytest.mark.usefixtures("registered")
KINDS = ("objects", "meshes", "materials", "images", "collections", "node_groups")


@pytest.fixture(params=["obj", "glb"])
def file(request, tmp_path):
    """A file of three cubes with two materials, one of which has a texture."""
    image = bpy.data.images.new("wood", 64, 64)
    image.filepath_raw, image.file_format = str(tmp_path / "wood.png"), "PNG"
    image.save()
    for number in range(3):
        bpy.ops.mesh.primitive_cube_add(location=(3.0 * number, 0.0, 0.0))
        material = bpy.data.materials.get(f"m{number % 2}") or bpy.data.materials.new(f"m{number % 2}")
        bpy.context.object.data.materials.append(material)
        if number == 1:
            material.use_nodes = True
            node = material.node_tree.nodes.new("ShaderNodeTexImage")
            node.image = image
            shader = material.node_tree.nodes["Principled BSDF"]
            material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    path = tmp_path / f"room.{request.param}"
    if request.param == "obj":
        bpy.ops.wm.obj_export(filepath=str(path), path_mode="COPY")
    else:
        bpy.ops.export_scene.gltf(filepath=str(path))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return path


def again(path, axis: str = "z") -> list[bpy.types.Object]:
    names = import_mesh(bpy.context.scene, path, conventions.world_from_source(axis))
    return [bpy.data.objects[name] for name in names]


def counts() -> dict[str, list[str]]:
    return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in KINDS}


def saved_size(tmp_path) -> int:
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    return (tmp_path / "room.blend").stat().st_size


@pytest.mark.parametrize("axes", ["zzzz", "yzyz"])
def test_importing_many_times_is_importing_once(file, tmp_path, axes):
    again(file)
    before, size = counts(), saved_size(tmp_path)
    for axis in axes:
        items = again(file, axis)
        assert counts() == before
        assert bpy.context.scene.fipt.capture.room_objects(bpy.context.scene) == items
    assert saved_size(tmp_path) == pytest.approx(size, rel=0.02)


CHANGES = {
    "moved": lambda item: setattr(item, "location", (0.0, 0.0, 1.0)),
    "modelled": lambda item: artist.delete_faces(item.name),
    "modifier": lambda item: artist.add_modifier(item.name, "BEVEL"),
    "vertex group": lambda item: item.vertex_groups.new(name="mine"),
    "UV layer": lambda item: item.data.uv_layers.new(name="mine"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_objects_that_the_artist_has_changed_stay_in_the_file(file, change):
    first = again(file)[0]
    CHANGES[change](first)
    bpy.context.view_layer.update()
    kept = artist.faces(first), len(first.modifiers), np.array(first.matrix_world).tolist()
    for _ in range(2):
        new = again(file)
        assert len(new) == 3 and first not in new
        assert (artist.faces(first), len(first.modifiers), np.array(first.matrix_world).tolist()) == kept
        assert [each.name for each in first.users_collection] == ["Earlier Rooms"]
    assert len(first.users_collection[0].objects) == 1


def test_materials_that_the_artist_has_changed_stay(file):
    first = again(file)[0]
    material = first.material_slots[0].material
    material.diffuse_color = (1.0, 0.0, 0.0, 1.0)
    pointer = bpy.data.objects.new("pointer", None)
    bpy.context.scene.collection.objects.link(pointer)
    pointer.constraints.new("COPY_LOCATION").target = first
    bpy.context.scene.fipt.hints.hints.add().object = first
    items = again(file)
    assert items[0].material_slots[0].material == material
    assert pointer.constraints[0].target == items[0]
    assert bpy.context.scene.fipt.hints.hints[0].object == items[0]


def test_surfaces_face_the_cameras_that_see_them():
    """A room that a program wrote inside out, with a picture's frame in it and one that is right."""
    scene, items = bpy.context.scene, []
    for size, place, turned in ((4.0, 0.0, False), (0.3, 1.2, True), (0.3, -1.2, False)):
        bpy.ops.mesh.primitive_cube_add(size=size, location=(place, 0.0, 0.0))
        items.append(bpy.context.object)
        mesh = items[-1].data
        mesh.normals_split_custom_set([tuple(normal.vector) for normal in mesh.corner_normals])
        if turned:
            mesh_import.transform_mesh(mesh, np.diag([-1.0, 1.0, 1.0, 1.0]))
            mesh.flip_normals()
    for number in range(3):
        camera = bpy.data.objects.new("view", bpy.data.cameras.new("view"))
        camera[VIEW], camera.location = str(number), (0.0, 0.4 * number - 0.4, 0.1)
        scene.collection.objects.link(camera)
    face_cameras(scene, items)
    for item, side in zip(items, (-1.0, 1.0, 1.0), strict=True):
        for face in item.data.polygons:
            assert side * face.normal.dot(face.center) > 0.0
            assert all(item.data.corner_normals[loop].vector.dot(face.normal) > 0.99 for loop in face.loop_indices)
