"""The surface of a distance field as one welded mesh: marching cubes (Lorensen and Cline 1987) over blocks.

The triangles of each of the 256 sign patterns of a cell are derived, not tabulated: on each face of the cell,
crossings are joined around runs of corners behind the surface. As neighbours join those of their common face
in the same way, the surface has no gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from .volume import SIDE, BlockVolume, pack, unpack

_CHUNK = 1024  # blocks at a time; bounds the memory
_CORNERS = np.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in range(8)])


@dataclass(frozen=True, eq=False)
class FusedMesh:
    """A mesh."""

    vertices: np.ndarray  # (V, 3) float32 metres
    triangles: np.ndarray  # (T, 3) int32, counter-clockwise seen from the measured side
    colors: np.ndarray | None = None  # (V, 3) float32, or None


def extract(volume: BlockVolume, least_weight: float = 1.0) -> FusedMesh:
    """The zero surface of a volume. Neighbouring cells share the vertices on their common edges exactly.

    Args:
        least_weight: voxels with less weight are unknown; cells with such corners stay empty.
    """
    keys: list[np.ndarray] = []
    places: list[np.ndarray] = []
    tints: list[np.ndarray] = []
    for start in range(0, len(volume.keys), _CHUNK):
        found = _block_triangles(
            volume, np.arange(start, min(start + _CHUNK, len(volume.keys))), least_weight
        )
        keys.append(found[0])
        places.append(found[1])
        tints.append(found[2])
    key = np.concatenate(keys) if keys else np.zeros(0, np.int64)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    place = np.concatenate(places)[first] if keys else np.zeros((0, 3), np.float32)
    colors = np.concatenate(tints)[first] if volume.color is not None and keys else None
    return FusedMesh(place, inverse.reshape(-1, 3).astype(np.int32), colors)


def _padded(values: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """(N, 9, 9, 9, ...) values of blocks with the first layers of the blocks behind them, 0 where missing.

    Args:
        values: (B, 512, ...) of all blocks.
        neighbours: (N, 8) indices: the block itself, and those at x, y, xy, z, ... from it; -1 where none.
    """
    shape = (len(neighbours), SIDE + 1, SIDE + 1, SIDE + 1, *values.shape[2:])
    padded = np.zeros(shape, values.dtype)
    for corner, (x, y, z) in enumerate(_CORNERS):
        rows = neighbours[:, corner]
        exists = np.flatnonzero(rows >= 0)
        block = values[rows[exists]].reshape(-1, SIDE, SIDE, SIDE, *values.shape[2:])
        source = tuple(slice(0, 1) if high else slice(None) for high in (x, y, z))
        target = tuple(slice(SIDE, None) if high else slice(0, SIDE) for high in (x, y, z))
        padded[(exists, *target)] = block[(slice(None), *source)]
    return padded


def _block_triangles(
    volume: BlockVolume, blocks: np.ndarray, least_weight: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles of the cells of some blocks, as keys, positions and colors of their corners (3 N, ...)."""
    position = unpack(volume.keys[blocks])
    neighbours = volume.find(pack(position[:, None] + _CORNERS[None]))
    distance = _padded(volume.distance, neighbours)
    known = _padded(volume.weight, neighbours) >= least_weight
    case = np.zeros((len(blocks), SIDE, SIDE, SIDE), np.int64)
    complete = np.ones(case.shape, bool)
    for corner, (x, y, z) in enumerate(_CORNERS):
        part = (slice(None), *(slice(shift, shift + SIDE) for shift in (x, y, z)))
        case |= (distance[part] < 0.0).astype(np.int64) << corner
        complete &= known[part]
    block, x, y, z = np.nonzero(complete & (case > 0) & (case < 255))
    count, table = triangle_table()
    kinds = case[block, x, y, z]
    cell = np.repeat(np.arange(len(kinds)), count[kinds])
    ends = np.cumsum(count[kinds])
    number = np.arange(len(cell)) - np.repeat(ends - count[kinds], count[kinds])
    edge = table[kinds[cell], number].reshape(-1)
    cell = np.repeat(cell, 3)
    axis = np.array([a for a, _ in EDGES])[edge]
    low = np.stack([x, y, z], axis=1)[cell] + _CORNERS[np.array([c for _, c in EDGES])[edge]]
    high = low + np.eye(3, dtype=np.int64)[axis]
    row = block[cell]
    before, after = distance[row, *low.T], distance[row, *high.T]
    share = before / (before - after)
    voxel = position[row] * SIDE + low
    place = voxel.astype(np.float64)
    place[np.arange(len(place)), axis] += share
    tint = np.zeros((len(place), 0), np.float32)
    if volume.color is not None:
        color = _padded(volume.color, neighbours)
        tint = color[row, *low.T] * (1.0 - share)[:, None] + color[row, *high.T] * share[:, None]
    return pack(voxel) * 3 + axis, (place * volume.voxel).astype(np.float32), tint


# Corner c of a cell is at (c & 1, c >> 1 & 1, c >> 2 & 1). Edges: axis and lower corner.
EDGES = [(axis, corner) for axis in range(3) for corner in range(8) if not corner >> axis & 1]
_EDGE_NUMBER = {
    frozenset((corner, corner | 1 << axis)): number for number, (axis, corner) in enumerate(EDGES)
}


def _faces() -> list[list[int]]:
    """The corners of each face of a cell, counter-clockwise seen from outside."""
    faces = []
    for axis in range(3):
        first, second = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        around = [0, first, first | second, second]
        faces.append([corner | 1 << axis for corner in around])
        faces.append(around[::-1])
    return faces


def _loops(case: int) -> list[list[int]]:
    """Closed loops of crossed edges of a pattern; bit c of `case`: corner c is behind the surface."""
    following: dict[int, int] = {}
    for face in _faces():
        behind = [bool(case >> corner & 1) for corner in face]
        for start in range(4):
            if behind[start] or not behind[(start + 1) % 4]:
                continue
            entry = _EDGE_NUMBER[frozenset((face[start], face[(start + 1) % 4]))]
            place = (start + 1) % 4
            while behind[(place + 1) % 4]:
                place = (place + 1) % 4
            leaving = _EDGE_NUMBER[frozenset((face[place], face[(place + 1) % 4]))]
            following[entry] = leaving
    loops = []
    while following:
        edge = next(iter(following))
        loop = []
        while edge in following:
            loop.append(edge)
            edge = following.pop(edge)
        loops.append(loop)
    return loops


@cache
def triangle_table() -> tuple[np.ndarray, np.ndarray]:
    """Number of triangles (256,) and their edges (256, T, 3) int64 of each pattern, filled up with zeros.

    Triangles are counter-clockwise seen from in front of the surface.
    """
    cases = []
    for case in range(256):
        fans = [[loop[0], loop[i], loop[i + 1]] for loop in _loops(case) for i in range(1, len(loop) - 1)]
        cases.append(fans)
    most = max(len(fans) for fans in cases)
    table = np.zeros((256, most, 3), np.int64)
    for case, fans in enumerate(cases):
        table[case, : len(fans)] = np.array(fans, np.int64).reshape(-1, 3)
    return np.array([len(fans) for fans in cases]), table
