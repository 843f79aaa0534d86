# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the radiance along a ray comes from while shadings are baked.

Stage 1 reads the radiance cache at the first hit (paper Eq. 8). Stage 3 follows the path over specular
surfaces until it meets an emitter or a surface rough enough for the cache (paper Eq. 9 and 10). Of what a
specular surface sends, only the gloss depends on the view: the rest is its kd times L_d, which is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ..material import brdf
from ..render.environment import EnvironmentLight
from ..render.lights import AreaLights
from ..scene.room import Room, Surface
from .cache import SurfaceLookup

# A path goes on over gloss with this many times the probability of the light that it may bring, at least with
# the second: the 4 % of a dielectric are not worth a ray each time.
SURVIVAL, LEAST_SURVIVAL = 2.5, 0.1


@dataclass  # not frozen: Dr.Jit's loops write their state back into it
class Path:
    """State of one light path per lane.

    Attributes:
        radiance: Color3f gathered so far, already multiplied by the throughput.
        throughput: Color3f.
        brdf_pdf: Float density of the last direction, negative for the path's first one, whose emission
            counts in full because the baking kernel weights it.
        depth: UInt32 surfaces met so far.
        origin: Point3f of the ray to be traced next.
    """

    radiance: Any
    throughput: Any
    brdf_pdf: Any
    depth: Any
    origin: Any


def new_path(width: int = 1) -> Path:
    """A path that has not left its pixel's surface yet; the caller sets the origin."""
    return Path(
        radiance=dr.zeros(mi.Color3f, width),
        throughput=mi.Color3f(1.0),
        brdf_pdf=mi.Float(-1.0),
        depth=dr.zeros(mi.UInt32, width),
        origin=dr.zeros(mi.Point3f, width),
    )


class RadianceSource(Protocol):
    """Incident radiance for the baking kernel, one surface of the path at a time."""

    offset: float

    def intersect(self, ray: Any, active: Any) -> Surface:
        """First surface along the ray."""

    def step(self, path: Path, direction: Any, hit: Surface, rng: Any, active: Any) -> tuple[Path, Any, Any]:
        """Meet one surface: (path, next direction, whether the path goes on)."""


class CachedRadiance:
    """Stage 1: the cache at the first hit, the environment where there is none."""

    def __init__(self, room: Room, cache: SurfaceLookup, environment: EnvironmentLight | None) -> None:
        self._room, self._cache, self._environment = room, cache, environment
        self.offset = room.offset
        _make_ready(room)

    def intersect(self, ray: Any, active: Any) -> Surface:
        """First surface along the ray."""
        return self._room.intersect(ray, active)

    def step(self, path: Path, direction: Any, hit: Surface, rng: Any, active: Any) -> tuple[Path, Any, Any]:
        """The cache's value on the side that the ray sees; the path ends."""
        seen = dr.select(hit.front, hit.geometric_normal, -hit.geometric_normal)
        cached = mi.Color3f(*self._cache(hit.position, seen, active & hit.valid))
        missed = _outside(self._environment, direction, active & ~hit.valid)
        path.radiance = dr.select(active, dr.select(hit.valid, cached, missed), mi.Color3f(0.0))
        return path, direction, mi.Bool(False)


