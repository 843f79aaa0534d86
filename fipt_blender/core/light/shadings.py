# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking of the diffuse and specular shadings (paper Sec. 4.1 to 4.3, Eq. 6, 8 and 9).

One kernel serves stage 1 and stage 3; they differ in where the radiance along a ray comes from
(:mod:`.radiance`). All rays of a pixel are one pool: cosine samples, visible-normal samples of every
roughness level and samples aimed at lights are weighted by the balance heuristic and count for L_d and for
L_s0 and L_s1 of every level at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..material import brdf
from ..render.lights import AreaLights
from .radiance import RadianceSource, new_path

# Low-discrepancy increments of the R2 sequence (M. Roberts, 2018).
_R2 = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True)
class SampleCounts:
    """Samples a pixel: cosine-distributed, for each roughness level, and aimed at lights."""

    diffuse: int
    specular: int
    light: int


@dataclass(frozen=True)
class ShadingPoints:
    """Surface points to shade: numpy arrays (N, 3) float32, or Dr.Jit vectors that are on the device already.

    Attributes:
        position: metres.
        normal: unit shading normal towards the viewer.
        geometric_normal: unit, on the viewer's side.
        view_direction: unit, towards the viewer.
    """

    position: Any
    normal: Any
    geometric_normal: Any
    view_direction: Any

    def on_device(self) -> ShadingPoints:
        """The same as a Point3f, two Normal3f and a Vector3f."""
        kinds = mi.Point3f, mi.Normal3f, mi.Normal3f, mi.Vector3f
        arrays = self.position, self.normal, self.geometric_normal, self.view_direction
        return ShadingPoints(*(_vector(kind, array) for kind, array in zip(kinds, arrays, strict=True)))


@dataclass(frozen=True)
class Shadings:
    """Baked shadings of some points, in the units of the radiance source.

    Attributes:
        diffuse: (N, 3) float32, L_d.
        specular: (N, K, 2, 3) float32, L_s0 and L_s1 at each roughness level.
    """

    diffuse: np.ndarray
    specular: np.ndarray


def roughness_levels(count: int, lowest: float, spacing: float) -> np.ndarray:
    """(count,) float32 roughness levels from `lowest` to 1.

    `spacing` 1 is the paper's linear spacing; above 1 the levels stand closer where lobes are sharp and
    linear interpolation errs most.
    """
    t = np.linspace(0.0, 1.0, count) ** spacing
    return (lowest + (1.0 - lowest) * t).astype(np.float32)


def bake(
    points: ShadingPoints,
    source: RadianceSource,
    lights: AreaLights,
    levels: np.ndarray,
    counts: SampleCounts,
    seed: int,
    starts: int = 1,
) -> Shadings:
    """Estimate L_d, L_s0 and L_s1 of each point, or means over each `starts` points that follow each other.

    Unbiased for the radiance that `source` returns: what a ray meets first is either one of `lights`, which
    all techniques may sample, or not, which only the BRDF techniques sample; both parts have weights that
    sum to one.

    Args:
        lights: triangles to aim at; only their sampling is used, radiance always comes from `source`.
        levels: (K,) roughness levels; with none L_d alone is estimated.
        counts: each may be zero, but not all.
        seed: of the random numbers; the same seed gives the same result.
        starts: points of a result.
    """
    points = points.on_device()
    width = dr.width(points.position) // starts
    if not width:
        return Shadings(np.zeros((0, 3), np.float32), np.zeros((0, len(levels), 2, 3), np.float32))
    accumulators = _bake_kernel(
        points.position,
        mi.Frame3f(points.normal),
        points.geometric_normal,
        points.view_direction,
        source,
        lights,
        [float(level) for level in levels],
        counts.diffuse,
        counts.specular if len(levels) else 0,
        counts.light if lights.count else 0,
        seed,
        starts,
    )
    dr.eval(accumulators)
    found = means(accumulators, starts)
    return Shadings(found[:, :3].copy(), found[:, 3:].reshape(width, len(levels), 2, 3).copy())


def means(values: list[Any], group: int) -> np.ndarray:
    """(N, 3 * len(values)) float32 means over each `group` lanes of evaluated vectors (width N * group).

    Taken on the device, as only they are needed elsewhere.
    """
    channels = [channel for value in values for channel in (value.x, value.y, value.z)]
    width = dr.width(channels) // group
    row = dr.arange(mi.UInt32, width)
    packed = dr.zeros(mi.Float, width * len(channels))
    for number, channel in enumerate(channels):
        total = mi.Float(0.0)
        for member in range(group):
            total += dr.gather(mi.Float, channel, row * group + member)
        dr.scatter(packed, total / group, row * len(channels) + number)
    return np.array(packed).reshape(width, len(channels))


