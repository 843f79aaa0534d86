# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance cache leaves out beside emitters."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from fipt_blender.core.light.observations import Observations


def test_rim_pixels_of_an_emitter_stay_out_of_the_cache() -> None:
    """A bright rim around a lamp is the lamp's own light: the voxel beside it keeps the wall's radiance."""
    width, height, lamp = 6, 5, (2, 3)
    triangle = np.zeros(width * height, np.int32)
    triangle[lamp[0] * width + lamp[1]] = 1
    triangle[-1] = -1
    radiance = np.ones((width * height, 3), np.float32)
    rim = np.array([(lamp[0] + dy) * width + lamp[1] + dx for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    radiance[rim] = 100.0

    class Pixels:
        views = [SimpleNamespace(width=width, height=height)]

        def rows(self, view: int) -> slice:
            return slice(0, width * height)

    pixels = Pixels()
    pixels.triangle, pixels.radiance = triangle, radiance  # type: ignore[attr-defined]
    hit = np.flatnonzero(triangle >= 0)
    seen = Observations(pixels, None, None, hit, None, 0.01, None)  # type: ignore[arg-type]
    near = seen._near(0, np.array([False, True]))
    assert near.sum() == 9
    assert (radiance[hit[~near[hit]]] == 1.0).all()
