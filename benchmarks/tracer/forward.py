"""Forward path tracing of a room with the paper's BRDF (Eq. 3 and 4): re-rendering, relighting, ground truth.

Unidirectional paths with one emitter sample and one BRDF sample per surface, combined by the power heuristic
of densities per steradian. Black emitters reflect nothing and end a path; others are rough dielectrics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import pyoidn

from benchmarks.tracer.environment import EnvironmentLight
from benchmarks.tracer.surfaces import SurfaceMaterials
from fipt_blender.core.conventions import PinholeView
from fipt_blender.core.optics import brdf, factorised
from fipt_blender.core.optics.denoise import Denoiser
from fipt_blender.core.optics.lights import AreaLights, DirectSample, EmitterTable
from fipt_blender.core.surface.room import Room

PATHS_AT_ONCE = 1 << 20  # bounds memory: about 100 MB of state in a recorded loop


@dataclass(frozen=True)
class RenderSettings:
    """Settings of a rendered image.

    Attributes:
        spp: paths per pixel, at random positions in the pixel (box filter).
        seed: seed of all random numbers.
        depth: most reflections of a path between camera and light; the maximum of Cycles.
        roulette_depth: surfaces of a path before Russian roulette starts.
        denoise: run Open Image Denoise with albedo and normal guides.
    """

    spp: int = 128
    seed: int = 0
    depth: int = 32
    roulette_depth: int = 3
    denoise: bool = True


@dataclass(frozen=True)
class LitRoom:
    """Scene of the path tracer.

    Attributes:
        room: the mesh.
        materials: of all surfaces that are no emitters.
        lights: emissive triangles of the same room.
        environment: radiance of rays that leave the mesh, or None for black.
    """

    room: Room
    materials: SurfaceMaterials
    lights: AreaLights
    environment: EnvironmentLight | None = None

    def environment_share(self) -> float:
        """Probability with which the environment is sampled instead of the area lights."""
        lit = self.environment is not None and self.environment.flux > 0.0
        if not lit:
            return 0.0
        return 0.5 if self.lights.count else 1.0

    def sample_light(self, point: mi.Point3f, u: tuple[mi.Float, mi.Float, mi.Float]) -> DirectSample:
        """One light sample, of an area light or the environment, as seen from a point."""
        share = self.environment_share()
        if share == 0.0:
            return self.lights.sample_direction(point, *u)
        assert self.environment is not None
        if share == 1.0:
            return self.environment.sample(dr.minimum(u[0], 1.0 - 1e-7), u[1], u[2])
        distant = self.environment.sample(dr.minimum(u[0] / share, 1.0 - 1e-7), u[1], u[2])
        distant.pdf *= share
        near = self.lights.sample_direction(point, (u[0] - share) / (1.0 - share), u[1], u[2])
        near.pdf *= 1.0 - share
        return DirectSample(
            *(
                dr.select(u[0] < share, getattr(distant, item.name), getattr(near, item.name))
                for item in fields(DirectSample)
            )
        )


@dataclass
class PathResult:
    """Result of camera paths, one per lane.

    Attributes:
        radiance: along the ray.
        albedo: kd + ks of the first surface; white for emitters, black where nothing is hit.
        normal: shading normal of the first surface; zero where nothing is hit.
    """

    radiance: mi.Color3f
    albedo: mi.Color3f
    normal: mi.Vector3f


class PathState(NamedTuple):
    """State of the loop over the surfaces of a path."""

    active: mi.Bool
    depth: mi.UInt32
    ray: mi.Ray3f
    throughput: mi.Color3f
    pdf_brdf: mi.Float
    radiance: mi.Color3f
    albedo: mi.Color3f
    normal: mi.Vector3f
    generator: mi.PCG32


def trace_paths(lit: LitRoom, ray: mi.Ray3f, generator: mi.PCG32, settings: RenderSettings) -> PathResult:
    """Radiance along rays.

    Args:
        lit: the scene.
        ray: with unit directions.
        generator: of the same width.
        settings: only `depth` and `roulette_depth` are used.
    """
    room, lights, environment = lit.room, lit.lights, lit.environment
    # The room makes its arrays on first use, which is impossible while a loop is recorded.
    room.intersect(mi.Ray3f([0, 0, 0], [0, 0, 1]))
    share = lit.environment_share()
    sampled = lights.count > 0 or share > 0.0
    width = dr.width(ray.d)

    def step(*variables: Any) -> tuple:
        active, depth, ray, throughput, pdf_brdf, radiance, albedo, normal, generator = PathState(*variables)
        surface = room.intersect(ray, active)
        first = depth == 0

        # ---------------------- Direct emission L_e (Eq. 3) ----------------------

        # Weighted against emitter sampling at the surface before.
        cosine = -dr.dot(surface.geometric_normal, ray.d)
        pdf_light = lights.pdf_direction(surface.triangle, surface.distance, cosine, surface.valid)
        weight = dr.select(first, 1.0, power_heuristic(pdf_brdf, pdf_light * (1.0 - share)))
        emitted = lights.radiance(surface.triangle, cosine, surface.valid) * weight
        if environment is not None:
            escaped = active & ~surface.valid
            weight = dr.select(first, 1.0, power_heuristic(pdf_brdf, environment.pdf(ray.d, escaped) * share))
            emitted += dr.select(escaped, environment.radiance(ray.d, escaped) * weight, 0.0)
        radiance += dr.select(active, throughput * emitted, 0.0)

        # ---------------------- Material of the surface ----------------------

        emitter = lights.is_emitter(surface.triangle, surface.valid)
        # After the last reflection a ray may still hit a light: the BRDF sample of the last MIS pair.
        active &= surface.valid & (depth < settings.depth)
        active &= ~emitter
        base_color, roughness, metallic = lit.materials.lookup(surface.position, surface.triangle, active)
        reflectance = factorised.diffuse_reflectance(base_color, metallic) + factorised.specular_reflectance(
            base_color, metallic
        )
        albedo = dr.select(first & surface.valid, dr.select(emitter, mi.Color3f(1.0), reflectance), albedo)
        normal = dr.select(first & surface.valid, mi.Vector3f(surface.normal), normal)

        frame = mi.Frame3f(surface.normal)
        wo = frame.to_local(-ray.d)
        side = dr.select(surface.front, surface.geometric_normal, -surface.geometric_normal)

        # ---------------------- Emitter sampling ----------------------

        if sampled:
            u = (generator.next_float32(), generator.next_float32(), generator.next_float32())
            light = lit.sample_light(surface.position, u)
            wi = frame.to_local(light.direction)
            value = brdf.evaluate(wi, wo, base_color, roughness, metallic)
            pdf = brdf.pdf(wi, wo, base_color, roughness, metallic)
            usable = active & (light.pdf > 0.0) & (dr.dot(side, light.direction) > 0.0)
            usable &= (dr.max(value) > 0.0) & (dr.max(light.radiance) > 0.0)
            shadow_ray = _leaving_ray(room, surface.position, side, light.direction)
            shadow_ray.maxt = light.distance * (1.0 - 1e-3) - 2.0 * room.offset
            usable &= ~room.scene.ray_test(shadow_ray, usable)
            reflected = value * light.radiance * (power_heuristic(light.pdf, pdf) / light.pdf)
            radiance += dr.select(usable, throughput * reflected, 0.0)

        # ---------------------- BRDF sampling (Eq. 4) ----------------------

        lobe = generator.next_float32()
        sample2 = mi.Point2f(generator.next_float32(), generator.next_float32())
        wi, weight, pdf_brdf = brdf.sample(lobe, sample2, wo, base_color, roughness, metallic)
        direction = frame.to_world(wi)
        throughput *= weight
        # A direction above the horizon of the shading normal may still lead into the surface.
        active &= (pdf_brdf > 0.0) & (dr.dot(side, direction) > 0.0)
        depth += 1

        # ---------------------- Russian roulette ----------------------

        survival = dr.select(depth > settings.roulette_depth, dr.minimum(dr.max(throughput), 0.95), 1.0)
        active &= generator.next_float32() < survival
        throughput *= dr.select(active, dr.rcp(dr.maximum(survival, 1e-6)), 0.0)
        ray = _leaving_ray(room, surface.position, side, direction)
        return active, depth, ray, throughput, pdf_brdf, radiance, albedo, normal, generator

    start = PathState(
        active=dr.full(mi.Bool, True, width),
        depth=dr.zeros(mi.UInt32, width),
        ray=mi.Ray3f(ray),
        throughput=dr.full(mi.Color3f, 1.0, width),
        pdf_brdf=dr.zeros(mi.Float, width),
        radiance=dr.zeros(mi.Color3f, width),
        albedo=dr.zeros(mi.Color3f, width),
        normal=dr.zeros(mi.Vector3f, width),
        generator=generator,
    )
    end = PathState(*dr.while_loop(tuple(start), lambda active, *_: active, step, label="paths"))
    return PathResult(radiance=end.radiance, albedo=end.albedo, normal=end.normal)


def power_heuristic(pdf: mi.Float, other: mi.Float) -> mi.Float:
    """Veach's power heuristic (exponent 2): weight of a sample of density `pdf` against density `other`."""
    ratio = other / pdf  # of densities, so that their squares can't overflow
    return dr.select(pdf > 0, 1.0 / (1.0 + ratio * ratio), 0.0)


