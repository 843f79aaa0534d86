# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Forward path tracing of a room with the paper's BRDF: re-rendering, relighting, ground truth.

Unidirectional paths; at each surface one light sample and one BRDF sample, weighted against each other by
the power heuristic, both densities per steradian. Black emitters reflect nothing and end a path; others are
rough dielectrics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..conventions import PinholeView
from ..light.denoise import Denoiser
from ..material import brdf
from ..scene.room import Room
from .environment import EnvironmentLight
from .lights import AreaLights, DirectSample, EmitterTable, power_heuristic
from .surfaces import SurfaceMaterials

PATHS_AT_ONCE = 1 << 20  # bounds memory: about 100 MB of state in a recorded loop


@dataclass(frozen=True)
class RenderSettings:
    """How an image is made.

    Attributes:
        spp: paths a pixel, at random positions in the pixel (box filter).
        seed: seed of all random numbers.
        depth: most reflections of a path between camera and light; as many as Cycles has (`blend.renders`).
        roulette_depth: from this surface on, paths end by chance in proportion to what they carry.
        denoise: run Open Image Denoise with albedo and normal guides.
    """

    spp: int = 128
    seed: int = 0
    depth: int = 32
    roulette_depth: int = 3
    denoise: bool = True


@dataclass(frozen=True)
class LitRoom:
    """All that a path tracer needs to know of a lit room.

    Attributes:
        room: the mesh.
        materials: looked up wherever a path meets a surface for which no emitter stands.
        lights: emissive triangles of the same room.
        environment: what rays that leave the mesh see, or None for black.
    """

    room: Room
    materials: SurfaceMaterials
    lights: AreaLights
    environment: EnvironmentLight | None = None

    def environment_share(self) -> float:
        """Share of light samples that go to the environment."""
        lit = self.environment is not None and self.environment.flux > 0.0
        if not lit:
            return 0.0
        return 0.5 if self.lights.count else 1.0

    def sample_light(self, point: Any, u: tuple[Any, Any, Any]) -> DirectSample:
        """One light, area or environment, as seen from a point (Point3f)."""
        share = self.environment_share()
        if share == 0.0:
            return self.lights.sample_direction(point, *u)
        assert self.environment is not None
        pick = u[0] < share
        if share == 1.0:
            return DirectSample(*_environment_sample(self.environment, u, 1.0))
        distant = _environment_sample(self.environment, (u[0] / share, u[1], u[2]), share)
        near = self.lights.sample_direction(point, (u[0] - share) / (1.0 - share), u[1], u[2])
        near = replace(near, pdf=near.pdf * (1.0 - share))
        return DirectSample(
            *[dr.select(pick, far, close) for far, close in zip(distant, _values(near), strict=True)]
        )


def _values(sample: DirectSample) -> tuple[Any, Any, Any, Any]:
    return sample.direction, sample.distance, sample.radiance, sample.pdf


def _environment_sample(environment: EnvironmentLight, u: tuple[Any, Any, Any], share: float) -> tuple:
    direction, radiance, pdf = environment.sample(dr.minimum(u[0], 1.0 - 1e-7), u[1], u[2])
    return direction, mi.Float(dr.inf), radiance, pdf * share


@dataclass
class PathResult:
    """What came along camera paths; one lane a path.

    Attributes:
        radiance: Color3f.
        albedo: Color3f, kd + ks of the first surface; white for emitters, black where nothing is hit.
        normal: Vector3f, shading normal of the first surface; zero where nothing is hit.
    """

    radiance: Any
    albedo: Any
    normal: Any


