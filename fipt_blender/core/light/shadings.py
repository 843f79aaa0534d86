"""Baking of the diffuse and specular shadings (paper Sec. 4.1 to 4.3, Eq. 6 and 9 to 11).

One kernel serves stage 1 and stage 3, which differ in the source of incident radiance (:mod:`.radiance`). All
samples of a pixel are combined by multiple importance sampling: cosine-distributed directions, visible
normals of every roughness level and directions to emitters are weighted by the balance heuristic, and each
contributes to L_d and to L_s0 and L_s1 of every level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics import brdf
from ..optics.lights import AreaLights
from .radiance import RadianceSource, new_path

# Low-discrepancy increments of the R2 sequence (M. Roberts, 2018).
_R2 = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True)
class SampleCounts:
    """Samples per pixel: cosine-distributed, for each roughness level, and towards emitters."""

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

    position: np.ndarray | mi.Point3f
    normal: np.ndarray | mi.Normal3f
    geometric_normal: np.ndarray | mi.Normal3f
    view_direction: np.ndarray | mi.Vector3f

    def on_device(self) -> ShadingPoints:
        """The same points as Dr.Jit vectors."""
        return ShadingPoints(
            _vector(mi.Point3f, self.position),
            _vector(mi.Normal3f, self.normal),
            _vector(mi.Normal3f, self.geometric_normal),
            _vector(mi.Vector3f, self.view_direction),
        )


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
    """(count,) float32 roughness levels from `lowest` to 1 (paper Eq. 8).

    `spacing` 1 is the paper's linear spacing; above 1 the levels are denser where lobes are sharp and the
    linear interpolation has its largest error.
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
    """Estimate L_d, L_s0 and L_s1 (paper Eq. 6) of each point, or means over `starts` consecutive points.

    Unbiased for the radiance that `source` returns: the first surface along a ray is either one of `lights`,
    which all techniques may sample, or not, and only the BRDF techniques sample it; the weights of either
    case sum to one.

    Args:
        lights: triangles to sample; radiance always comes from `source`.
        levels: (K,) roughness levels; with none, only L_d is estimated.
        counts: each may be zero, but not all.
        seed: of the random numbers; the same seed gives the same result.
        starts: points per result.
    """
    points = points.on_device()
    width = dr.width(points.position) // starts
    if not width:
        return Shadings(np.zeros((0, 3), np.float32), np.zeros((0, len(levels), 2, 3), np.float32))
    counts = replace(
        counts,
        specular=counts.specular if len(levels) else 0,
        light=counts.light if lights.count else 0,
    )
    integrals = _bake_kernel(points, source, lights, [float(level) for level in levels], counts, seed, starts)
    dr.eval(integrals)
    shadings = means(integrals, starts)
    return Shadings(shadings[:, :3].copy(), shadings[:, 3:].reshape(width, len(levels), 2, 3).copy())


