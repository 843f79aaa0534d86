"""Path tracing against quadrature and against Mitsuba's own integrator; relighting; material lattices."""

from dataclasses import replace
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from benchmarks.tracer import bsdf
from benchmarks.tracer.environment import EnvironmentLight
from benchmarks.tracer.forward import LitRoom, RenderSettings, denoise, render_view, trace_paths
from benchmarks.tracer.surfaces import LatticeMaterials, TriangleMaterials
from fipt_blender.core.optics import brdf
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.surface.room import Room
from samples.small_rooms import BOX as WALLS
from samples.small_rooms import area_lights, make_room, mesh_room, table

bsdf.register()

LAMP = [[-0.5, -0.3, 1.5], [-0.5, 0.7, 1.5], [0.4, 0.7, 1.5], [0.4, -0.3, 1.5]]  # front faces down
BOX = [
    *WALLS[:5],
    [[-0.9, 0.2, 0.8], [0.1, 0.5, 0.6], [0.0, 1.4, 0.9], [-1.0, 1.1, 1.1]],
    [[-0.6, -0.5, 2.9], [-0.6, 0.5, 2.9], [0.6, 0.5, 2.9], [0.6, -0.5, 2.9]],
]
CAMERA = SimpleNamespace(
    width=8, height=6, fx=7.0, fy=7.0, cx=4.0, cy=3.0,
    camera_to_world=np.array([[1, 0, 0, 0], [0, 0, 1, -1.9], [0, -1, 0, 1.4], [0, 0, 0, 1]], np.float64),
)  # fmt: skip


def uniform(room: Room, color: float, sigma: float, metallic: float) -> TriangleMaterials:
    count = len(room.triangles)
    return TriangleMaterials(np.full((count, 3), color), np.full(count, sigma), np.full(count, metallic))


def look(lit: LitRoom, toward: np.ndarray, count: int, depth: int, seed: int = 0) -> np.ndarray:
    """(count, 3) radiance of paths that start at the floor's origin, seen from `toward`."""
    direction = mi.Vector3f((-toward).tolist()) + dr.zeros(mi.Vector3f, count)
    ray = mi.Ray3f(mi.Point3f(toward.tolist()), direction)
    generator = mi.PCG32(size=count, initstate=seed)
    return np.array(trace_paths(lit, ray, generator, RenderSettings(depth=depth)).radiance).T


@pytest.mark.parametrize("sigma, metallic", [(1.0, 0.0), (0.4, 0.2), (0.12, 1.0)])
def test_direct_light_of_a_lamp_is_its_integral(sigma: float, metallic: float) -> None:
    """Light and BRDF samples together equal quadrature over the lamp (z-test)."""
    room = make_room([WALLS[0], LAMP])
    lights = area_lights(room, table([2, 3], [3.0, 2.0, 1.0], (9.0, 9.0, 9.0)))
    lit = LitRoom(room, uniform(room, 0.6, sigma, metallic), lights)
    toward = np.array([0.5, -0.6, 0.8])
    toward /= np.linalg.norm(toward)
    side = 1500
    x, y = dr.meshgrid(*[(dr.arange(mi.Float, side) + 0.5) / side] * 2)
    point = mi.Vector3f(-0.5 + 0.9 * x, -0.3 + y, 1.5)
    distance = dr.norm(point)
    direction = point / distance
    value = brdf.evaluate(direction, mi.Vector3f(toward.tolist()), mi.Color3f(0.6), sigma, metallic)
    geometry = direction.z / distance**2 * (0.9 / side**2)
    exact = np.array([dr.sum(channel * geometry)[0] for channel in value]) * [3.0, 2.0, 1.0]
    values = look(lit, toward, 200_000, depth=1)
    error = values.std(axis=0) / np.sqrt(len(values))
    assert (error < 0.02 * exact).all()
    assert (np.abs(values.mean(axis=0) - exact) < 4.5 * error).all()