def trace_paths(lit: LitRoom, ray: Any, generator: Any, settings: RenderSettings) -> PathResult:
    """Radiance along rays.

    Args:
        lit: the lit room.
        ray: Ray3f with unit directions.
        generator: PCG32 of the same width.
        settings: only `depth` and `roulette_depth` are used.
    """
    room, lights, environment = lit.room, lit.lights, lit.environment
    # The room makes its arrays when they are first asked for, which can't happen while a loop is recorded.
    room.intersect(mi.Ray3f([0, 0, 0], [0, 0, 1]))
    share = lit.environment_share()
    sampled = lights.count > 0 or share > 0.0
    width = dr.width(ray.d)

    def step(
        active: Any,
        depth: Any,
        ray: Any,
        throughput: Any,
        pdf_brdf: Any,
        radiance: Any,
        albedo: Any,
        normal: Any,
        generator: Any,
    ) -> tuple:
        surface = room.intersect(ray, active)
        first = depth == 0
        # Light that this ray meets; the competing density is that of the light sample before it.
        cosine = -dr.dot(surface.geometric_normal, ray.d)
        pdf_light = lights.pdf_direction(surface.triangle, surface.distance, cosine, surface.valid)
        weight = dr.select(first, 1.0, power_heuristic(pdf_brdf, pdf_light * (1.0 - share)))
        met = lights.radiance(surface.triangle, cosine, surface.valid) * weight
        if environment is not None:
            escaped = active & ~surface.valid
            weight = dr.select(first, 1.0, power_heuristic(pdf_brdf, environment.pdf(ray.d, escaped) * share))
            met += dr.select(escaped, environment.radiance(ray.d, escaped) * weight, 0.0)
        radiance += dr.select(active, throughput * met, 0.0)

        emitter = lights.is_emitter(surface.triangle, surface.valid)
        # After the last reflection a path may still meet a light: that is the other half of its MIS pair.
        active &= surface.valid & (depth < settings.depth)
        lamp_color = lights.base_color(surface.triangle, active & emitter)
        active &= ~emitter | (dr.max(lamp_color) > 0.0)
        base_color, roughness, metallic = lit.materials.lookup(
            surface.position, surface.triangle, active & ~emitter
        )
        base_color = dr.select(emitter, lamp_color, base_color)
        roughness, metallic = dr.select(emitter, 1.0, roughness), dr.select(emitter, 0.0, metallic)
        reflectance = brdf.diffuse_reflectance(base_color, metallic) + brdf.specular_reflectance(
            base_color, metallic
        )
        albedo = dr.select(first & surface.valid, dr.select(emitter, mi.Color3f(1.0), reflectance), albedo)
        normal = dr.select(first & surface.valid, mi.Vector3f(surface.normal), normal)

        frame = mi.Frame3f(surface.normal)
        toward_viewer = frame.to_local(-ray.d)
        side = dr.select(surface.front, surface.geometric_normal, -surface.geometric_normal)
        if sampled:
            u = (generator.next_float32(), generator.next_float32(), generator.next_float32())
            light = lit.sample_light(surface.position, u)
            toward_light = frame.to_local(light.direction)
            value = brdf.evaluate(toward_light, toward_viewer, base_color, roughness, metallic)
            pdf = brdf.pdf(toward_light, toward_viewer, base_color, roughness, metallic)
            useful = active & (light.pdf > 0.0) & (dr.dot(side, light.direction) > 0.0)
            useful &= (dr.max(value) > 0.0) & (dr.max(light.radiance) > 0.0)
            shadow = room.leave(surface.position, side, light.direction)
            shadow.maxt = light.distance * (1.0 - 1e-3) - 2.0 * room.offset
            useful &= ~room.scene.ray_test(shadow, useful)
            gain = value * light.radiance * (power_heuristic(light.pdf, pdf) / light.pdf)
            radiance += dr.select(useful, throughput * gain, 0.0)

        choice = generator.next_float32()
        sample2 = mi.Point2f(generator.next_float32(), generator.next_float32())
        local, gain, pdf_brdf = brdf.sample(choice, sample2, toward_viewer, base_color, roughness, metallic)
        direction = frame.to_world(local)
        throughput *= gain
        # A direction above the shading normal's horizon may still lead into the surface.
        active &= (pdf_brdf > 0.0) & (dr.dot(side, direction) > 0.0)
        depth += 1
        survival = dr.select(depth > settings.roulette_depth, dr.minimum(dr.max(throughput), 0.95), 1.0)
        active &= generator.next_float32() < survival
        throughput *= dr.select(active, dr.rcp(dr.maximum(survival, 1e-6)), 0.0)
        ray = room.leave(surface.position, side, direction)
        return active, depth, ray, throughput, pdf_brdf, radiance, albedo, normal, generator

    state = (
        dr.full(mi.Bool, True, width),
        dr.zeros(mi.UInt32, width),
        mi.Ray3f(ray),
        dr.full(mi.Color3f, 1.0, width),
        dr.zeros(mi.Float, width),
        dr.zeros(mi.Color3f, width),
        dr.zeros(mi.Color3f, width),
        dr.zeros(mi.Vector3f, width),
        generator,
    )
    state = dr.while_loop(state, lambda active, *_: active, step, label="paths")
    return PathResult(radiance=state[5], albedo=state[6], normal=state[7])


