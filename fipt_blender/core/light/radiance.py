"""Incident radiance along a ray while shadings are baked.

Stage 1 reads the radiance cache at the first hit (paper Eq. 9). Stage 3 extends the path over specular
surfaces until it hits an emitter or a surface rough enough for the cache (paper Eq. 10 and 11). Only the
specular part of a surface's reflected radiance depends on the view: the diffuse part is kd L_d, which is
known.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics import brdf, factorised
from ..optics.brdf import Material
from ..optics.lights import AreaLights
from ..surface.room import Room, Surface
from .cache import SurfaceLookup
from .environment import Environment

# Russian roulette: the probability to continue is the throughput times the first, and at least the second:
# the 4 % of a dielectric are not worth a ray each time.
SURVIVAL, MIN_SURVIVAL = 2.5, 0.1


@dataclass  # not frozen: Dr.Jit's loops write their state back into it
class Path:
    """State of one light path per lane.

    Attributes:
        radiance: gathered so far, multiplied by the throughput.
        throughput: product of the BRDF weights f of Eq. 10.
        brdf_pdf: solid-angle density of the last direction. Negative for the path's first direction, whose
            emission counts in full because the baking kernel weights it.
        depth: surfaces met so far.
        origin: of the ray to be traced next.
    """

    radiance: mi.Color3f
    throughput: mi.Color3f
    brdf_pdf: mi.Float
    depth: mi.UInt32
    origin: mi.Point3f


def new_path(width: int = 1) -> Path:
    """A path that has not left its pixel's surface yet; the caller sets the origin."""
    return Path(
        radiance=dr.zeros(mi.Color3f, width),
        throughput=mi.Color3f(1.0),
        brdf_pdf=mi.Float(-1.0),
        depth=dr.zeros(mi.UInt32, width),
        origin=dr.zeros(mi.Point3f, width),
    )


class PathStep(NamedTuple):
    """A path after one surface: the path, its next direction and whether it continues."""

    path: Path
    direction: mi.Vector3f
    active: mi.Bool


