"""Results on the room: materials applied and reverted, fixtures and lights with the right radiance."""

import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from fipt_blender.blend.lights import light_state, world
from fipt_blender.blend.lights.area_lights import add_area_light
from fipt_blender.blend.marks import ADDED, DRAWN, ON
from fipt_blender.blend.results import applying
from fipt_blender.blend.room import originals
from fipt_blender.blend.room.mesh_arrays import vertex_positions
from fipt_blender.blend.room.result_meshes import clean_result_mesh, make_mesh
from fipt_blender.core import conventions
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.run_files import CLOSING, PANES, AddedSurfaces, RoomMesh, read_room
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.textures import bake
from samples.applied_rooms import ConstantFields, emitter, fingerprint, panel_and_cube
from samples.at_once import apply_results, collect_room, export_room, make_atlas
from samples.made_rooms import clean_run, with_panes
from samples.rendered_rooms import diffuse_floor
from samples.scans import scanned_box
from samples.spots import spot, white_world


@pytest.fixture
def objects():
    made = panel_and_cube()
    bpy.context.view_layer.update()
    return made


@pytest.fixture
def run(objects, run_folder):
    """A run of two objects."""
    prepare(run_folder, objects)
    return run_folder


def prepare(run, objects, **changes):
    arrays = export_room(objects, run)
    lamp = np.flatnonzero((arrays.triangle_object == 0) & (arrays.triangle_polygon == 2))
    fixture = emitter("Fixture.001", lamp, back=(0.0, 1.0, 0.0))
    write_json(run.emitters_json, {"fixtures": [fixture], "environment": None})
    settle(run, objects, **changes)


def settle(run, objects, **changes):
    """Make the atlas of what is in the run folder, and bake."""
    make_atlas(objects, run, make_settings(changes={"texel_density": 16.0, **changes}))
    bake.bake(run, ConstantFields())


def shown(objects):
    """Everything of objects that must be restored."""
    found = fingerprint(bpy.context.scene)
    return [found[name] for item in objects for name in (f"objects/{item.name}", f"meshes/{item.data.name}")]


def test_restoring_undoes_applying(run, objects):
    before = shown(objects)
    assert apply_results(run, objects) == []
    assert [[slot.material.name for slot in item.material_slots] for item in objects] == [["Panel FIPT"], ["Cube FIPT"]]
    assert len(objects[0].data.polygons) == 2  # the third is the fixture
    # Blender would draw edges without faces, black where a lamp on a scan had thousands.
    assert (len(objects[0].data.vertices), len(objects[0].data.edges)) == (6, 7)
    applied = shown(objects)
    assert apply_results(run, objects) == [] and shown(objects) == applied
    assert originals.restore_original(bpy.context.scene, objects) == [item.name for item in objects]
    assert shown(objects) == before
    assert "Panel" not in bpy.data.objects
    assert originals.restore_original(bpy.context.scene, objects) == []


def test_colour_attributes(run, objects):
    prepare(run, objects, atlas_mode="color_attribute")
    apply_results(run, objects)
    mesh = objects[1].data
    attribute = mesh.attributes["FIPT Base Color"]
    assert (attribute.data_type, attribute.domain) == ("FLOAT_COLOR", "CORNER")
    values = np.empty(len(mesh.loops) * 4, np.float32)
    attribute.data.foreach_get("color", values)
    assert np.allclose(values.reshape(-1, 4), (*ConstantFields.base_color, 1.0), atol=1e-5)
    white_world()
    assert spot(Vector((0, 5, 4)), Vector((0, 5, 0))).mean() < 0.9  # not the default white