@pytest.mark.parametrize("sigma", [1.0, 0.2])
def test_light_of_an_environment_is_its_integral(sigma: float) -> None:
    """A map with a small sun, sampled beside a lamp that is nearly off, equals quadrature over the map."""
    image = np.random.default_rng(0).uniform(0.1, 0.5, (16, 32, 3)).astype(np.float32)
    image[3, 5] = [40.0, 30.0, 20.0]
    environment = EnvironmentLight(image)
    room = make_room([WALLS[0]])
    lights = area_lights(room, EmitterTable.empty())
    lit = LitRoom(room, uniform(room, 0.6, sigma, 0.0), lights, environment)
    toward = np.array([0.3, 0.4, 0.866])
    side = 1600
    x, y = dr.meshgrid(*[(dr.arange(mi.Float, side) + 0.5) / side] * 2)
    direction = mi.warp.square_to_uniform_hemisphere(mi.Point2f(x, y))
    value = brdf.evaluate(direction, mi.Vector3f(toward.tolist()), mi.Color3f(0.6), sigma, 0.0)
    value *= environment.radiance(direction) * (2.0 * np.pi / side**2)
    exact = np.array([dr.sum(channel)[0] for channel in value])
    values = look(lit, toward, 200_000, depth=1)
    error = values.std(axis=0) / np.sqrt(len(values))
    assert (error < 0.02 * exact).all()
    assert (np.abs(values.mean(axis=0) - exact) < 4.5 * error + 2e-3 * exact).all()


def test_box_agrees_with_mitsubas_path_integrator() -> None:
    """Same box, same depth, seven surfaces of mixed materials: pixel by pixel within noise (z-tests)."""
    room = make_room(BOX)
    palette = [0.7, 0.7, 0.7], [0.6, 0.7, 0.8], [0.8, 0.6, 0.3], [0.7, 0.1, 0.1], [0.1, 0.6, 0.1]
    colors = np.repeat(np.array([*palette, [0.9, 0.8, 0.6], [0, 0, 0]], np.float32), 2, axis=0)
    sigmas = np.repeat(np.array([0.5, 1.0, 0.3, 1.0, 0.7, 0.25, 1.0], np.float32), 2)
    metals = np.repeat(np.array([0.0, 0.0, 0.5, 0.0, 0.0, 1.0, 0.0], np.float32), 2)
    radiance = [10.0, 8.0, 6.0]
    lights = area_lights(room, table([12, 13], radiance))
    lit = LitRoom(room, TriangleMaterials(colors, sigmas, metals), lights)
    depth, seeds = 4, 12
    scene = _mitsuba_scene(room, colors, sigmas, metals, radiance, depth)
    ours, theirs = [], []
    for seed in range(seeds):
        settings = RenderSettings(spp=256, seed=seed, depth=depth, roulette_depth=2, denoise=False)
        ours.append(render_view(lit, CAMERA, settings))
        theirs.append(np.array(mi.render(scene, spp=256, seed=1000 + seed)))
    first, second = np.array(ours), np.array(theirs)
    error = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / seeds)
    mean = (first.mean(axis=0) + second.mean(axis=0)) / 2
    assert np.median(error / mean) < 0.04
    z = (first.mean(axis=0) - second.mean(axis=0)) / np.maximum(error, 1e-4)
    # 144 values with 22 degrees of freedom; channels of a pixel share their noise
    assert np.abs(z).max() < 5.5
    assert np.sqrt((z**2).mean()) < 1.35
    total = first.mean(axis=(1, 2, 3)), second.mean(axis=(1, 2, 3))
    spread = np.sqrt((total[0].var(ddof=1) + total[1].var(ddof=1)) / seeds)
    assert abs(total[0].mean() - total[1].mean()) < 4 * spread


def _mitsuba_scene(room, colors, sigmas, metals, radiance, depth):
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": depth + 1, "rr_depth": 100}}
    for quad in range(len(room.triangles) // 2):
        emits = quad == len(room.triangles) // 2 - 1
        properties = mi.Properties()
        if emits:
            properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": 0.0})
            color = {"type": "rgb", "value": radiance}
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": color})
        else:
            properties["bsdf"] = mi.load_dict(
                {
                    "type": bsdf.PLUGIN_NAME,
                    "base_color": {"type": "rgb", "value": colors[2 * quad].tolist()},
                    "roughness": float(sigmas[2 * quad]),
                    "metallic": float(metals[2 * quad]),
                }
            )
        mesh = mi.Mesh(f"quad{quad}", 4, 2, props=properties)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = room.vertices[4 * quad : 4 * quad + 4].ravel()
        parameters["faces"] = [0, 1, 2, 0, 2, 3]
        parameters.update()
        scene[f"quad{quad}"] = mesh
    film = {"width": CAMERA.width, "height": CAMERA.height, "rfilter": {"type": "box"}}
    pose = CAMERA.camera_to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba: X left, Y up, Z forward
    scene["sensor"] = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(0.5 * CAMERA.width / CAMERA.fx))),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(pose),
        "film": {"type": "hdrfilm", **film},
    }
    return mi.load_dict(scene)


