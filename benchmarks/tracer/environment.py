"""Environment light: an equirectangular image of the radiance from outside the mesh.

Layout and axes are Blender's (`conventions.direction_to_equirect`); directions are sampled in proportion to
luminance.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from fipt_blender.core.optics.lights import LUMINANCE, DirectSample


class EnvironmentLight:
    """An environment map, constant per pixel, for sampling and look-up.

    Args:
        image: (H, W, 3) radiance, first row at the zenith.

    Attributes:
        flux: integral of luminance over all directions.
    """

    def __init__(self, image: np.ndarray) -> None:
        self._height, self._width = image.shape[:2]
        self._image = mi.Float(np.ascontiguousarray(image, np.float32).reshape(-1))
        # Solid angle of a pixel: its width in azimuth times its height in z.
        edges = np.cos(np.linspace(0.0, np.pi, self._height + 1))
        solid_angle = (edges[:-1] - edges[1:]) * 2.0 * np.pi / self._width  # (H,) steradians
        weight = (image.astype(np.float64) @ LUMINANCE) * solid_angle[:, None]
        self.flux = float(weight.sum())
        self._edges = mi.Float(edges.astype(np.float32))
        if self.flux > 0.0:
            pmf = (weight / self.flux).astype(np.float32)
            self._distribution = mi.DiscreteDistribution(mi.Float(pmf.reshape(-1)))
            density = pmf.astype(np.float64) / pmf.sum(dtype=np.float64) / solid_angle[:, None]
            self._pdf = mi.Float(density.astype(np.float32).reshape(-1))

    def pixel(self, direction: mi.Vector3f) -> mi.UInt32:
        """Row-major pixel of unit directions."""
        u = 0.5 - dr.atan2(direction.y, direction.x) * (0.5 * dr.inv_pi)
        v = dr.acos(dr.clip(direction.z, -1.0, 1.0)) * dr.inv_pi
        column = dr.minimum(mi.UInt32(dr.clip(u, 0.0, 1.0) * self._width), self._width - 1)
        row = dr.minimum(mi.UInt32(v * self._height), self._height - 1)
        return row * self._width + column

    def radiance(self, direction: mi.Vector3f, active: mi.Bool = True) -> mi.Color3f:
        """Radiance that arrives from unit directions, which point away from the room."""
        return dr.gather(mi.Color3f, self._image, self.pixel(direction), active)

    def pdf(self, direction: mi.Vector3f, active: mi.Bool = True) -> mi.Float:
        """Density of :meth:`sample` per steradian."""
        if not self.flux > 0.0:
            return mi.Float(0.0)
        return dr.gather(mi.Float, self._pdf, self.pixel(direction), active)

    def sample(self, u1: mi.Float, u2: mi.Float, u3: mi.Float) -> DirectSample:
        """Choose a direction by three uniform numbers; needs ``flux > 0``."""
        index = self._distribution.sample(u1)
        row = index // self._width
        column = index - row * self._width
        azimuth = (0.5 - (mi.Float(column) + u2) / self._width) * dr.two_pi
        upper = dr.gather(mi.Float, self._edges, row)
        lower = dr.gather(mi.Float, self._edges, row + 1)
        z = dr.lerp(upper, lower, u3)
        sin_theta = dr.safe_sqrt(1.0 - z * z)
        sin_phi, cos_phi = dr.sincos(azimuth)
        return DirectSample(
            direction=mi.Vector3f(sin_theta * cos_phi, sin_theta * sin_phi, z),
            distance=mi.Float(dr.inf),
            radiance=dr.gather(mi.Color3f, self._image, index),
            pdf=dr.gather(mi.Float, self._pdf, index),
        )
