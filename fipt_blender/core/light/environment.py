# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from outside: an environment map made of the pixels that see past the mesh (paper Sec. 5.4,
"Complex emitters": each pixel of the map is estimated like the emission of a triangle).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..conventions import direction_to_equirect
from ..scene.pixels import NO_TRIANGLE, PixelStore

# Less of the sphere than this is no window but a hole in the mesh; spread over all directions, what it shows
# would light the room through every other hole.
LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class Environment:
    """Radiance from outside by direction.

    Attributes:
        image: (H, 2H, 3) float32 equirectangular map in Blender's layout, world axes.
        observed_share: 0..1, solid-angle share of the map that some pixel saw.
    """

    image: np.ndarray
    observed_share: float


def outside_pixels(pixels: PixelStore) -> tuple[np.ndarray, np.ndarray]:
    """World directions (M, 3) and radiance (M, 3) of the pixels that miss the mesh."""
    directions, radiance = [np.zeros((0, 3))], [np.zeros((0, 3), np.float32)]
    for index, view in enumerate(pixels.views):
        rows = pixels.rows(index)
        # The colour of a window's frame, in the pixels at its edge, is no light from outside; nor are cracks
        # of the mesh, which no pixel sees alone.
        missed = np.flatnonzero((pixels.triangle[rows] == NO_TRIANGLE) & pixels.pure[rows])
        if len(missed):
            directions.append(view.rays()[1][missed])
            radiance.append(pixels.radiance[missed + rows.start])
    return np.concatenate(directions), np.concatenate(radiance)


def estimate_environment(directions: np.ndarray, radiance: np.ndarray, width: int) -> Environment | None:
    """Median of the pixels that look into each cell of the map; None where next to nothing looks outside.

    Cells that no pixel saw take the radiance of the nearest observed ones (diffused outwards), so that a
    window seen from a few places still lights the room from all angles that pass it.

    Args:
        directions: (N, 3) unit world directions of pixels that miss the mesh.
        radiance: (N, 3) their radiance.
        width: of the map in pixels; the height is half of it.
    """
    if not len(directions):
        return None
    height = width // 2
    uv = direction_to_equirect(directions)
    column = np.clip((uv[:, 0] * width).astype(np.int64), 0, width - 1)
    # v counts up from the lower edge, rows count down from the upper one
    row = np.clip(((1.0 - uv[:, 1]) * height).astype(np.int64), 0, height - 1)
    cell = row * width + column
    order = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[order], prepend=-1))
    image = np.zeros((height * width, 3), np.float32)
    known = np.zeros(height * width, bool)
    for part in np.split(order, starts[1:]):
        image[cell[part[0]]] = np.median(radiance[part], axis=0)
        known[cell[part[0]]] = True
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    weight = np.repeat(np.cos(latitude), width)
    share = float(weight[known].sum() / weight.sum())
    if share < LEAST_SHARE:
        return None
    return Environment(_diffuse(image.reshape(height, width, 3), known.reshape(height, width)), share)


def _diffuse(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill unknown cells by the mean of known neighbours, ring by ring; columns wrap around."""
    image, known = image.copy(), known.copy()
    while not known.all():
        sums = np.zeros_like(image)
        count = np.zeros(known.shape, np.float32)
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            mask = np.roll(known, step, axis=axis)
            values = np.roll(image, step, axis=axis)
            if axis == 0:  # the poles do not wrap
                mask[0 if step == 1 else -1] = False
            sums += values * mask[..., None]
            count += mask
        reach = ~known & (count > 0)
        image[reach] = sums[reach] / count[reach][:, None]
        known |= reach
    return image