def camera_rays(view: PinholeView, pixel: Any, shift: Any) -> Any:
    """Ray3f through positions in pixels.

    Args:
        pixel: UInt32, row-major index.
        shift: Point2f in [0, 1), position inside the pixel.
    """
    x = mi.Float(pixel % view.width) + shift.x
    y = mi.Float(pixel // view.width) + shift.y
    local = dr.normalize(mi.Vector3f((x - view.cx) / view.fx, (y - view.cy) / view.fy, 1.0))
    pose = np.asarray(view.camera_to_world, np.float64)
    columns = [mi.Vector3f([dr.opaque(mi.Float, float(v)) for v in pose[:3, k]]) for k in range(4)]
    direction = columns[0] * local.x + columns[1] * local.y + columns[2] * local.z
    return mi.Ray3f(mi.Point3f(columns[3]), direction)


def render_view(lit: LitRoom, view: PinholeView, settings: RenderSettings, stream: int = 0) -> np.ndarray:
    """One image, (height, width, 3) float32 scene-linear radiance.

    Args:
        stream: tells the views of one seed apart, so that they share no noise.
    """
    count = view.width * view.height
    at_once = max(1, PATHS_AT_ONCE // settings.spp)
    planes = [np.zeros((count, 3), np.float32) for _ in range(3)]
    for start in range(0, count, at_once):
        pixels = min(at_once, count - start)
        index = dr.arange(mi.UInt32, pixels * settings.spp)
        # Opaque: as literals they would make a new kernel for every chunk and view.
        first = dr.opaque(mi.UInt32, start)
        generator = mi.PCG32(
            size=pixels * settings.spp,
            initstate=dr.opaque(mi.UInt64, (settings.seed << 32) + stream),
            initseq=mi.UInt64(first) * settings.spp + mi.UInt64(index),
        )
        shift = mi.Point2f(generator.next_float32(), generator.next_float32())
        ray = camera_rays(view, first + index // settings.spp, shift)
        result = trace_paths(lit, ray, generator, settings)
        dr.eval(result.radiance, result.albedo, result.normal)  # one kernel for all of them
        for plane, values in zip(planes, (result.radiance, result.albedo, result.normal), strict=True):
            summed = [dr.block_sum(values[channel], settings.spp) for channel in range(3)]
            plane[start : start + pixels] = np.stack([np.array(channel) for channel in summed], axis=-1)
    radiance, albedo, normal = (
        (plane / settings.spp).reshape(view.height, view.width, 3) for plane in planes
    )
    return denoise(radiance, albedo, normal) if settings.denoise else radiance


def denoise(radiance: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Open Image Denoise on an HDR image (H, W, 3) float32, guided by albedo and world normals."""
    with Denoiser(albedo, normal, clean_guides=False) as denoiser:
        return denoiser(radiance)


def render_views(
    lit: LitRoom,
    views: Iterable[PinholeView],
    settings: RenderSettings,
    progress: Callable[[int], None] | None = None,
) -> Iterator[np.ndarray]:
    """Images of views in order; `progress` gets the number of images done."""
    for stream, view in enumerate(views):
        yield render_view(lit, view, settings, stream)
        if progress is not None:
            progress(stream + 1)


def add_light(
    room: Room, vertices: np.ndarray, triangles: np.ndarray, radiance: np.ndarray
) -> tuple[Room, EmitterTable]:
    """A room with one more one-sided emitter, for relighting.

    Args:
        vertices: (n, 3) metres, world. triangles: (m, 3) into them; fronts emit.
        radiance: (3,).

    Returns:
        The new room, whose last m triangles are the light, and a table with the light alone.
    """
    triangles = np.asarray(triangles, np.int32)
    vertices = np.asarray(vertices, np.float32)
    corners = vertices.astype(np.float64)[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    count = len(triangles)
    ids = np.arange(len(room.triangles), len(room.triangles) + count, dtype=np.int32)
    extended = replace(
        room,
        vertices=np.concatenate([room.vertices, vertices]),
        triangles=np.concatenate([room.triangles, triangles + np.int32(len(room.vertices))]),
        corner_normals=np.concatenate(
            [room.corner_normals, np.repeat(normal[:, None], 3, axis=1).astype(np.float32)]
        ),
        triangle_object=np.concatenate([room.triangle_object, np.full(count, -1, np.int32)]),
        triangle_material=np.concatenate([room.triangle_material, np.full(count, -1, np.int32)]),
    )
    front = np.tile(np.asarray(radiance, np.float32), (count, 1))
    return extended, EmitterTable(ids, front, np.zeros_like(front))


def switched_off(table: EmitterTable) -> EmitterTable:
    """The same emitters without light of their own; they reflect as before."""
    black = np.zeros_like(table.radiance), np.zeros_like(table.back_radiance)
    return EmitterTable(table.triangles, *black, table.base_color, table.beside)


def joined(first: EmitterTable, second: EmitterTable) -> EmitterTable:
    """Both tables' emitters."""
    return EmitterTable(
        np.concatenate([first.triangles, second.triangles]),
        np.concatenate([first.radiance, second.radiance]),
        np.concatenate([first.back_radiance, second.back_radiance]),
        np.concatenate([first.base_colors(), second.base_colors()]),
        np.concatenate([first.all_beside(), second.all_beside()]),
    )
