"""Area lights: emissive triangles, sampled in proportion to power and evaluated by triangle and side.

Shared by the refinement of shadings (stage 3) and by forward rendering. The front of an emitter is the side
to which its geometric normal points; each side has its own radiance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709


@dataclass(frozen=True)
class EmitterTable:
    """The emissive triangles of a room and their radiance.

    Attributes:
        triangles: (E,) int32, indices into the room's triangles, each at most once.
        radiance: (E, 3) radiance leaving the front side, scene-linear.
        back_radiance: (E, 3) radiance leaving the back side.
        reflective: (E,) bool, emitters whose surface also reflects with the room's material; the others
            replace the material. None if all replace it.
    """

    triangles: np.ndarray
    radiance: np.ndarray
    back_radiance: np.ndarray
    reflective: np.ndarray | None = None

    def reflective_mask(self) -> np.ndarray:
        """(E,) bool, `reflective` of each emitter."""
        return np.zeros(len(self.triangles), bool) if self.reflective is None else self.reflective

    def not_reflective(self) -> EmitterTable:
        """The emitters that replace the material."""
        kept = ~self.reflective_mask()
        return EmitterTable(self.triangles[kept], self.radiance[kept], self.back_radiance[kept])

    def joined(self, other: EmitterTable) -> EmitterTable:
        """The emitters of both tables."""
        pairs = (
            (self.triangles, other.triangles),
            (self.radiance, other.radiance),
            (self.back_radiance, other.back_radiance),
            (self.reflective_mask(), other.reflective_mask()),
        )
        return EmitterTable(*(np.concatenate(pair) for pair in pairs))

    @classmethod
    def empty(cls) -> EmitterTable:
        """A table without emitters."""
        return cls(np.zeros(0, np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))

    @classmethod
    def from_fixtures(cls, fixtures: Sequence[Any]) -> EmitterTable:
        """The table of fixtures, also of emitters.json: each triangle has its fixture's radiance."""
        counts = [len(fixture.triangles) for fixture in fixtures]
        front, back = (
            np.array([getattr(fixture, side) for fixture in fixtures], np.float32).reshape(-1, 3)
            for side in ("radiance", "back_radiance")
        )
        triangles = [np.zeros(0, np.int32), *(np.asarray(each.triangles, np.int32) for each in fixtures)]
        return cls(np.concatenate(triangles), np.repeat(front, counts, 0), np.repeat(back, counts, 0))


@dataclass
class LightSample:
    """A point on an emitter.

    Attributes:
        position: metres.
        normal: geometric unit normal; the front side.
        triangle: room triangle index.
        pdf_area: density per square metre of emitter surface.
    """

    position: mi.Point3f
    normal: mi.Normal3f
    triangle: mi.UInt32
    pdf_area: mi.Float


@dataclass
class DirectSample:
    """A light sample as seen from a shading point.

    Attributes:
        direction: unit, from the shading point to the light.
        distance: metres; infinite for the environment.
        radiance: towards the shading point, visibility not tested.
        pdf: density per steradian at the shading point; 0 for unusable samples.
    """

    direction: mi.Vector3f
    distance: mi.Float
    radiance: mi.Color3f
    pdf: mi.Float


