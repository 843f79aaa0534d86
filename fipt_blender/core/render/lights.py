# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive triangles as light sources: sampled in proportion to power, evaluated by triangle and side.

Shared by the refinement of shadings (stage 3) and by forward rendering. An emitter's front is the side
its geometric normal points to; each side has its own radiance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709


@dataclass(frozen=True)
class EmitterTable:
    """Which triangles of a room emit, and what.

    Attributes:
        triangles: (E,) int32, indices into the room's triangles, each at most once.
        radiance: (E, 3) radiance leaving the front side, scene-linear.
        back_radiance: (E, 3) radiance leaving the back side.
        base_color: (E, 3) of rough dielectrics that reflect as well; None where all are black.
        beside: (E,) bool, emitters whose surface also reflects as the room's materials say there; None where
            all stand for them.
    """

    triangles: np.ndarray
    radiance: np.ndarray
    back_radiance: np.ndarray
    base_color: np.ndarray | None = None
    beside: np.ndarray | None = None

    def all_beside(self) -> np.ndarray:
        """(E,) bool, `beside` of each."""
        return np.zeros(len(self.triangles), bool) if self.beside is None else self.beside

    def base_colors(self) -> np.ndarray:
        """(E, 3) float32; black emitters reflect nothing at all."""
        if self.base_color is None:
            return np.zeros((len(self.triangles), 3), np.float32)
        return self.base_color.astype(np.float32)

    @classmethod
    def empty(cls) -> EmitterTable:
        """A table without emitters."""
        return cls(np.zeros(0, np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))

    @classmethod
    def from_fixtures(cls, data: Mapping[str, Any]) -> EmitterTable:
        """The table behind ``results/emitters.json``: every triangle of a fixture has its radiance."""
        triangles: list[int] = []
        front: list[list[float]] = []
        back: list[list[float]] = []
        color: list[list[float]] = []
        beside: list[bool] = []
        for fixture in data["fixtures"]:
            count = len(fixture["triangles"])
            triangles += fixture["triangles"]
            front += [fixture["radiance"]] * count
            back += [fixture["back_radiance"]] * count
            color += [fixture.get("base_color", [0.0, 0.0, 0.0])] * count
            beside += [fixture.get("beside", False)] * count
        return cls(
            np.array(triangles, np.int32),
            np.array(front, np.float32).reshape(-1, 3),
            np.array(back, np.float32).reshape(-1, 3),
            np.array(color, np.float32).reshape(-1, 3),
            np.array(beside, bool),
        )


@dataclass
class LightSample:
    """A point on an emitter.

    Attributes:
        position: Point3f, metres.
        normal: Normal3f, geometric unit normal; the front side.
        triangle: UInt32, room triangle index.
        pdf_area: Float, density per square metre of emitter surface.
    """

    position: Any
    normal: Any
    triangle: Any
    pdf_area: Any


@dataclass
class DirectSample:
    """A light sample as seen from a shading point.

    Attributes:
        direction: Vector3f, unit, from the shading point to the light.
        distance: Float, metres; infinite for the environment.
        radiance: Color3f towards the shading point, before any test of visibility.
        pdf: Float, density per steradian at the shading point; 0 where the sample is of no use.
    """

    direction: Any
    distance: Any
    radiance: Any
    pdf: Any


