"""Predicted maps of a finished run, sampled as in the ground truth.

That is at the pixel's centre, or averaged over random positions in the pixel. Emitters are black in all maps
except emission.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from benchmarks.metrics import Maps
from benchmarks.tracer.environment import EnvironmentLight
from benchmarks.tracer.forward import LitRoom, camera_rays, switched_off
from benchmarks.tracer.surfaces import LatticeMaterials, SurfaceMaterials
from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.capture.views import View
from fipt_blender.core.light.added_lights import add_lamp, add_light
from fipt_blender.core.material.confidence import UNIFORM_DEVIATION
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.optics import brdf, factorised
from fipt_blender.core.optics.brdf import Material
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.result_contents import Emitters
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.surface.room import load_room

from .truth import Relight

# Bounds of the classes of confidence in which errors are counted.
CONFIDENCE_BOUNDS = (0.0, 0.4, 0.6, 0.8, 0.9, 1.0)

LATTICE_SPACING = 0.01  # metres; a pixel of the test captures sees more


def load_result(run: RunFolder, spacing: float = LATTICE_SPACING) -> tuple[LitRoom, EmitterTable]:
    """The room of a finished run with its estimated materials and lights, and the table of its emitters."""
    room = load_room(run)
    fields = RoomFields.load(run)
    materials = LatticeMaterials(room, fields.query, spacing)
    emitters = read_document(run.emitters_json, Emitters)
    table = EmitterTable.from_fixtures(emitters.fixtures)
    lights = AreaLights(room.vertices, room.triangles, table)
    environment = None
    if emitters.environment:
        environment = EnvironmentLight(read_radiance(run.results / emitters.environment.image))
    return LitRoom(room, materials, lights, environment), table


def with_inferred_lamps(lit: LitRoom, table: EmitterTable, run: RunFolder) -> LitRoom:
    """The same room with the lamps that were inferred, as cubes and squares that cast about their light."""
    emitters, count = table, len(lit.room.triangles)
    room = lit.room
    for lamp in read_document(run.emitters_json, Emitters).missing:
        if lamp.inferred:
            shape = np.array(lamp.position), lamp.radius, np.array(lamp.radiance)
            room, added = add_lamp(room, *shape, lamp.facing)
            emitters = emitters.joined(added)
    if room is lit.room:
        return lit
    lights = AreaLights(room.vertices, room.triangles, emitters)
    return LitRoom(room, _Padded(lit.materials, count), lights, lit.environment)


class _Padded:
    """Materials of a room, for the same room with additional triangles, which are black emitters."""

    def __init__(self, materials: SurfaceMaterials, count: int) -> None:
        self._materials, self._count = materials, count

    def lookup(self, position: mi.Point3f, triangle: mi.UInt32, active: mi.Bool = True) -> Material:
        active = mi.Bool(active) & (triangle < self._count)
        return self._materials.lookup(position, dr.select(active, triangle, 0), active)


def relit(lit: LitRoom, table: EmitterTable, relight: Relight) -> LitRoom:
    """The same room with its lights and environment switched off, and one new light."""
    room, added = add_light(lit.room, relight.vertices, relight.triangles, relight.radiance)
    lights = AreaLights(room.vertices, room.triangles, switched_off(table).joined(added))
    return LitRoom(room, _Padded(lit.materials, len(lit.room.triangles)), lights)


def predict_maps(lit: LitRoom, view: View, filtered: bool, spp: int = 128, seed: int = 0) -> Maps:
    """Maps of one view.

    Args:
        filtered: average over the pixel instead of sampling its centre.
        spp: BRDF samples per pixel for a' (128 in the paper), and positions if filtered.
    """
    count = view.width * view.height
    rows = max(1, (1 << 21) // (spp * view.width))
    sums = np.zeros((count, 14), np.float32)
    hits = np.zeros(count, np.float32)
    for start in range(0, count, rows * view.width):
        pixels = min(rows * view.width, count - start)
        index = dr.arange(mi.UInt32, pixels * spp)
        first = dr.opaque(mi.UInt32, start)  # a literal would make a new kernel for every chunk
        generator = mi.PCG32(
            size=pixels * spp,
            initstate=mi.UInt64(seed),
            initseq=mi.UInt64(first) * spp + mi.UInt64(index),
        )
        # Even, so that pixels at borders weigh their materials nearly exactly (Hammersley points, jittered).
        number = index % spp
        down = mi.radical_inverse_2(number, 0) + generator.next_float32() / spp
        shift = mi.Point2f((mi.Float(number) + generator.next_float32()) / spp, down - dr.floor(down))
        if not filtered:
            shift = mi.Point2f(0.5)
        ray = camera_rays(view, first + index // spp, shift)
        surface = lit.room.intersect(ray)
        cosine = -dr.dot(surface.geometric_normal, ray.d)
        emission = lit.lights.radiance(surface.triangle, cosine, surface.valid)
        reflects = surface.valid & ~lit.lights.is_emitter(surface.triangle, surface.valid)
        base_color, roughness, metallic = lit.materials.lookup(surface.position, surface.triangle, reflects)
        wo = mi.Frame3f(surface.normal).to_local(-ray.d)
        sample = mi.Point2f(generator.next_float32(), generator.next_float32())
        kd = factorised.diffuse_reflectance(base_color, metallic)
        # The diffuse part of a' is known; only the specular one needs samples.
        wi = brdf.sample_visible_normal(sample, wo, roughness)
        density = brdf.visible_normal_pdf(wi, wo, roughness)
        s0, s1 = brdf.specular_lobes(wi, wo, roughness)
        specular = factorised.specular_reflectance(base_color, metallic) * s0 + s1
        a_prime = kd + dr.select(density > 0.0, specular / density, 0.0)
        materials = [*kd, *a_prime, *base_color, roughness, metallic]
        columns = [*[dr.select(reflects, value, 0.0) for value in materials], *emission]
        columns.append(dr.select(surface.valid, 1.0, 0.0))
        dr.eval(columns)
        means = np.stack([np.array(dr.block_sum(column, spp)) for column in columns], axis=-1) / spp
        part = slice(start, start + pixels)
        sums[part], hits[part] = means[:, :-1], means[:, -1]
    maps = sums.reshape(view.height, view.width, -1)
    return Maps(
        kd=maps[..., 0:3],
        a_prime=maps[..., 3:6],
        base_color=maps[..., 6:9],
        roughness=maps[..., 9],
        metallic=maps[..., 10],
        emission=maps[..., 11:14],
        hit=(hits > 0.0).reshape(view.height, view.width),
    )


def confidence_table(run: RunFolder, views: Sequence[View], true: Sequence[Maps]) -> list[dict[str, float]]:
    """Expected and actual RMS errors of base colour of the pixels in each class of confidence.

    Args:
        true: maps of the views; emitters and pixels without base colour do not count.

    Returns:
        For each class that has pixels: upper bound ``to``, ``share`` of the pixels, ``expected``, ``made``.
    """
    fields, room = RoomFields.load(run), load_room(run)
    confidence, errors = [np.zeros(0)], [np.zeros(0)]
    for view, maps in zip(views, true, strict=True):
        surface = trace_pixels(room, view)
        counted = np.array(surface.valid) & maps.hit.ravel() & (maps.base_color.max(axis=2).ravel() > 0.0)
        counted &= maps.emission.max(axis=2).ravel() <= 0.0
        position = np.array(surface.position).T[counted].astype(np.float32)
        triangle = np.array(surface.triangle)[counted]
        error = fields.query(position, triangle)[0] - maps.base_color.reshape(-1, 3)[counted]
        confidence.append(fields.confidence(position, triangle)[:, 0])
        errors.append((error**2).mean(axis=1))
    certainty, squared = np.concatenate(confidence), np.concatenate(errors)
    place = np.clip(np.searchsorted(CONFIDENCE_BOUNDS, certainty), 1, len(CONFIDENCE_BOUNDS) - 1)
    table = []
    for index, bound in enumerate(CONFIDENCE_BOUNDS[1:], start=1):
        in_class = place == index
        if in_class.any():
            expected = UNIFORM_DEVIATION * float(np.sqrt(((1.0 - certainty[in_class]) ** 2).mean()))
            made = float(np.sqrt(squared[in_class].mean()))
            table.append({"to": bound, "share": float(in_class.mean()), "expected": expected, "made": made})
    return table