class AreaLights:
    """Emissive triangles for sampling and look-up; arrays of the active Mitsuba variant.

    Look-ups return one value for each triangle that is asked for, also where there are no emitters.

    A triangle is chosen in proportion to its area times the summed luminance of both sides (its power up to a
    factor of pi), the point on it uniformly by area.

    Args:
        vertices: (V, 3) room vertices, metres.
        triangles: (T, 3) vertex indices.
        table: the emitters; entries without area or radiance can be looked up but are never sampled.

    Attributes:
        area: (E,) float64, square metres.
        power: (E, 3) watts.
        count: number of emitters that can be sampled.
        reflective: whether any emitter also reflects with the room's material, see :class:`EmitterTable`.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, table: EmitterTable) -> None:
        ids = np.asarray(table.triangles, np.int64)
        corners = np.asarray(vertices, np.float64)[np.asarray(triangles)[ids]].reshape(-1, 3, 3)
        edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        cross = np.cross(edge_1, edge_2)
        length = np.linalg.norm(cross, axis=1)
        self.area = 0.5 * length
        self.power = np.pi * self.area[:, None] * (table.radiance + table.back_radiance)
        weight = self.power @ LUMINANCE
        self.count = int(np.count_nonzero(weight > 0))
        slot = np.full(len(triangles), -1, np.int32)
        slot[ids] = np.arange(len(ids), dtype=np.int32)
        self._slot = mi.Int32(slot)
        self._front: mi.Float | None = None
        self.reflective = bool(table.reflective_mask().any())
        if not len(ids):
            return
        self._reflective = mi.Bool(table.reflective_mask())
        normal = cross / np.maximum(length, 1e-30)[:, None]
        self._origin = _columns(mi.Point3f, corners[:, 0])
        self._edge_1 = _columns(mi.Vector3f, edge_1)
        self._edge_2 = _columns(mi.Vector3f, edge_2)
        self._normal = _columns(mi.Normal3f, normal)
        self._front = _columns(mi.Color3f, table.radiance)
        self._back = _columns(mi.Color3f, table.back_radiance)
        self._triangle = mi.UInt32(ids.astype(np.uint32))
        if not self.count:
            return
        self._distribution = mi.DiscreteDistribution(mi.Float((weight / weight.sum()).astype(np.float32)))
        pmf = np.array(self._distribution.pmf, np.float64)
        self._pdf = mi.Float((pmf / pmf.sum() / np.maximum(self.area, 1e-30)).astype(np.float32))

    def sample(self, u1: mi.Float, u2: mi.Float, u3: mi.Float) -> LightSample:
        """Choose a point on an emitter from three uniform numbers; needs ``count > 0``."""
        index = self._distribution.sample(u1)
        root = dr.sqrt(1.0 - u2)
        first, second = 1.0 - root, u3 * root
        position = (
            dr.gather(mi.Point3f, self._origin, index)
            + dr.gather(mi.Vector3f, self._edge_1, index) * first
            + dr.gather(mi.Vector3f, self._edge_2, index) * second
        )
        return LightSample(
            position,
            dr.gather(mi.Normal3f, self._normal, index),
            dr.gather(mi.UInt32, self._triangle, index),
            dr.gather(mi.Float, self._pdf, index),
        )

    def _slots(self, triangle: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """Row of each room triangle in the table, and whether it has one."""
        slot = dr.gather(mi.Int32, self._slot, mi.UInt32(triangle), active)
        found = active & (slot >= 0)
        return mi.UInt32(dr.maximum(slot, 0)), found

    def is_emitter(self, triangle: mi.UInt32, active: mi.Bool = True) -> mi.Bool:
        """Whether the room triangle is an emitter that replaces the room's material."""
        slot, found = self._slots(triangle, mi.Bool(active))
        return found & ~dr.gather(mi.Bool, self._reflective, slot, found) if self.reflective else found

    def pdf_area(self, triangle: mi.UInt32, active: mi.Bool = True) -> mi.Float:
        """Density per square metre with which `sample` chooses points of the triangle; 0 without emitter."""
        if not self.count:
            return dr.zeros(mi.Float, dr.width(triangle))
        slot, found = self._slots(triangle, mi.Bool(active))
        return dr.gather(mi.Float, self._pdf, slot, found)

    def radiance(self, triangle: mi.UInt32, cosine: mi.Float, active: mi.Bool = True) -> mi.Color3f:
        """Emitted radiance of the triangle's front where `cosine` > 0, else of its back.

        Args:
            triangle: room triangle index.
            cosine: between the geometric normal and the direction in which light leaves.
            active: zero radiance where false.
        """
        if self._front is None:
            return dr.zeros(mi.Color3f, dr.width(triangle))
        slot, found = self._slots(triangle, mi.Bool(active))
        front = dr.gather(mi.Color3f, self._front, slot, found & (cosine > 0))
        back = dr.gather(mi.Color3f, self._back, slot, found & (cosine <= 0))
        return front + back

    def sample_direction(self, point: mi.Point3f, u1: mi.Float, u2: mi.Float, u3: mi.Float) -> DirectSample:
        """Choose a point on an emitter as seen from `point`; the pdf is per steradian there."""
        sample = self.sample(u1, u2, u3)
        offset = sample.position - point
        distance = dr.norm(offset)
        direction = offset / distance
        cosine = -dr.dot(sample.normal, direction)
        pdf = solid_angle_pdf(sample.pdf_area, distance, cosine)
        usable = (distance > 0) & dr.isfinite(pdf)
        radiance = self.radiance(sample.triangle, cosine, usable)
        return DirectSample(direction, distance, radiance, dr.select(usable, pdf, 0.0))

    def pdf_direction(
        self, triangle: mi.UInt32, distance: mi.Float, cosine: mi.Float, active: mi.Bool = True
    ) -> mi.Float:
        """Density per steradian with which `sample_direction` chooses a point that a ray hit.

        Args:
            triangle: the triangle hit.
            distance: metres from the shading point.
            cosine: of the angle between the ray and the triangle's normal; any sign.
            active: 0 where false.
        """
        return solid_angle_pdf(self.pdf_area(triangle, active), distance, cosine)


def solid_angle_pdf(pdf_area: mi.Float, distance: mi.Float, cosine: mi.Float) -> mi.Float:
    """Density per steradian of a point with density `pdf_area` per square metre; 0 at grazing angles."""
    facing = dr.abs(cosine)
    return dr.select(facing > 1e-6, pdf_area * distance * distance / facing, 0.0)


def _columns(kind: type, array: np.ndarray) -> mi.Vector3f:
    return kind(*[mi.Float(np.ascontiguousarray(column, np.float32)) for column in np.asarray(array).T])