class AreaLights:
    """Emissive triangles for sampling and look-up; arrays of the active Mitsuba variant.

    A triangle is chosen in proportion to area times summed luminance of both sides (its power up to a
    factor pi), the point on it uniformly by area.

    Args:
        vertices: (V, 3) room vertices, metres.
        triangles: (T, 3) vertex indices.
        table: the emitters; entries without area or radiance are kept for look-up, never sampled.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, table: EmitterTable) -> None:
        ids = np.asarray(table.triangles, np.int64)
        corners = np.asarray(vertices, np.float64)[np.asarray(triangles)[ids]].reshape(-1, 3, 3)
        edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        cross = np.cross(edge_1, edge_2)
        length = np.linalg.norm(cross, axis=1)
        self.area = 0.5 * length  # (E,) float64, square metres
        self.power = np.pi * self.area[:, None] * (table.radiance + table.back_radiance)  # (E, 3) watts
        weight = self.power @ LUMINANCE
        self.count = int(np.count_nonzero(weight > 0))  # emitters that can be sampled
        slot = np.full(len(triangles), -1, np.int32)
        slot[ids] = np.arange(len(ids), dtype=np.int32)
        self._slot = mi.Int32(slot)
        self._front: Any = None
        colors = table.base_colors()
        self._reflecting = bool(colors.any())
        self.beside = bool(table.all_beside().any())
        if not len(ids):
            return
        self._color = _columns(mi.Color3f, colors)
        self._beside = mi.Bool(table.all_beside())
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

    def sample(self, u1: Any, u2: Any, u3: Any) -> LightSample:
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

    def _slots(self, triangle: Any, active: Any) -> tuple[Any, Any]:
        slot = dr.gather(mi.Int32, self._slot, mi.UInt32(triangle), active)
        found = active & (slot >= 0)
        return mi.UInt32(dr.maximum(slot, 0)), found

    def is_emitter(self, triangle: Any, active: Any = True) -> Any:
        """Bool: does the room triangle belong to an emitter that stands for what reflects there?"""
        slot, found = self._slots(triangle, mi.Bool(active))
        return found & ~dr.gather(mi.Bool, self._beside, slot, found) if self.beside else found

    def shines_beside(self, triangle: Any, active: Any = True) -> Any:
        """Bool: does the room triangle emit beside what the room's material reflects there?"""
        if not self.beside:
            return mi.Bool(False)
        slot, found = self._slots(triangle, mi.Bool(active))
        return found & dr.gather(mi.Bool, self._beside, slot, found)

    def base_color(self, triangle: Any, active: Any = True) -> Any:
        """Color3f: base colour of the emitter that the room triangle belongs to; black without one."""
        if not self._reflecting:
            return mi.Color3f(0.0)
        slot, found = self._slots(triangle, mi.Bool(active))
        return dr.gather(mi.Color3f, self._color, slot, found)

    def pdf_area(self, triangle: Any, active: Any = True) -> Any:
        """Float: density per square metre with which `sample` chooses points of the triangle; else 0."""
        if not self.count:
            return mi.Float(0.0)
        slot, found = self._slots(triangle, mi.Bool(active))
        return dr.gather(mi.Float, self._pdf, slot, found)

    def radiance(self, triangle: Any, cosine: Any, active: Any = True) -> Any:
        """Color3f: emitted radiance of the triangle's front where `cosine` > 0, else of its back.

        Args:
            triangle: UInt32, room triangle index.
            cosine: Float, geometric normal times the direction in which light leaves.
            active: Bool; zero radiance where false.
        """
        if self._front is None:
            return mi.Color3f(0.0)
        slot, found = self._slots(triangle, mi.Bool(active))
        front = dr.gather(mi.Color3f, self._front, slot, found & (cosine > 0))
        back = dr.gather(mi.Color3f, self._back, slot, found & (cosine <= 0))
        return front + back

    def sample_direction(self, point: Any, u1: Any, u2: Any, u3: Any) -> DirectSample:
        """Choose a light as seen from `point` (Point3f); the pdf is per steradian there."""
        sample = self.sample(u1, u2, u3)
        offset = sample.position - point
        distance = dr.norm(offset)
        direction = offset / distance
        cosine = -dr.dot(sample.normal, direction)
        pdf = solid_angle_pdf(sample.pdf_area, distance, cosine)
        usable = (distance > 0) & dr.isfinite(pdf)
        radiance = self.radiance(sample.triangle, cosine, usable)
        return DirectSample(direction, distance, radiance, dr.select(usable, pdf, 0.0))

    def pdf_direction(self, triangle: Any, distance: Any, cosine: Any, active: Any = True) -> Any:
        """Float: density per steradian with which `sample_direction` would have chosen a hit point.

        Args:
            triangle: UInt32, the triangle hit.
            distance: Float, metres from the shading point.
            cosine: Float, of the angle between the ray and the triangle's normal; any sign.
            active: Bool; 0 where false.
        """
        return solid_angle_pdf(self.pdf_area(triangle, active), distance, cosine)


def solid_angle_pdf(pdf_area: Any, distance: Any, cosine: Any) -> Any:
    """Density per steradian of a point with density `pdf_area` per square metre; 0 at grazing angles."""
    facing = dr.abs(cosine)
    return dr.select(facing > 1e-6, pdf_area * distance * distance / facing, 0.0)


def power_heuristic(pdf: Any, other: Any) -> Any:
    """Veach's weight (exponent 2) of a sample drawn with density `pdf` where `other` competes."""
    ratio = other / pdf  # of densities, so that their squares can't overflow
    return dr.select(pdf > 0, 1.0 / (1.0 + ratio * ratio), 0.0)


def _columns(kind: Any, array: np.ndarray) -> Any:
    return kind(*[mi.Float(np.ascontiguousarray(column, np.float32)) for column in np.asarray(array).T])
