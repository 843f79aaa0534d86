"""Rooms as a scanner leaves them: one welded mesh of small triangles, with noise."""

import numpy as np

from fipt_blender.core.surface.adjacency import weld
from fipt_blender.core.surface.room import Room
from samples.small_rooms import BOX, mesh_room


def grid_triangles(rows: int, columns: int) -> np.ndarray:
    """(2 R C, 3) triangles of a grid of cells, whose vertices are numbered row by row.

    They wind from the direction in which rows grow to that in which columns grow.
    """
    number = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    return quads.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def scanned_box(cells: int = 30, noise: float = 0.005, seed: int = 0) -> tuple[Room, np.ndarray]:
    """The box of small_rooms in one piece, each side a grid of cells, and (T,) the side of each triangle.

    Args:
        cells: along each edge; a side has twice their square as triangles.
        noise: standard deviation of the vertices' positions, metres.
    """
    u, v = np.meshgrid(*2 * [np.linspace(0.0, 1.0, cells + 1)], indexing="ij")
    sides = []
    for corners in np.array(BOX, float):
        across, up = corners[1] - corners[0], corners[3] - corners[0]
        sides.append(corners[0] + u.ravel()[:, None] * across + v.ravel()[:, None] * up)
    points = np.concatenate(sides)
    triangles = grid_triangles(cells, cells)
    every = np.concatenate([triangles + side * len(u.ravel()) for side in range(6)])
    welded = weld(points.astype(np.float32))
    vertices = np.zeros((int(welded.max()) + 1, 3))
    vertices[welded] = points
    vertices += np.random.default_rng(seed).normal(0.0, noise, vertices.shape)
    room = mesh_room(vertices, welded[every], np.zeros(len(every)), parts="masks")
    return room, np.repeat(np.arange(6), len(triangles))


def joined(room: Room, vertices: np.ndarray, triangles: np.ndarray, thing: int) -> Room:
    """A room of object 0 with one more mesh, which has a number as object."""
    return mesh_room(
        np.concatenate([room.vertices, vertices]),
        np.concatenate([room.triangles, triangles + len(room.vertices)]),
        np.repeat([0, thing], [len(room.triangles), len(triangles)]),
        parts="masks",
    )