def test_fixture_emits_its_radiance_on_each_side(run, objects):
    apply_results(run, objects)
    world.apply_environment(run)
    fixture = bpy.data.objects["Panel"]
    assert [each.name for each in fixture.users_collection] == ["Lamps"]
    normal = (fixture.matrix_world.to_3x3() @ fixture.data.polygons[0].normal).normalized()
    centre = fixture.matrix_world.translation
    assert (centre - Vector((2.5, 0.5, 0.0))).length < 1e-5
    # The mirrored panel's normals point up, like those of its triangles in room.npz.
    assert normal.z > 0.99
    front = spot(centre + 2 * normal, centre)
    assert np.allclose(front, [8.0, 4.0, 2.0], rtol=1e-4)
    back = spot(centre - 2 * normal, centre)
    assert np.allclose(back, [0.0, 1.0, 0.0], atol=1e-4)
    light_state.change(bpy.context.scene, fixture, {ON: False})
    assert not spot(centre + 2 * normal, centre).any()
    light_state.switch_all(True)
    assert np.allclose(spot(centre + 2 * normal, centre), front, rtol=1e-4)


def test_area_light_has_the_given_radiance():
    """A diffuse floor of albedo 0.5 below a square light: radiance by the analytic form factor."""
    radiance, height, half = np.array([3.0, 2.0, 1.0]), 1.0, 0.5
    corners = [(-half, -half, height), (-half, half, height), (half, half, height), (half, -half, height)]
    add_area_light("light", radiance, corners)
    diffuse_floor(0.2, 0.5)
    # Irradiance below the centre of a parallel square: 4 times the form factor of a corner.
    x = half / math.hypot(half, height)
    form = 4.0 / (2.0 * math.pi) * (2.0 * x * math.atan(half / math.hypot(half, height)))
    expected = 0.5 * radiance * form
    image = spot(Vector((0, -0.7, 0.7)), Vector((0, 0, 0)), 256, ortho=0.02)
    assert np.allclose(image.mean(axis=(0, 1)), expected, rtol=0.01)


def test_environment_direction(run):
    directions = conventions.equirect_pixel_directions(64, 32)
    write_exr(run.environment_exr, (directions * 0.5 + 0.5).astype(np.float32))
    data = read_document(run.emitters_json, dict)
    write_json(run.emitters_json, {**data, "environment": {"image": "environment.exr", "observed_share": 1.0}})
    bpy.data.batch_remove(list(bpy.data.objects))
    world.apply_environment(run)
    for direction in ((1, 0.2, 0.1), (-0.3, 1, 0.4), (0.2, -0.5, -0.8)):
        unit = Vector(direction).normalized()
        image = spot(Vector((0, 0, 0)), unit)
        assert np.allclose(image.mean(axis=(0, 1)), np.array(unit) * 0.5 + 0.5, atol=0.03)


def test_panes_become_an_object_of_the_room(run, objects):
    vertices = with_panes(run)
    frame = bpy.data.objects.new("frame", None)
    bpy.context.scene.collection.objects.link(frame)
    frame.matrix_world = Matrix.Translation((0, 0, 7))
    bpy.context.view_layer.update()
    objects[0].parent, objects[0].matrix_parent_inverse = frame, frame.matrix_world.inverted()
    settle(run, objects)
    assert not apply_results(run, objects)
    panes = bpy.data.objects[PANES]
    bpy.context.view_layer.update()
    corners = np.array([panes.matrix_world @ vertex.co for vertex in panes.data.vertices])
    assert corners == pytest.approx(vertices, abs=1e-6)
    assert panes.parent == frame and panes.data.materials[0].name == "FIPT Panes FIPT"
    assert panes.name in bpy.context.scene.collection.objects
    count = len(bpy.data.objects)
    assert apply_results(run, [*objects, panes]) == []
    assert len(bpy.data.objects) == count


def test_closed_holes_become_an_object_with_the_cleaned_vertices(run, objects):
    """Beside panes: each is an object of its own, and a second application finds both."""
    room = read_room(run)
    rim = room.vertices[room.triangles[:1]].reshape(3, 3)
    rows = np.array([[0, 1, 2]], np.int32)
    # As if the mesh were a scan whose cleaned copy lies a metre higher.
    with_panes(run, AddedSurfaces(rim, rows, room.corner_normals[:1], np.zeros(1, np.int64)), higher=1.0)
    found = read_room(run)
    assert found.objects[2:] == (CLOSING, PANES)
    assert found.triangle_material[-3:].tolist() == [room.triangle_material[0], -1, -1]
    settle(run, objects)
    assert not apply_results(run, objects)
    closing, panes = bpy.data.objects[CLOSING], bpy.data.objects[PANES]
    corners = np.array([closing.matrix_world @ vertex.co for vertex in closing.data.vertices])
    cleaned = rim + [0.0, 0.0, 1.0]
    assert np.abs(corners[:, None] - cleaned).max(axis=2).min(axis=1).max() < 1e-6
    assert apply_results(run, [*objects, closing, panes]) == []