def camera_rays(view: PinholeView, pixel: mi.UInt32, shift: mi.Point2f) -> mi.Ray3f:
    """Camera rays through positions in pixels.

    Args:
        pixel: row-major index.
        shift: position inside the pixel, in [0, 1).
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
        stream: of random numbers; views with different streams have independent noise.
    """
    count = view.width * view.height
    at_once = max(1, PATHS_AT_ONCE // settings.spp)
    planes = [np.zeros((count, 3), np.float32) for _ in range(3)]
    for start in range(0, count, at_once):
        pixels = min(at_once, count - start)
        index = dr.arange(mi.UInt32, pixels * settings.spp)
        # Opaque: a literal would compile a new kernel for each chunk and view.
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


class _NoisyGuides(Denoiser):
    """Guides with noise, each of which is denoised first, as in Cycles."""

    def _guide(self, kind: int, image: np.ndarray) -> np.ndarray:
        guide = super()._guide(kind, image)
        output = np.zeros_like(guide)
        alone = pyoidn.Filter(self._device, pyoidn.OIDN_FILTER_TYPE_RT)
        alone.set_image(kind, guide, pyoidn.OIDN_FORMAT_FLOAT3)
        alone.set_image(pyoidn.OIDN_IMAGE_OUTPUT, output, pyoidn.OIDN_FORMAT_FLOAT3)
        alone.set_int("quality", pyoidn.OIDN_QUALITY_HIGH)
        alone.commit()
        alone.execute()
        error = self._device.get_error()
        alone.release()
        if error:
            raise RuntimeError(f"Open Image Denoise failed: {error}")
        return output


def denoise(radiance: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Open Image Denoise on an HDR image (H, W, 3) float32, guided by albedo and world normals."""
    with _NoisyGuides(albedo, normal) as denoiser:
        return denoiser(radiance)


def render_views(
    lit: LitRoom,
    views: Iterable[PinholeView],
    settings: RenderSettings,
    progress: Callable[[int], None] | None = None,
) -> Iterator[np.ndarray]:
    """Images of views in order; `progress` is called with the number of finished images."""
    for stream, view in enumerate(views):
        yield render_view(lit, view, settings, stream)
        if progress is not None:
            progress(stream + 1)


def switched_off(table: EmitterTable) -> EmitterTable:
    """The same emitters without emission."""
    black = np.zeros_like(table.radiance), np.zeros_like(table.back_radiance)
    return EmitterTable(table.triangles, *black)


def _leaving_ray(room: Room, position: mi.Point3f, normal: mi.Normal3f, direction: mi.Vector3f) -> mi.Ray3f:
    """Ray that leaves a surface in `direction` without intersecting the same surface again."""
    side = dr.mulsign(mi.Vector3f(normal), dr.dot(normal, direction))
    return mi.Ray3f(position + side * room.offset, direction)
