# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Views rendered from a finished estimate alone: paths of Eq. 4 without the radiance cache (paper Sec. 3).

The first surface has the estimated material of its point; later ones, which only their reflected light shows,
that of their voxel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..light.added_lights import add_lamp, joined
from ..light.baking import SUBPIXELS
from ..light.cache import SurfaceLookup, fill_grid, grid_frame, pool, sample_surface
from ..light.emitters import Fixture, emitter_table
from ..light.environment import Environment
from ..light.radiance import OutsideRadiance, TracedRadiance, Vertex, new_path
from ..optics import brdf, factorised
from ..optics.brdf import Material
from ..optics.denoise import Denoiser
from ..optics.environment import EnvironmentLight
from ..optics.lights import AreaLights, EmitterTable
from ..pixels.camera_rays import opaque_vector, trace_pixels
from ..surface.room import Room

# (N, 3) positions, metres, and (N,) triangles -> (N, 3) base colour, (N,) roughness, (N,) metallic.
FieldQuery = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
SPP = 32  # paths a pixel, before denoising
DEPTH = 8  # most surfaces of a path
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
        unseen_light: 0..1, share of the light that was inferred and not seen.
        lamp_doubt: 0..1, share of the lamps' power that is not theirs by their probability.
    """

    room: Room
    query: FieldQuery
    emitters: EmitterTable
    environment: Environment | None
    unseen_light: float = 0.0
    lamp_doubt: float = 0.0

    @classmethod
    def of(
        cls, room: Room, query: FieldQuery, fixtures: Sequence[Fixture], environment: Environment | None
    ) -> Estimate:
        """Of what the stages have found."""
        power = np.array([f.area * float((f.radiance + f.back_radiance).mean()) for f in fixtures])
        certain = np.array([fixture.probability for fixture in fixtures])
        doubt = float(power @ (1.0 - certain) / power.sum()) if power.sum() > 0.0 else 0.0
        inferred = 0.0 if environment is None else environment.unseen_light
        return cls(room, query, emitter_table(list(fixtures)), environment, inferred, doubt)


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
        values = np.column_stack(estimate.query(points.astype(np.float32), triangle.astype(np.int32)))
        materials = SurfaceLookup(grid, pool(grid, entries, values.astype(np.float32))[0])
        self._estimate, self._seed = estimate, seed
        emitters, environment = estimate.emitters, estimate.environment
        for lamp in () if environment is None else environment.lamps:
            shape = np.array(lamp["position"]), lamp["radius"], np.array(lamp["radiance"], np.float32)
            room, added = add_lamp(room, *shape, lamp.get("facing"))
            emitters = joined(emitters, added)
        self._room = room
        self._lights = AreaLights(room.vertices, room.triangles, emitters)
        self._outside = None if environment is None else EnvironmentLight(environment.image)
        outside = None
        if environment is not None:
            everywhere = np.ones(environment.image.shape[:2], bool)
            outside = OutsideRadiance(Environment(environment.image, 1.0, everywhere))
        self._source = TracedRadiance(
            room, None, materials, None, self._lights, outside, cache_roughness=1.0, depth=DEPTH
        )

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
        with Denoiser(albedo, normal, clean_guides=True) as denoiser:
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
        known = valid & (triangle < len(self._estimate.room.triangles))  # others are of inferred lamps
        if known.any():
            position = np.array(surface.position).T[known].astype(np.float32)
            values[known] = np.column_stack(self._estimate.query(position, triangle[known]))
        values = np.clip(values, 0.0, 1.0)
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
        rays = view.rays()[1].reshape(-1, 3)[rows]
        vector = mi.Vector3f(*np.ascontiguousarray(np.repeat(rays, len(SUBPIXELS), axis=0).T, np.float32))
        beyond = np.array(self._outside.radiance(vector)).T
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
