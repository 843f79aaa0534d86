"""Blender lights that stand for fixtures emit the same light: renders of both agree within their noise."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from benchmarks.cycles_pixels import render_pixels
from fipt_blender.blend.lights import convert, fixtures, light_state
from fipt_blender.blend.lights.fixture_nodes import emission_material
from fipt_blender.blend.node_trees import node_tree
from fipt_blender.blend.pictures.cycles import RenderOptions
from fipt_blender.core.run.result_contents import EmitterFixture
from samples.rendered_rooms import diffuse_floor
from samples.small_rooms import agree
from samples.spots import spot

RADIANCE = [8.0, 4.0, 2.0]


def irradiance(point: Vector, spp: int, seed: int) -> np.ndarray:
    """Pixels of a white diffuse spot from above: 81 estimates of its radiosity over pi, (81,3)."""
    return spot(point + Vector((0, 0, 0.05)), point, spp, 9, 0.02, seed).reshape(-1, 3)


def lamp_scene(shape: str) -> tuple[bpy.types.Scene, bpy.types.Object]:
    """A fixture of some shape, tilted, half a metre above a white diffuse floor."""
    scene = bpy.context.scene
    diffuse_floor(2.0, 1.0)
    if shape == "rectangle":
        bpy.ops.mesh.primitive_plane_add(size=1.0)
        size = (0.5, 0.2, 1.0)
    elif shape == "disk":
        bpy.ops.mesh.primitive_circle_add(vertices=96, radius=1.0, fill_type="NGON")
        size = (0.2, 0.2, 1.0)
    else:
        bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=1.0)
        size = (0.15, 0.15, 0.15)
    mesh = bpy.context.object.data
    bpy.data.objects.remove(bpy.context.object)
    if shape != "ball":
        mesh.transform(Matrix.Rotation(math.pi, 4, "X"))  # fronts look down
    tilt = Matrix.Rotation(math.radians(25), 4, "Y") @ Matrix.Rotation(math.radians(20), 4, "Z")
    mesh.transform(tilt @ Matrix.Diagonal((*size, 1.0)))
    none = (0.0, 0.0, 0.0)
    entry = EmitterFixture("Fixture.001", (0,), tuple(RADIANCE), none, 1.0, none, none)
    made = fixtures.NewFixture(entry, "Fixture.001", mesh, Vector((0.1, 0.0, 0.5)), [])
    (item,) = fixtures.place(scene, [made])
    light_state.refresh(scene)
    bpy.context.view_layer.update()
    return scene, item


@pytest.mark.parametrize("shape", ["rectangle", "disk", "ball"])
def test_blender_lights_emit_as_the_fixture_does(shape):
    scene, item = lamp_scene(shape)
    places = [Vector((0.0, 0.0, 0.0)), Vector((0.35, 0.3, 0.0)), Vector((-0.6, 0.1, 0.0))]

    def measure():
        found = [irradiance(place, 64, seed) for seed, place in enumerate(places)]
        return np.array([pixels.mean(axis=0) for pixels in found]), np.array(
            [pixels.std(axis=0, ddof=1) / math.sqrt(len(pixels)) for pixels in found]
        )

    surface, surface_error = measure()
    lights, exact = convert.fixture_to_lights(scene, item)
    bpy.context.view_layer.update()
    assert exact and [light.data.type for light in lights] == ["POINT" if shape == "ball" else "AREA"]
    light, light_error = measure()
    assert (surface > 0.01).all()
    # The mesh has flat facets: its area is within half a per cent of the round shape's.
    error = np.hypot(np.hypot(surface_error, light_error), 0.003 * surface)
    agree(light - surface, error)
    camera_sees = spot(item.location - Vector((0, 0, 0.4)), item.location, ortho=0.01).mean(axis=(0, 1))
    assert np.allclose(camera_sees, RADIANCE, rtol=1e-3)  # the camera still sees the surface
    convert.lights_to_fixture(scene, item)
    assert not item.children and item.visible_diffuse and item.visible_shadow
    back, back_error = measure()
    agree(back - surface, np.hypot(surface_error, back_error) + 1e-9)


def test_other_shapes_keep_their_power_and_are_not_exact():
    half = 3.0 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0], [2, 2, 0], [0, 2, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 5], [2, 3, 4], [2, 4, 5]])
    (shape,) = convert.fit_shapes(half, triangles)
    assert shape.kind == "RECTANGLE" and not shape.exact and shape.area == pytest.approx(27.0)
    two = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    both = np.concatenate([two, two + [3, 0, 1]])
    quads = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    pieces = convert.fit_shapes(both, quads)
    assert len(pieces) == 2 and all(piece.exact for piece in pieces)
    assert np.allclose(pieces[1].matrix[:3, 3], [3.5, 0.5, 1.0])
    assert convert.fit_shapes(two, np.array([[0, 0, 1]])) == []


def ellipse(count: int) -> np.ndarray:
    angle = 2.0 * math.pi * (np.arange(count) + 0.3) / count
    return np.column_stack([0.5 * np.cos(angle), 0.15 * np.sin(angle)])


@pytest.mark.parametrize("degrees", [0.0, 10.25, 33.3, 89.77])
@pytest.mark.parametrize(
    ("outline", "kind", "size", "exact"),
    [
        ([[0.0, 0.0], [1.2, 0.0], [1.2, 0.03], [0.0, 0.03]], "RECTANGLE", [0.03, 1.2], 1e-4),
        *((ellipse(count), "ELLIPSE", [0.3, 1.0], 0.02) for count in (16, 33, 96)),
    ],
)
def test_lamps_have_the_axes_of_their_shape_however_thin_and_turned(outline, kind, size, exact, degrees):
    turn = np.array(Matrix.Rotation(math.radians(degrees), 3, "Z"))
    points = np.column_stack([outline, np.zeros(len(outline))]) @ turn.T + [30.0, -20.0, 2.0]
    fan = np.array([[0, index, index + 1] for index in range(1, len(points) - 1)])
    (shape,) = convert.fit_shapes(points, fan)
    assert (shape.kind, shape.exact) == (kind, True)
    assert sorted(shape.size) == pytest.approx(size, rel=exact)
    long = shape.matrix[:3, int(np.argmax(shape.size))]
    assert abs(long @ turn[:, 0]) == pytest.approx(1.0, abs=1e-6)


def test_path_length_does_not_darken_bright_rooms():
    """A closed box that emits 1 and reflects 80 %: radiance 1 / (1 - 0.8). Twelve bounces would lack 5 %."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    material = bpy.data.materials.new("wall")
    nodes, links = node_tree(material).nodes, node_tree(material).links
    nodes.clear()
    diffuse, emission = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeEmission")
    diffuse.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    emission.inputs["Strength"].default_value = 1.0
    add, output = nodes.new("ShaderNodeAddShader"), nodes.new("ShaderNodeOutputMaterial")
    links.new(diffuse.outputs[0], add.inputs[0])
    links.new(emission.outputs[0], add.inputs[1])
    links.new(add.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 8
    pixels = render_pixels(scene, RenderOptions(256, seed=1, denoise=False))
    assert float(pixels.mean()) == pytest.approx(5.0, rel=0.01)


BLACK, DIM = [0.0, 0.0, 0.0], [0.5, 0.25, 0.5]


@pytest.mark.parametrize(("front", "back"), [(RADIANCE, BLACK), (BLACK, RADIANCE), (RADIANCE, DIM), (DIM, RADIANCE)])
def test_cycles_renders_the_radiance_of_both_sides(front, back):
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    bpy.context.object.data.materials.append(emission_material("lamp", front, back))
    for height, radiance in ((1.0, front), (-1.0, back)):
        assert np.allclose(spot((0, 0, height), (0, 0, 0)), radiance, atol=1e-4)