class TracedRadiance:
    """Stage 3: paths over surfaces with roughness up to `cache_roughness`, ending in emitters or the cache.

    Emitters are sampled at every surface on the way and combined with BRDF samples by the balance heuristic.
    Those that shine beside reflecting end a path in the cache, which holds the sum of both, and are not
    sampled. Without a cache they are sampled as the others, and paths go on.

    Args:
        materials: base colour (3), roughness and metallic of the surface, five values.
        cache: photographs averaged without the pixels of emitters. None traces every path to its depth with
            the materials alone, and what comes after is lost (the paper's ablation "w/o rad. cache").
        diffuse: L_d, three values, negative where unknown. Where it is known paths follow the gloss of
            specular surfaces alone, elsewhere and with None both lobes, as the paper does.
        depth: most surfaces that a path may meet; the last one is read from the cache.

    All three tables are of one grid.
    """

    def __init__(
        self,
        room: Room,
        cache: SurfaceLookup | None,
        materials: SurfaceLookup,
        diffuse: SurfaceLookup | None,
        lights: AreaLights,
        environment: EnvironmentLight | None,
        cache_roughness: float,
        depth: int,
    ) -> None:
        self._room, self._cache, self._materials, self._diffuse = room, cache, materials, diffuse
        self._lights, self._environment = lights, environment
        self._cache_roughness, self._depth = cache_roughness, depth
        self._cached_light = cache is not None and lights.beside
        self.offset = room.offset
        _make_ready(room)

    def intersect(self, ray: Any, active: Any) -> Surface:
        """First surface along the ray."""
        return self._room.intersect(ray, active)

    def step(self, path: Path, direction: Any, hit: Surface, rng: Any, active: Any) -> tuple[Path, Any, Any]:
        """Add what `hit` sends along the ray, and choose where its light comes from if it is specular."""
        lights = self._lights
        radiance = _outside(self._environment, direction, active & ~hit.valid)
        active = active & hit.valid
        cosine = -dr.dot(hit.geometric_normal, direction)
        is_emitter = lights.is_emitter(hit.triangle, active)
        shines = is_emitter
        if lights.beside and not self._cached_light:
            shines = shines | lights.shines_beside(hit.triangle, active)
        emitted = lights.radiance(hit.triangle, cosine, shines)
        light_pdf = lights.pdf_direction(hit.triangle, hit.distance, cosine, shines)
        weight = path.brdf_pdf / dr.maximum(path.brdf_pdf + light_pdf, 1e-20)
        radiance += emitted * dr.select(path.brdf_pdf < 0.0, 1.0, weight)
        active &= ~is_emitter

        side = dr.select(hit.front, hit.geometric_normal, -hit.geometric_normal)
        entry = self._materials.entry(hit.position, side, active)
        r, g, b, roughness, metallic = self._materials.values(entry, active)
        base_color = mi.Color3f(r, g, b)
        path.depth += 1
        ends = active & (path.depth >= self._depth)
        if self._cache is not None:
            ends |= active & (roughness > self._cache_roughness)
            if self._cached_light:
                ends |= lights.shines_beside(hit.triangle, active)
            radiance += mi.Color3f(*self._cache.values(entry, ends))
            active &= ~ends
        if self._diffuse is not None:
            kd = brdf.diffuse_reflectance(base_color, metallic)
            shading = mi.Color3f(*self._diffuse.values(entry, active))
            known = active & (shading.x >= 0.0)
            radiance += dr.select(known, kd * shading, 0.0)
            # What is left reflects like a metal.
            base_color = dr.select(known, brdf.specular_reflectance(base_color, metallic), base_color)
            metallic = dr.select(known, 1.0, metallic)

        frame = mi.Frame3f(hit.normal)
        wo = frame.to_local(-direction)
        wo.z = dr.maximum(wo.z, 1e-3)
        wo = dr.normalize(wo)
        origin = hit.position + mi.Vector3f(side) * self.offset
        radiance += self._direct(origin, frame, side, wo, base_color, roughness, metallic, rng, active)
        path.radiance += path.throughput * radiance

        choice = rng.next_float32()
        pair = mi.Point2f(rng.next_float32(), rng.next_float32())
        wi, factor, density = brdf.sample(choice, pair, wo, base_color, roughness, metallic)
        onward = frame.to_world(wi)
        active &= (density > 0.0) & (dr.dot(onward, side) > 0.0) & ~ends
        path.throughput *= dr.select(active, factor, mi.Color3f(1.0))
        if self._diffuse is not None:
            survival = dr.clip(SURVIVAL * dr.max(path.throughput), LEAST_SURVIVAL, 1.0)
            active &= rng.next_float32() < survival
            path.throughput *= dr.select(active, 1.0 / survival, 1.0)
        path.brdf_pdf = dr.select(active, density, path.brdf_pdf)
        path.origin = dr.select(active, origin, path.origin)
        return path, dr.select(active, onward, direction), active

    def _direct(
        self,
        origin: Any,
        frame: Any,
        side: Any,
        wo: Any,
        base_color: Any,
        roughness: Any,
        metallic: Any,
        rng: Any,
        active: Any,
    ) -> Any:
        """Reflected radiance of one emitter sample, weighted against BRDF sampling."""
        if not self._lights.count or self._cached_light:
            return mi.Color3f(0.0)
        light = self._lights.sample_direction(
            origin, rng.next_float32(), rng.next_float32(), rng.next_float32()
        )
        wi = frame.to_local(light.direction)
        usable = active & (light.pdf > 0.0) & (wi.z > 0.0) & (dr.dot(light.direction, side) > 0.0)
        shadow = mi.Ray3f(origin, light.direction)
        shadow.maxt = light.distance * (1.0 - 1e-3)
        usable &= ~self._room.scene.ray_test(shadow, usable)
        value = brdf.evaluate(wi, wo, base_color, roughness, metallic)
        density = light.pdf + brdf.pdf(wi, wo, base_color, roughness, metallic)
        return dr.select(usable, value * light.radiance / dr.maximum(density, 1e-20), mi.Color3f(0.0))


def _make_ready(room: Room) -> None:
    """Let the room make its arrays now: that can't happen while the baking loop is recorded."""
    room.intersect(mi.Ray3f([0, 0, 0], [0, 0, 1]))


def _outside(environment: EnvironmentLight | None, direction: Any, active: Any) -> Any:
    """Color3f that arrives from outside the room; black without an environment."""
    return mi.Color3f(0.0) if environment is None else environment.radiance(direction, active)