def means(values: Sequence[mi.Vector3f | mi.Color3f], group: int) -> np.ndarray:
    """(N, 3 * len(values)) float32 means over each `group` lanes of evaluated vectors (N * group lanes).

    Computed on the device, so that only the means are copied.
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


def _vector(kind: type, array: np.ndarray | mi.Vector3f) -> mi.Vector3f:
    if isinstance(array, np.ndarray):
        return kind(np.ascontiguousarray(np.asarray(array, np.float32).T))
    return kind(array)


def _generator(lane: mi.UInt32, seed: int) -> mi.PCG32:
    """A generator per lane; hashed, as the streams of neighbouring PCG sequences are correlated."""
    words = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))
    return mi.PCG32(initstate=mi.UInt64(words[0]), initseq=mi.UInt64(words[1]))


@dr.syntax
def _bake_kernel(
    points: ShadingPoints,
    source: RadianceSource,
    lights: AreaLights,
    levels: list[float],
    counts: SampleCounts,
    seed: int,
    starts_per_point: int,
) -> list[mi.Color3f]:
    """Sums of the estimators of L_d and of L_s0 and L_s1 of each level, per lane.

    One loop over the vertices of all paths of a lane: each pass adds a vertex to the path of sample i; the
    pass after a path's end starts the next sample.
    """
    # A loop can't carry frozen dataclasses.
    geometric_normal = points.geometric_normal
    # Rays start above the surface, and aim from there: small triangles of a lamp would be missed otherwise.
    lifted = points.position + mi.Vector3f(geometric_normal) * source.offset
    cosine_count, level_count, light_count = counts.diffuse, counts.specular, counts.light
    brdf_count = cosine_count + level_count * len(levels)
    total = brdf_count + light_count
    frame = mi.Frame3f(points.normal)
    wo = frame.to_local(points.view_direction)
    wo.z = dr.maximum(wo.z, 1e-3)  # interpolated normals may tip just over the horizon
    wo = dr.normalize(wo)
    # All starts of a point share one low-discrepancy sequence.
    lane = dr.arange(mi.UInt32, dr.width(lifted))
    point = lane // starts_per_point
    shift_rng, rng = _generator(point, 2 * seed), _generator(lane, 2 * seed + 1)
    shift = mi.Point2f(shift_rng.next_float32(), shift_rng.next_float32())
    phase = lane - point * starts_per_point
    integrals = [mi.Color3f(0.0) for _ in range(1 + 2 * len(levels))]
    roughness_of = mi.Float(levels or [1.0])  # a loop can't carry an empty array
    i = mi.UInt32(0)
    starts = mi.Bool(True)
    wi = mi.Vector3f(0.0, 0.0, 1.0)
    direction = mi.Vector3f(0.0, 0.0, 1.0)
    density = mi.Float(1.0)
    path = new_path(dr.width(lifted))
    while i < total:
        # --------------- First direction: cosine, visible normals or emitter sampling ---------------

        index = i * starts_per_point + phase
        u = mi.Point2f(shift.x + index * _R2[0], shift.y + index * _R2[1])
        u = u - dr.floor(u)
        first = mi.warp.square_to_cosine_hemisphere(u)
        if dr.hint(level_count > 0, mode="scalar"):
            level = dr.clip((mi.Int32(i) - cosine_count) // level_count, 0, len(levels) - 1)
            roughness = dr.gather(mi.Float, roughness_of, mi.UInt32(level))
            first = dr.select(i < cosine_count, first, brdf.sample_visible_normal(u, wo, roughness))
        to_emitter = starts & (i >= brdf_count)
        if dr.hint(light_count > 0, mode="scalar"):
            target = lights.sample(rng.next_float32(), u.x, u.y)
            first = dr.select(to_emitter, frame.to_local(dr.normalize(target.position - lifted)), first)
        wi = dr.select(starts, first, wi)
        direction = dr.select(starts, frame.to_world(wi), direction)

        # ------------------------------------ Ray intersection --------------------------------------

        path = dr.select(starts, new_path(), path)
        path.origin = dr.select(starts, lifted, path.origin)
        alive = ~starts | ((wi.z > 0.0) & (dr.dot(direction, geometric_normal) > 0.0))
        hit = source.intersect(mi.Ray3f(path.origin, direction), alive)

        # ------------ Multiple importance sampling: density of all techniques together --------------

        pdf = cosine_count * dr.maximum(wi.z, 0.0) * dr.inv_pi
        for roughness_level in levels:
            pdf += level_count * brdf.visible_normal_pdf(wi, wo, roughness_level)
        if dr.hint(light_count > 0, mode="scalar"):
            emitter_pdf = lights.pdf_direction(
                hit.triangle, hit.distance, dr.dot(hit.geometric_normal, direction), hit.valid
            )
            # An emitter sample counts only if its ray hits the sampled emitter: other surfaces belong to
            # the BRDF techniques, other emitters to the samples of those.
            alive &= ~to_emitter | ((emitter_pdf > 0.0) & (hit.triangle == target.triangle))
            pdf += light_count * emitter_pdf
        density = dr.select(starts, pdf, density)
        alive &= density > 1e-20

        # --------------------------- Incident radiance L_i (Eq. 9 to 11) ----------------------------

        path, direction, continues = source.step(path, direction, hit, rng, alive)
        starts = ~continues

        # ------------------- Shading integrals L_d, L_s0 and L_s1 (Eq. 6) ---------------------------

        weighted = dr.select(starts, path.radiance / dr.maximum(density, 1e-20), 0.0)
        integrals[0] += weighted * (dr.maximum(wi.z, 0.0) * dr.inv_pi)
        for k in range(len(levels)):
            s0, s1 = brdf.specular_lobes(wi, wo, levels[k])
            integrals[1 + 2 * k] += weighted * s0
            integrals[2 + 2 * k] += weighted * s1
        i += dr.select(starts, mi.UInt32(1), mi.UInt32(0))
    return integrals
