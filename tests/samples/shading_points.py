"""For tests of shadings: lookups by triangle, random surface points, independent estimates."""

import mitsuba as mi
import numpy as np

from fipt_blender.core.light.cache import SurfaceLookup, VoxelGrid, fill_grid, grid_frame, pool
from fipt_blender.core.light.shadings import SampleCounts, ShadingPoints, bake
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.surface.room import Room
from samples.small_rooms import surface_points

LEVELS = np.array([0.1, 0.4, 1.0], np.float32)
LAMP = [[-0.5, -0.5, 2.6], [-0.5, 0.5, 2.6], [0.5, 0.5, 2.6], [0.5, -0.5, 2.6]]
NOTHING = EmitterTable.empty()


def make_grid(
    room: Room, positions: np.ndarray, normals: np.ndarray, resolution: int, rng: np.random.Generator
) -> VoxelGrid:
    """Grid over the room's bounds with a row for each voxel that contains surface.

    Args:
        positions: (N, 3) seen surface points, metres.
        normals: (N, 3) their geometric normals on the seen side.
    """
    frame = grid_frame(room, resolution)
    return fill_grid(room, frame, frame.flat_index(positions, normals), rng)


def grid_of(room: Room, resolution: int = 48) -> VoxelGrid:
    nothing = np.zeros((0, 3))
    return make_grid(room, nothing, nothing, resolution, np.random.default_rng(0))


def lookup_by_triangle(room: Room, grid: VoxelGrid, values: np.ndarray) -> SurfaceLookup:
    """One row of values for each triangle, both sides."""
    points, normals, ids = surface_points(room, 4000, np.random.default_rng(1))
    entries = np.concatenate([grid.entries(points, normals), grid.entries(points, -normals)])
    return SurfaceLookup(grid, pool(grid, entries, np.concatenate([values[ids]] * 2))[0])


def points_on(room: Room, count: int, triangles: list[int]) -> ShadingPoints:
    """Points on the fronts of triangles, viewed from random directions within 75 degrees of the normal."""
    rng = np.random.default_rng(3)
    position, normal, _ = surface_points(room, count, rng, np.array(triangles))
    frames = np.array([np.linalg.svd(n[None])[2] for n in normal])
    cosine, turn = rng.uniform(0.26, 1.0, len(normal)), rng.uniform(0, 2 * np.pi, len(normal))
    sine = np.sqrt(1 - cosine**2)
    view = normal * cosine[:, None] + frames[:, 1] * (sine * np.cos(turn))[:, None]
    view += frames[:, 2] * (sine * np.sin(turn))[:, None]
    return ShadingPoints(*[np.asarray(a, np.float32) for a in (position, normal, normal, view)])


def repeat(points: ShadingPoints, times: int) -> ShadingPoints:
    return ShadingPoints(*[np.repeat(getattr(points, name), times, axis=0) for name in points.__annotations__])


def baked(points: ShadingPoints, source, lights, levels: np.ndarray, counts: SampleCounts, times: int):
    """Independent estimates: diffuse (points, times, 3) and specular (points, times, K, 2, 3)."""
    found = bake(repeat(points, times), source, lights, levels, counts, seed=7)
    shape = (len(points.position), times)
    return found.diffuse.reshape(*shape, 3), found.specular.reshape(*shape, len(levels), 2, 3)


def mean_and_error(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard error over axis 1."""
    return values.mean(axis=1), values.std(axis=1, ddof=1) / np.sqrt(values.shape[1])


def lanes(points: ShadingPoints, times: int):
    many = repeat(points, times)
    position, normal = (np.asarray(a).T.copy() for a in (many.position, many.normal))
    frame = mi.Frame3f(mi.Normal3f(normal))
    return mi.Point3f(position), frame, frame.to_local(mi.Vector3f(many.view_direction.T.copy()))