def _vector(kind: Any, array: Any) -> Any:
    if isinstance(array, np.ndarray):
        return kind(np.ascontiguousarray(np.asarray(array, np.float32).T))
    return kind(array)


def _generator(lane: Any, seed: int) -> Any:
    """A generator a lane; hashed, as the streams of neighbouring PCG sequences are alike."""
    words = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))
    return mi.PCG32(initstate=mi.UInt64(words[0]), initseq=mi.UInt64(words[1]))


@dr.syntax
def _bake_kernel(
    position: Any,
    frame: Any,
    geometric: Any,
    view: Any,
    source: RadianceSource,
    lights: AreaLights,
    levels: list[float],
    cosine_count: int,
    level_count: int,
    light_count: int,
    seed: int,
    starts_of_point: int,
) -> list[Any]:
    """One loop over the vertices of all paths of a pixel: each pass adds a vertex to the path of sample i,
    and a path that ends makes room for the next sample."""
    wo = frame.to_local(view)
    wo.z = dr.maximum(wo.z, 1e-3)  # interpolated normals may tip just over the horizon
    wo = dr.normalize(wo)
    # All starts of a point share one low-discrepancy sequence.
    lane = dr.arange(mi.UInt32, dr.width(position))
    point = lane // starts_of_point
    shift_rng, rng = _generator(point, 2 * seed), _generator(lane, 2 * seed + 1)
    shift = mi.Point2f(shift_rng.next_float32(), shift_rng.next_float32())
    phase = lane - point * starts_of_point
    accumulators = [mi.Color3f(0.0) for _ in range(1 + 2 * len(levels))]
    roughness_of = mi.Float(levels or [1.0])  # a loop can't carry nothing
    brdf_count = cosine_count + level_count * len(levels)
    total = brdf_count + light_count
    i = mi.UInt32(0)
    starts = mi.Bool(True)
    wi = mi.Vector3f(0.0, 0.0, 1.0)
    direction = mi.Vector3f(0.0, 0.0, 1.0)
    density = mi.Float(1.0)
    path = new_path(dr.width(position))
    while i < total:
        # A new path's direction, by one of the techniques.
        number = i * starts_of_point + phase
        u = mi.Point2f(shift.x + number * _R2[0], shift.y + number * _R2[1])
        u = u - dr.floor(u)
        first = mi.warp.square_to_cosine_hemisphere(u)
        if dr.hint(level_count > 0, mode="scalar"):
            level = dr.clip((mi.Int32(i) - cosine_count) // level_count, 0, len(levels) - 1)
            roughness = dr.gather(mi.Float, roughness_of, mi.UInt32(level))
            first = dr.select(i < cosine_count, first, brdf.sample_visible_normal(u, wo, roughness))
        aimed = starts & (i >= brdf_count)
        if dr.hint(light_count > 0, mode="scalar"):
            target = lights.sample(rng.next_float32(), u.x, u.y)
            first = dr.select(aimed, frame.to_local(dr.normalize(target.position - position)), first)
        wi = dr.select(starts, first, wi)
        path = dr.select(starts, new_path(), path)
        direction = dr.select(starts, frame.to_world(wi), direction)
        path.origin = dr.select(starts, position + mi.Vector3f(geometric) * source.offset, path.origin)
        alive = ~starts | ((wi.z > 0.0) & (dr.dot(direction, geometric) > 0.0))
        hit = source.intersect(mi.Ray3f(path.origin, direction), alive)

        pdf = cosine_count * dr.maximum(wi.z, 0.0) * dr.inv_pi
        for roughness_level in levels:
            pdf += level_count * brdf.visible_normal_pdf(wi, wo, roughness_level)
        if dr.hint(light_count > 0, mode="scalar"):
            emitter = lights.pdf_direction(
                hit.triangle, hit.distance, dr.dot(hit.geometric_normal, direction), hit.valid
            )
            # An aimed ray that meets something else first belongs to the other techniques, and where that is
            # another light, to the samples aimed at that one.
            alive &= ~aimed | ((emitter > 0.0) & (hit.triangle == target.triangle))
            pdf += light_count * emitter
        density = dr.select(starts, pdf, density)
        alive &= density > 1e-20
        path, direction, goes_on = source.step(path, direction, hit, rng, alive)
        starts = ~goes_on

        weighted = dr.select(starts, path.radiance / dr.maximum(density, 1e-20), 0.0)
        accumulators[0] += weighted * (dr.maximum(wi.z, 0.0) * dr.inv_pi)
        for k in range(len(levels)):
            s0, s1 = brdf.specular_lobes(wi, wo, levels[k])
            accumulators[1 + 2 * k] += weighted * s0
            accumulators[2 + 2 * k] += weighted * s1
        i += dr.select(starts, mi.UInt32(1), mi.UInt32(0))
    return accumulators