def test_walls_that_emit_and_reflect_are_a_furnace() -> None:
    """In a closed room of E and albedo rho all over, radiance is E / (1 - rho), whatever the room's shape.

    Reflective emitters add their emission to the reflection of the room's material.
    """
    room = make_room([*BOX, WALLS[5]])
    count = len(room.triangles)
    lamps = replace(table(list(range(count)), [2.0, 1.0, 0.5], (2.0, 1.0, 0.5)), reflective=np.ones(count, bool))
    lit = LitRoom(room, uniform(room, 0.6, 1.0, 0.0), area_lights(room, lamps))
    toward = np.array([0.3, 0.2, 0.9]) / np.linalg.norm([0.3, 0.2, 0.9])
    emitted = np.array([2.0, 1.0, 0.5])
    once = look(lit, toward, 40_000, depth=1).mean(axis=0)
    albedo = once / emitted - 1.0  # of this direction; that of a rough surface hardly depends on it
    assert np.allclose(albedo, albedo[0], rtol=0.02) and 0.6 < albedo[0] < 0.68
    whole = look(lit, toward, 40_000, depth=64, seed=1).mean(axis=0)
    np.testing.assert_allclose(whole, emitted / (1.0 - albedo.mean()), rtol=0.03)


def test_denoising_keeps_a_texture_that_the_guide_shows_through_its_noise() -> None:
    """Guides that are called noisy are denoised first: taken as they are, half the texture was blurred away,
    and a forward render stayed a decibel below one in Cycles with as many samples."""
    rng = np.random.default_rng(4)
    albedo = np.kron(rng.uniform(0.3, 0.8, (21, 32, 3)), np.ones((3, 3, 1)))
    clean = (albedo * 3.0).astype(np.float32)
    noisy = (clean * rng.gamma(2.0, 0.5, clean.shape)).astype(np.float32)
    guide = np.clip(albedo + rng.normal(0.0, 0.02, albedo.shape), 0.0, 1.0).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), clean.shape)
    smooth = denoise(noisy, guide, normal)
    assert np.sqrt(((smooth - clean) ** 2).mean()) < 0.11 * np.sqrt(((noisy - clean) ** 2).mean())


def test_lattice_reproduces_linear_fields_and_resolves_steps() -> None:
    """Linear fields come back, on slivers too (but for cells cut by the third edge, where points are moved
    onto it); the error of a curved field falls with the spacing."""
    rng = np.random.default_rng(2)
    vertices = rng.uniform(-1.0, 1.0, (30, 3)).astype(np.float32)
    vertices[3:6] = [[0, 0, 0], [2.0, 0, 0], [1.0, 0.004, 0]]  # a sliver
    triangles = np.arange(30, dtype=np.int32).reshape(-1, 3)
    room = mesh_room(vertices, triangles, np.zeros(10))

    def linear(position: np.ndarray, triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return 0.5 + position * 0.2, 0.5 + position[:, 0] * 0.2, triangle / 10.0

    def curved(position: np.ndarray, triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return 0.5 + 0.4 * np.sin(6.0 * position), np.full(len(position), 0.5), np.zeros(len(position))

    triangle = rng.integers(0, 10, 5000)
    weights = rng.dirichlet([1.0, 1.0, 1.0], 5000)
    points = np.einsum("nk,nkc->nc", weights, vertices[triangles[triangle]]).astype(np.float32)
    where = mi.Point3f(*[mi.Float(np.ascontiguousarray(column)) for column in points.T]), mi.UInt32(triangle)

    color, roughness, metallic = LatticeMaterials(room, linear, spacing=0.3).lookup(*where)
    expected = linear(points, triangle)
    difference = np.abs(np.array(color).T - expected[0]).max(axis=1)
    assert np.median(difference) < 1e-6 and difference.max() < 0.03
    assert np.abs(np.array(roughness) - expected[1]).max() < 0.03
    assert np.allclose(np.array(metallic), expected[2], atol=1e-5)

    errors = []
    for spacing in (0.2, 0.05):
        color, _, _ = LatticeMaterials(room, curved, spacing).lookup(*where)
        errors.append(np.abs(np.array(color).T - curved(points, triangle)[0]).mean())
    assert errors[1] < 0.1 * errors[0] and errors[1] < 0.003
