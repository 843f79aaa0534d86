# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from outside the room: an equirectangular image that rays look up where they leave the mesh.

Layout and axes are Blender's (`conventions.direction_to_equirect`); directions are sampled in proportion
to luminance.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .lights import LUMINANCE


class EnvironmentLight:
    """A constant-per-pixel environment map for sampling and look-up.

    Args:
        image: (H, W, 3) radiance, first row at the zenith.
    """

    def __init__(self, image: np.ndarray) -> None:
        self._height, self._width = image.shape[:2]
        self._image = mi.Float(np.ascontiguousarray(image, np.float32).reshape(-1))
        # Solid angle of a pixel: its width in azimuth times its height in z.
        edges = np.cos(np.linspace(0.0, np.pi, self._height + 1))
        solid_angle = (edges[:-1] - edges[1:]) * 2.0 * np.pi / self._width  # (H,) steradians
        weight = (image.astype(np.float64) @ LUMINANCE) * solid_angle[:, None]
        self.flux = float(weight.sum())  # integral of luminance over directions
        self._edges = mi.Float(edges.astype(np.float32))
        if self.flux > 0.0:
            pmf = (weight / self.flux).astype(np.float32)
            self._distribution = mi.DiscreteDistribution(mi.Float(pmf.reshape(-1)))
            density = pmf.astype(np.float64) / pmf.sum(dtype=np.float64) / solid_angle[:, None]
            self._pdf = mi.Float(density.astype(np.float32).reshape(-1))

    def _pixel(self, direction: Any) -> Any:
        u = 0.5 - dr.atan2(direction.y, direction.x) * (0.5 * dr.inv_pi)
        v = dr.acos(dr.clip(direction.z, -1.0, 1.0)) * dr.inv_pi
        column = dr.minimum(mi.UInt32(dr.clip(u, 0.0, 1.0) * self._width), self._width - 1)
        row = dr.minimum(mi.UInt32(v * self._height), self._height - 1)
        return row * self._width + column

    def radiance(self, direction: Any, active: Any = True) -> Any:
        """Color3f from unit directions (Vector3f) that point away from the room."""
        return dr.gather(mi.Color3f, self._image, self._pixel(direction), active)

    def pdf(self, direction: Any, active: Any = True) -> Any:
        """Float: density of `sample` per steradian."""
        if not self.flux > 0.0:
            return mi.Float(0.0)
        return dr.gather(mi.Float, self._pdf, self._pixel(direction), active)

    def sample(self, u1: Any, u2: Any, u3: Any) -> tuple[Any, Any, Any]:
        """(direction Vector3f, radiance Color3f, density per steradian Float); needs ``flux > 0``."""
        index = self._distribution.sample(u1)
        row = index // self._width
        column = index - row * self._width
        azimuth = (0.5 - (mi.Float(column) + u2) / self._width) * dr.two_pi
        upper = dr.gather(mi.Float, self._edges, row)
        lower = dr.gather(mi.Float, self._edges, row + 1)
        z = dr.lerp(upper, lower, u3)
        level = dr.safe_sqrt(1.0 - z * z)
        sine, cosine = dr.sincos(azimuth)
        direction = mi.Vector3f(level * cosine, level * sine, z)
        return (
            direction,
            dr.gather(mi.Color3f, self._image, index),
            dr.gather(mi.Float, self._pdf, index),
        )
