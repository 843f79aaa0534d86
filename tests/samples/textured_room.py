"""Photographs of an empty room with patterned walls, in which a camera solve finds features."""

from __future__ import annotations

import numpy as np

SIZE = np.array([4.0, 3.0, 2.5])  # metres; the room's lowest corner is the origin, Z is up
TEXELS = 192  # of a wall's side
WIDTH, HEIGHT, FOCAL = 288, 216, 200.0  # pixels


def wall_textures(seed: int) -> np.ndarray:
    """Random patterns (6, TEXELS, TEXELS) of blobs of all sizes between 0.05 and 1."""
    generator = np.random.default_rng(seed)
    textures = np.zeros((6, TEXELS, TEXELS))
    for cells in (6, 12, 24, 48, 96):
        coarse = generator.uniform(size=(6, cells, cells))
        index = np.arange(TEXELS) * cells // TEXELS
        textures += coarse[:, index][:, :, index]
    textures = (textures - textures.min()) / np.ptp(textures)
    return 0.05 + 0.95 * textures


def photograph(pose: np.ndarray, textures: np.ndarray) -> np.ndarray:
    """Radiance (HEIGHT, WIDTH, 3) float32 that a pinhole camera in the room sees, by four rays a pixel.

    Args:
        pose: (4, 4) camera-to-world.
        textures: (6, rows, columns) of the walls at low and high X, Y, Z; rows rise with the second axis.
    """
    total = np.zeros((HEIGHT, WIDTH))
    for dx, dy in ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)):
        x, y = np.meshgrid(np.arange(WIDTH) + dx, np.arange(HEIGHT) + dy)
        camera = np.stack([(x - 0.5 * WIDTH) / FOCAL, (y - 0.5 * HEIGHT) / FOCAL, np.ones_like(x)], axis=-1)
        total += _wall_values(pose[:3, 3], camera @ pose[:3, :3].T, textures)
    return np.repeat((0.25 * total)[..., None], 3, axis=-1).astype(np.float32)


def project(point: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Position (2,) in pixels at which a camera sees a point."""
    camera = pose[:3, :3].T @ (point - pose[:3, 3])
    return FOCAL * camera[:2] / camera[2] + [0.5 * WIDTH, 0.5 * HEIGHT]


def _wall_values(origin: np.ndarray, directions: np.ndarray, textures: np.ndarray) -> np.ndarray:
    """The patterns where rays from a point inside leave the room."""
    with np.errstate(divide="ignore"):
        distances = np.where(directions > 0.0, SIZE - origin, -origin) / directions
    distances = np.where(directions == 0.0, np.inf, distances)
    axis = distances.argmin(axis=-1)
    nearest = np.take_along_axis(distances, axis[..., None], axis=-1)
    unit = (origin + directions * nearest) / SIZE
    ahead = np.take_along_axis(directions, axis[..., None], axis=-1)[..., 0] > 0.0
    first = np.where(axis == 0, unit[..., 1], unit[..., 0])
    second = np.where(axis == 2, unit[..., 1], unit[..., 2])
    rows, columns = textures.shape[1:]
    u = np.clip((first * columns).astype(int), 0, columns - 1)
    v = np.clip((second * rows).astype(int), 0, rows - 1)
    return np.asarray(textures[2 * axis + ahead, v, u])
