"""Views rendered from a finished estimate alone: paths of Eq. 4 without the radiance cache (paper Sec. 3).

They are lit by what the .blend has: lamps without a surface shine, but cover nothing and are not seen.

The first surface has the estimated material of its point; later ones, which only their reflected light shows,
that of their voxel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import map_coordinates

from ..capture.views import View
from ..conventions import direction_to_equirect
from ..light.added_lights import add_lamp
from ..light.baking import SUBPIXELS
from ..light.cache import SurfaceLookup, fill_grid, grid_frame, pool, sample_surface
from ..light.environment import Environment
from ..light.radiance import OutsideRadiance, Path, PathStep, TracedRadiance, Vertex, new_path
from ..optics import brdf, factorised
from ..optics.brdf import Material
from ..optics.denoise import Denoiser
from ..optics.lights import AreaLights, EmitterTable
from ..pixels.camera_rays import opaque_vector, trace_pixels
from ..surface.room import Room, Surface

# (N, 3) positions, metres, and (N,) triangles -> (N, 3) base colour, (N,) roughness, (N,) metallic.
FieldQuery = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
SPP = 16  # paths a pixel, before denoising
DEPTH = 32  # most surfaces of a path, as in our Cycles renders; Russian roulette ends most before
VOXELS = 128  # along each axis, for the materials that reflections show
PATHS_AT_ONCE = 1 << 20  # bounds memory


@dataclass(frozen=True, eq=False)
class Estimate:
    """A finished estimate; radiance in units of the capture's median.

    Attributes:
        room: the mesh.
        query: materials of its surfaces.
        emitters: its lamps.
        environment: radiance from outside, with the lamps that were inferred, or None.
    """

    room: Room
    query: FieldQuery
    emitters: EmitterTable
    environment: Environment | None


class _Paths(TracedRadiance):
    """Paths in a room that also has lamps without a surface: like Blender's lights, these cover nothing.

    Paths gather their light and go on behind them; cameras do not see them.
    """

    def __init__(
        self, room: Room, materials: SurfaceLookup, environment: Environment | None, emitters: EmitterTable
    ):
        extended, first = room, len(room.triangles)
        for lamp in () if environment is None else environment.lamps:
            shape = np.array(lamp.position), lamp.radius, np.array(lamp.radiance, np.float32)
            extended, added = add_lamp(extended, *shape, lamp.facing)
            emitters = emitters.joined(added)
        self.lights = AreaLights(extended.vertices, extended.triangles, emitters)
        # The .blend has the image alone: light that the hull has by place is in its lamps, or in the image.
        outside = None if environment is None else OutsideRadiance(replace(environment, hull=None))
        super().__init__(room, None, materials, None, self.lights, outside, cache_roughness=1.0, depth=DEPTH)
        self.first = first
        self.lamps = None
        if len(extended.triangles) > first:
            arrays = ("triangles", "corner_normals", "triangle_object", "triangle_material")
            self.lamps = replace(extended, **{name: getattr(extended, name)[first:] for name in arrays})
            self.lamps.intersect(mi.Ray3f([0, 0, 0], [0, 0, 1]))  # makes its arrays before loops are recorded

    def step(
        self, path: Path, direction: mi.Vector3f, hit: Surface, rng: mi.PCG32, active: mi.Bool
    ) -> PathStep:
        """As of `TracedRadiance`, with the lamps on the way to `hit`."""
        if self.lamps is not None:
            reach = dr.select(hit.valid, hit.distance, dr.inf)
            path.radiance += path.throughput * _crossed(self, path, direction, reach, mi.Bool(active))
        return super().step(path, direction, hit, rng, active)


class Renderer:
    """Renders views of an estimate; the run's masking term must be set (`brdf.set_masking`).

    Args:
        seed: of the random numbers.
    """

    def __init__(self, estimate: Estimate, seed: int) -> None:
        room, rng = estimate.room, np.random.default_rng([seed, 11])
        grid = fill_grid(room, grid_frame(room, VOXELS), np.zeros(0, np.int64), rng)
        points, triangle = sample_surface(room, 2.0 * float(np.median(grid.size)), rng)
        normals = room.normals[triangle]
        entries = np.concatenate([grid.entries(points, side * normals) for side in (1.0, -1.0)])
        entries, first = np.unique(entries, return_index=True)
        points, triangle = (
            np.tile(values, (2, 1) if values.ndim > 1 else 2)[first] for values in (points, triangle)
        )
        self._room, self._query, self._seed = room, estimate.query, seed
        materials = SurfaceLookup(grid, pool(grid, entries, self._materials(points, triangle))[0])
        self._source = _Paths(room, materials, estimate.environment, estimate.emitters)
        self._lights = self._source.lights
        environment = estimate.environment
        self._outside = None if environment is None else environment.image

    def _materials(self, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """(N, 5) float32 base colour, roughness and metallic of surface points, clipped as in textures."""
        values = self._query(points.astype(np.float32), triangles.astype(np.int32))
        return np.clip(np.column_stack(values), 0.0, 1.0).astype(np.float32)

    def render(self, view: View, stream: int = 0) -> np.ndarray:
        """(H, W, 3) float32 radiance of a view, denoised.

        Args:
            stream: of random numbers; views of different streams have independent noise.
        """
        count, starts = view.width * view.height, len(SUBPIXELS)
        planes = np.zeros((count, 9), np.float32)
        step = max(1, PATHS_AT_ONCE // SPP)
        for number, begin in enumerate(range(0, count, step)):
            rows = np.arange(begin, min(begin + step, count))
            seed = (self._seed * 100003 + stream) * 1009 + number
            found = self._traced(view, rows, seed)
            planes[rows] = found.reshape(len(rows), starts, 9).mean(axis=1)
        color, albedo, normal = planes.reshape(view.height, view.width, 3, 3).transpose(2, 0, 1, 3)
        with Denoiser(albedo, normal) as denoiser:
            return denoiser(color)

    def _traced(self, view: View, rows: np.ndarray, seed: int) -> np.ndarray:
        """(N * starts, 9) radiance, albedo and normal of pixels (N,), at each of `SUBPIXELS` in order."""
        room, repeats = self._room, SPP // len(SUBPIXELS)
        surface = trace_pixels(room, view, SUBPIXELS, mi.UInt32(rows.astype(np.uint32)))
        camera = opaque_vector(mi.Point3f, np.asarray(view.camera_to_world)[:3, 3])
        direction = dr.normalize(surface.position - camera)
        dr.eval(surface.valid, surface.position, surface.normal, surface.triangle, direction)
        valid, triangle = np.array(surface.valid), np.array(surface.triangle).astype(np.int32)
        values = np.zeros((len(valid), 5), np.float32)
        if valid.any():
            values[valid] = self._materials(np.array(surface.position).T[valid], triangle[valid])
        emits = np.array(self._lights.is_emitter(surface.triangle, surface.valid))
        direct = self._direct(view, rows, surface, direction)
        lanes = dr.repeat(dr.arange(mi.UInt32, len(valid)), repeats)
        table = [mi.Float(np.ascontiguousarray(column)) for column in values.T]
        material = Material(
            mi.Color3f(*(dr.gather(mi.Float, column, lanes) for column in table[:3])),
            dr.maximum(dr.gather(mi.Float, table[3], lanes), brdf.MIN_ROUGHNESS),
            dr.gather(mi.Float, table[4], lanes),
        )
        side = dr.select(surface.front, surface.geometric_normal, -surface.geometric_normal)
        vectors = (surface.position, surface.normal, side, direction)
        kinds = (mi.Point3f, mi.Normal3f, mi.Normal3f, mi.Vector3f)
        given = [dr.gather(kind, kind(vector), lanes) for kind, vector in zip(kinds, vectors, strict=True)]
        active = mi.Bool(np.repeat(valid & ~emits, repeats))
        reflected = self._reflected(given, material, active, seed)
        dr.eval(reflected)
        mean = np.array(reflected).T.reshape(len(valid), repeats, 3).mean(axis=1)
        color, metallic = values[:, :3], values[:, 4:]
        albedo = factorised.diffuse_reflectance(color, metallic)
        albedo = albedo + factorised.specular_reflectance(color, metallic)
        albedo = np.where(emits[:, None], 1.0, np.where(valid[:, None], albedo, 0.0))
        normal = np.where(valid[:, None], np.array(surface.normal).T, 0.0)
        return np.concatenate([mean + direct, albedo, normal], axis=1)

    def _direct(self, view: View, rows: np.ndarray, surface: Any, direction: mi.Vector3f) -> np.ndarray:
        """(N * starts, 3) emission of the first surface, or of the environment where there is none."""
        cosine = -dr.dot(surface.geometric_normal, direction)
        emitted = np.array(self._lights.radiance(surface.triangle, cosine, surface.valid)).T
        if self._outside is None:
            return np.where(np.array(surface.valid)[:, None], emitted, 0.0)
        # The map is coarse; the middle of a pixel does for all its starts.
        uv = direction_to_equirect(view.rays()[1].reshape(-1, 3)[rows])
        height, width = self._outside.shape[:2]
        place = np.stack([(1.0 - uv[:, 1]) * height, uv[:, 0] * width]) - 0.5
        # Between the map's pixels as Blender's texture.
        planes = (
            map_coordinates(plane, place, order=1, mode="grid-wrap")
            for plane in np.moveaxis(self._outside, 2, 0)
        )
        beyond = np.repeat(np.stack(list(planes), axis=1), len(SUBPIXELS), axis=0)
        return np.where(np.array(surface.valid)[:, None], emitted, beyond)

    def _reflected(self, given: list[Any], material: Material, active: mi.Bool, seed: int) -> mi.Color3f:
        """Reflected radiance of the first surfaces: an emitter and a BRDF sample, and the path from there."""
        position, normal, side, direction = given
        words = mi.sample_tea_32(
            dr.arange(mi.UInt32, dr.width(position)), dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)
        )
        rng = mi.PCG32(initstate=mi.UInt64(words[0]), initseq=mi.UInt64(words[1]))
        frame = mi.Frame3f(normal)
        wo = frame.to_local(-direction)
        wo.z = dr.maximum(wo.z, 1e-3)
        wo = dr.normalize(wo)
        vertex = Vertex(position + mi.Vector3f(side) * self._source.offset, frame, side, wo, material)
        path = new_path(dr.width(position))
        path.radiance = mi.Color3f(self._source.sample_emitter(vertex, rng, active))
        wi, weight, density = brdf.sample(
            rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32()), wo, *material
        )
        onward = frame.to_world(wi)
        active = active & (density > 0.0) & (dr.dot(onward, side) > 0.0)
        path.throughput = dr.select(active, weight, mi.Color3f(0.0))
        path.brdf_pdf, path.origin = mi.Float(density), mi.Point3f(vertex.origin)
        dr.eval(path, onward, active, rng)
        return _followed(self._source, path, onward, active, rng)


@dr.syntax
def _followed(
    source: TracedRadiance, path: Any, direction: mi.Vector3f, active: mi.Bool, rng: mi.PCG32
) -> mi.Color3f:
    """Radiance that paths gather from here on, with what they have gathered before."""
    while active:
        hit = source.intersect(mi.Ray3f(path.origin, direction), active)
        path, direction, active = source.step(path, direction, hit, rng, active)
    return path.radiance


@dr.syntax
def _crossed(
    source: _Paths, path: Any, direction: mi.Vector3f, reach: mi.Float, active: mi.Bool
) -> mi.Color3f:
    """Radiance of the lamps that rays cross before `reach` metres, weighted against emitter sampling."""
    assert source.lamps is not None
    gathered, start = dr.zeros(mi.Color3f, dr.width(active)), dr.zeros(mi.Float, dr.width(active))
    while active:
        ray = mi.Ray3f(path.origin + start * direction, direction)
        ray.maxt = reach - start
        hit = source.lamps.intersect(ray, active)
        active &= hit.valid
        distance = start + hit.distance
        triangle, cosine = hit.triangle + source.first, -dr.dot(hit.geometric_normal, direction)
        density = source.lights.pdf_direction(triangle, distance, cosine, active)
        weight = path.brdf_pdf / dr.maximum(path.brdf_pdf + density, 1e-20)
        gathered += dr.select(active, weight * source.lights.radiance(triangle, cosine, active), 0.0)
        start = distance + source.offset
    return gathered