class OutsideRadiance:
    """Radiance of rays that leave the mesh: by direction, or by place on the hull where that is inferred."""

    def __init__(self, environment: Environment) -> None:
        self._height, self._width = environment.seen.shape
        self._far = mi.Float(np.ascontiguousarray(environment.image, np.float32).reshape(-1))
        self._hull = hull = environment.hull
        if hull is not None:
            self._seen = mi.Bool(environment.seen.reshape(-1))
            self._low, self._high = ([float(value) for value in corner] for corner in (hull.low, hull.high))
            self._counts = [int(value) for value in hull.counts]
            self._near = mi.Float(np.ascontiguousarray(hull.radiance, np.float32).reshape(-1))

    def radiance(self, origin: mi.Point3f, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
        """Radiance that arrives at points from unit directions, which point away from them."""
        pixel = self._pixel(direction)
        far = dr.gather(mi.Color3f, self._far, pixel, active)
        if self._hull is None:
            return far
        seen = dr.gather(mi.Bool, self._seen, pixel, active)
        near = dr.gather(mi.Color3f, self._near, self._cell(origin, direction), active & ~seen)
        return dr.select(seen | (near.x < 0.0), far, near)

    def _pixel(self, direction: mi.Vector3f) -> mi.UInt32:
        """Of the map, as :func:`.environment.map_cells`."""
        u = 0.5 - dr.atan2(direction.y, direction.x) * (0.5 * dr.inv_pi)
        v = dr.acos(dr.clip(direction.z, -1.0, 1.0)) * dr.inv_pi
        column = dr.minimum(mi.UInt32(dr.clip(u, 0.0, 1.0) * self._width), self._width - 1)
        row = dr.minimum(mi.UInt32(v * self._height), self._height - 1)
        return row * self._width + column

    def _cell(self, origin: mi.Point3f, direction: mi.Vector3f) -> mi.UInt32:
        """As :meth:`.environment.Hull.cells`."""
        low, high = mi.Point3f(*self._low), mi.Point3f(*self._high)
        origin = dr.clip(mi.Point3f(origin), low, high)
        way = dr.select(dr.abs(direction) < 1e-9, 1e-9, direction)
        reach = (dr.select(way > 0.0, mi.Vector3f(high), mi.Vector3f(low)) - mi.Vector3f(origin)) / way
        side = dr.select(
            (reach.x <= reach.y) & (reach.x <= reach.z), mi.UInt32(0), dr.select(reach.y <= reach.z, 1, 2)
        )
        place = origin + way * dr.min(reach)
        count = mi.Vector3f(*[float(value) for value in self._counts])
        cell = mi.Vector3i(dr.floor((place - low) / (high - low) * count))
        cell = dr.clip(cell, 0, mi.Vector3i(*[value - 1 for value in self._counts]))
        component = dr.select(side == 0, way.x, dr.select(side == 1, way.y, way.z))
        flat = (cell.x * self._counts[1] + cell.y) * self._counts[2] + cell.z
        return mi.UInt32(flat) * 6 + 2 * side + dr.select(component > 0.0, mi.UInt32(1), 0)


class RadianceSource(ABC):
    """Incident radiance for the baking kernel, one surface of the path at a time.

    Attributes:
        offset: metres by which a ray starts above a surface.
    """

    def __init__(self, room: Room, environment: OutsideRadiance | None) -> None:
        self._room, self._environment, self.offset = room, environment, room.offset
        # Makes the room's arrays now: that is impossible while the baking loop is recorded.
        room.intersect(mi.Ray3f([0, 0, 0], [0, 0, 1]))

    def intersect(self, ray: mi.Ray3f, active: mi.Bool) -> Surface:
        """First surface along the ray."""
        return self._room.intersect(ray, active)

    def _outside(self, origin: mi.Point3f, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
        """Radiance of the environment; black without one."""
        environment = self._environment
        return mi.Color3f(0.0) if environment is None else environment.radiance(origin, direction, active)

    @abstractmethod
    def step(
        self, path: Path, direction: mi.Vector3f, hit: Surface, rng: mi.PCG32, active: mi.Bool
    ) -> PathStep:
        """Add the radiance that leaves `hit` against `direction`, and choose the next direction."""


class CachedRadiance(RadianceSource):
    """Stage 1: the cache at the first hit (paper Eq. 9), the environment where there is none.

    Args:
        lights: emitters that are not reflective have their own radiance instead of the cache's.
    """

    def __init__(
        self,
        room: Room,
        cache: SurfaceLookup,
        environment: OutsideRadiance | None,
        lights: AreaLights | None = None,
    ) -> None:
        super().__init__(room, environment)
        self._cache, self._lights = cache, lights

    def step(
        self, path: Path, direction: mi.Vector3f, hit: Surface, rng: mi.PCG32, active: mi.Bool
    ) -> PathStep:
        """Read the cache on the side that the ray hits; the path ends."""
        side = dr.select(hit.front, hit.geometric_normal, -hit.geometric_normal)
        met = active & hit.valid
        found = mi.Color3f(*self._cache(hit.position, side, met))
        if self._lights is not None:
            emits = self._lights.is_emitter(hit.triangle, met)
            cosine = -dr.dot(hit.geometric_normal, direction)
            found = dr.select(emits, self._lights.radiance(hit.triangle, cosine, emits), found)
        escaped = self._outside(path.origin, direction, active & ~hit.valid)
        path.radiance = dr.select(active, dr.select(hit.valid, found, escaped), mi.Color3f(0.0))
        return PathStep(path, direction, mi.Bool(False))


class Vertex(NamedTuple):
    """A path's surface point at which light is reflected.

    Attributes:
        origin: of rays that leave the surface, metres.
        frame: local shading frame.
        side: geometric normal on the viewer's side.
        wo: unit direction towards the viewer, local.
        material: of the surface.
    """

    origin: mi.Point3f
    frame: mi.Frame3f
    side: mi.Normal3f
    wo: mi.Vector3f
    material: Material


class TracedRadiance(RadianceSource):
    """Stage 3: paths over surfaces with roughness up to `cache_roughness`, ending in emitters or the cache.

    Emitters are sampled at every vertex and combined with BRDF samples by the balance heuristic.

    Args:
        materials: base colour (3), roughness and metallic of the surface, five values.
        cache: photographs averaged without the pixels of emitters. None traces every path to its depth with
            the materials alone and loses the light of longer paths (the paper's ablation "w/o rad. cache").
        diffuse: L_d, three values, negative where unknown. Where it is known, paths sample the specular
            lobes alone; elsewhere, and with None, both lobes as in the paper.
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
        environment: OutsideRadiance | None,
        cache_roughness: float,
        depth: int,
    ) -> None:
        super().__init__(room, environment)
        self._cache, self._materials, self._diffuse, self._lights = cache, materials, diffuse, lights
        self._cache_roughness, self._depth = cache_roughness, depth

    def step(
        self, path: Path, direction: mi.Vector3f, hit: Surface, rng: mi.PCG32, active: mi.Bool
    ) -> PathStep:
        """Add the radiance that leaves `hit` against `direction`, and sample the BRDF for the next one."""
        lights = self._lights

        # ---------------------- Direct emission: R = L_e (Eq. 11) ----------------------

        radiance = self._outside(path.origin, direction, active & ~hit.valid)
        active = active & hit.valid
        cosine = -dr.dot(hit.geometric_normal, direction)
        is_emitter = lights.is_emitter(hit.triangle, active)
        emitted = lights.radiance(hit.triangle, cosine, is_emitter)
        light_pdf = lights.pdf_direction(hit.triangle, hit.distance, cosine, is_emitter)
        mis_weight = path.brdf_pdf / dr.maximum(path.brdf_pdf + light_pdf, 1e-20)
        radiance += emitted * dr.select(path.brdf_pdf < 0.0, 1.0, mis_weight)
        active &= ~is_emitter

        # ------------------- Radiance cache: R = L', sigma > 0.6 (Eq. 11) --------------------

        side = dr.select(hit.front, hit.geometric_normal, -hit.geometric_normal)
        entry = self._materials.entry(hit.position, side, active)
        r, g, b, roughness, metallic = self._materials.values(entry, active)
        base_color = mi.Color3f(r, g, b)
        path.depth += 1
        ends = active & (path.depth >= self._depth)
        if self._cache is not None:
            ends |= active & (roughness > self._cache_roughness)
            radiance += mi.Color3f(*self._cache.values(entry, ends))
            active &= ~ends

        # ------------------------ Diffuse reflection: kd L_d (Eq. 5) -------------------------

        if self._diffuse is not None:
            kd = factorised.diffuse_reflectance(base_color, metallic)
            shading = mi.Color3f(*self._diffuse.values(entry, active))
            known = active & (shading.x >= 0.0)
            radiance += dr.select(known, kd * shading, 0.0)
            # The remaining specular lobes are those of a metal of base colour ks.
            base_color = dr.select(known, factorised.specular_reflectance(base_color, metallic), base_color)
            metallic = dr.select(known, 1.0, metallic)

        # ---------------------------------- Emitter sampling ---------------------------------

        frame = mi.Frame3f(hit.normal)
        wo = frame.to_local(-direction)
        wo.z = dr.maximum(wo.z, 1e-3)
        wo = dr.normalize(wo)
        material = Material(base_color, roughness, metallic)
        vertex = Vertex(hit.position + mi.Vector3f(side) * self.offset, frame, side, wo, material)
        radiance += self.sample_emitter(vertex, rng, active)
        path.radiance += path.throughput * radiance

        # ---------------- BRDF sampling: f(x_{i+1} -> x_i) of the product (Eq. 10) ----------------

        lobe = rng.next_float32()
        sample2 = mi.Point2f(rng.next_float32(), rng.next_float32())
        wi, weight, brdf_pdf = brdf.sample(lobe, sample2, wo, *material)
        onward = frame.to_world(wi)
        active &= (brdf_pdf > 0.0) & (dr.dot(onward, side) > 0.0) & ~ends
        path.throughput *= dr.select(active, weight, mi.Color3f(1.0))

        # ---------------------------------- Russian roulette ---------------------------------

        survival = dr.clip(SURVIVAL * dr.max(path.throughput), MIN_SURVIVAL, 1.0)
        active &= rng.next_float32() < survival
        path.throughput *= dr.select(active, 1.0 / survival, 1.0)

        path.brdf_pdf = dr.select(active, brdf_pdf, path.brdf_pdf)
        path.origin = dr.select(active, vertex.origin, path.origin)
        return PathStep(path, dr.select(active, onward, direction), active)

    def sample_emitter(self, vertex: Vertex, rng: mi.PCG32, active: mi.Bool) -> mi.Color3f:
        """Reflected radiance of one emitter sample, weighted against BRDF sampling (balance heuristic)."""
        if not self._lights.count:
            return mi.Color3f(0.0)
        light = self._lights.sample_direction(
            vertex.origin, rng.next_float32(), rng.next_float32(), rng.next_float32()
        )
        wi = vertex.frame.to_local(light.direction)
        usable = active & (light.pdf > 0.0) & (wi.z > 0.0) & (dr.dot(light.direction, vertex.side) > 0.0)
        shadow_ray = mi.Ray3f(vertex.origin, light.direction)
        shadow_ray.maxt = light.distance * (1.0 - 1e-3)
        usable &= ~self._room.scene.ray_test(shadow_ray, usable)
        value = brdf.evaluate(wi, vertex.wo, *vertex.material)
        density = light.pdf + brdf.pdf(wi, vertex.wo, *vertex.material)
        return dr.select(usable, value * light.radiance / dr.maximum(density, 1e-20), mi.Color3f(0.0))