def test_an_interrupted_application_adds_no_panes(run, objects):
    with_panes(run)
    settle(run, objects)
    slices = applying.apply_results(run, objects, bpy.context.scene)
    next(slices)
    slices.close()
    assert PANES not in bpy.data.objects and PANES not in bpy.data.meshes


TRANSFORMS = {
    "turned": Matrix.LocRotScale((1.0, -2.0, 0.5), Euler((0.2, 0.4, 1.1)), (1.0, 1.0, 1.0)),
    "stretched": Matrix.Diagonal((2.0, 0.5, 1.0, 1.0)),
    "mirrored": Matrix.Diagonal((-1.0, 1.0, 1.0, 1.0)),
}


def scanned_object(run: RunFolder, matrix: Matrix) -> tuple[bpy.types.Object, RoomMesh]:
    """A scan of a box as an object of this transform, exported and cleaned."""
    scan, _ = scanned_box(cells=20, noise=0.01)
    inverse = np.array(matrix.inverted())
    mesh = bpy.data.meshes.new("Scan")
    local = scan.vertices @ inverse[:3, :3].T + inverse[:3, 3]
    mesh.from_pydata(local.tolist(), [], scan.triangles.tolist())
    item = bpy.data.objects.new("Scan", mesh)
    item.matrix_world = matrix
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    export_room([item], run)
    clean_run(run)
    return item, read_room(run)


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_result_meshes_of_a_scan_are_clean(tmp_path: Path, transform: str) -> None:
    run = RunFolder(tmp_path)
    item, room = scanned_object(run, TRANSFORMS[transform])
    geometry = room.scan
    assert geometry is not None
    own = item.data
    before = np.array([vertex.co for vertex in own.vertices])

    clean, _ = make_mesh(room, 0, item)
    clean_result_mesh(clean, item, room, 0, geometry)

    assert np.array_equal(before, [vertex.co for vertex in own.vertices])
    item.data = clean
    shown = collect_room([item])
    assert np.array_equal(shown.triangles, room.triangles)
    assert np.abs(shown.vertices - geometry.vertices).max() < 1e-5
    cosine = (shown.corner_normals * geometry.corner_normals).sum(axis=2)
    assert np.median(cosine) > 0.9999 and np.quantile(cosine, 0.01) > 0.99


def test_a_drawn_surface_beside_a_scan_keeps_its_vertices_and_edges(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    item, _ = scanned_object(run, Matrix())
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 0.5 + [0.3, 0.2, 1.0]
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    mesh = bpy.data.meshes.new("Drawn")
    mesh.from_pydata(corners.tolist(), [], faces)
    drawn = bpy.data.objects.new("Drawn", mesh)
    drawn[ADDED] = DRAWN
    bpy.context.scene.collection.objects.link(drawn)
    before = collect_room([drawn])
    export_room([drawn, item], run)
    clean_run(run)
    room = read_room(run)
    assert room.triangle_exact is not None and room.triangle_exact.sum() == 12
    geometry = room.scan
    assert geometry is not None
    clean, _ = make_mesh(room, 0, drawn)
    clean_result_mesh(clean, drawn, room, 0, geometry)
    drawn.data = clean
    shown = collect_room([drawn])
    assert np.abs(shown.vertices - before.vertices).max() < 1e-6
    assert np.abs(shown.corner_normals - before.corner_normals).max() < 1e-3
    clean, _ = make_mesh(room, 1, item)
    clean_result_mesh(clean, item, room, 1, geometry)
    assert np.abs(vertex_positions(clean) - vertex_positions(item.data)).max() > 1e-3
