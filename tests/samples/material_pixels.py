"""Synthetic pixels of surfaces of known materials, with their shadings."""

import numpy as np

from fipt_blender.core.light.shadings import roughness_levels
from fipt_blender.core.material.pixel_samples import PixelSamples
from fipt_blender.core.run.settings import Settings

LEVELS = roughness_levels(8, 0.02, 1.5)
SETTINGS = Settings()
CELLS, VIEWS = 300, 8


def synthetic(
    rng: np.random.Generator, truths: list[tuple[float, float]], noise: float, outliers: float
) -> tuple[PixelSamples, np.ndarray]:
    """Pixels of one part for each (roughness, metallic) and their base colours (N, 3); views alternate.

    Highlights differ between views, and lower roughness makes them sharper, as in a room.
    """
    parts = len(truths)
    count = parts * CELLS * VIEWS
    part = np.repeat(np.arange(parts), CELLS * VIEWS)
    cell = np.repeat(np.arange(parts * CELLS), VIEWS)
    diffuse = np.repeat(rng.uniform(0.5, 2.0, (parts * CELLS, 1)), VIEWS, axis=0) * [1.0, 0.9, 0.8]
    angle = rng.exponential(0.35, count)[:, None]  # between the mirror direction and a lamp
    width = 0.03 + 0.9 * LEVELS**2
    s0 = 0.3 + 6.0 * np.exp(-((angle / width) ** 2)) * np.minimum(0.25 / width, 6.0)
    s1 = 0.03 * s0
    specular = np.stack([s0, s1], axis=2)[..., None] * [1.0, 0.95, 0.9]
    color = rng.uniform(0.1, 0.9, (parts * CELLS, 3))[cell]
    radiance = np.empty((count, 3))
    for index, (roughness, metallic) in enumerate(truths):
        rows = part == index
        level = np.abs(LEVELS - roughness).argmin()
        ks = 0.04 * (1 - metallic) + color[rows] * metallic
        radiance[rows] = color[rows] * (1 - metallic) * diffuse[rows] + ks * specular[rows, level, 0]
        radiance[rows] += specular[rows, level, 1]
    radiance *= 1.0 + noise * rng.normal(size=radiance.shape)
    wrong = rng.random(count) < outliers
    radiance[wrong] *= rng.uniform(0.0, 5.0, (wrong.sum(), 1))
    rows = np.arange(count)
    arrays = [np.asarray(array, np.float32) for array in (radiance, diffuse, specular)]
    return PixelSamples(rows, *arrays, LEVELS, cell, part, rows % VIEWS, np.ones(count, np.float32)), color
