"""Small holes of a scan, closed.

Every scan has pinholes where too few measurements met, mostly on surfaces seen from afar. A hole is found as
a closed loop of open edges and triangulated by dynamic programming (Barequet and Sharir, "Filling gaps in the
boundary of a polyhedron", 1995), then refined to the edges of its rim. No library that the engine has closes
holes, and MeshLab's filter would be 106 MB more for what the arrays below do in a second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .adjacency import NONE, Mesh
from .holes import MIN_AREA, MIN_RIM, median_edge, rim_hole

# A loop is no hole but the rim of a surface if the triangles along it face away from what would close it:
# mean cosine between the normals, -1 at the border of a flat speck, 1 at a hole in a wall.
RIM_COSINE = -0.5
# Triangles have least area, of equal areas the more regular shape: weight of their squared edges' sum.
SHAPE = 0.05
# Inner edges longer than so many times the rim's mean edge are divided.
LONGEST_EDGE = 1.7
_REFINEMENTS, _RELAXATIONS = 40, 20
# Numbers in an array of the dynamic programming.
_CHUNK = 2_000_000


@dataclass(frozen=True)
class Closing:
    """Triangles that close the small holes of a mesh.

    Attributes:
        vertices: (V, 3) float64 metres; those on the rims are copies of the mesh's.
        triangles: (T, 3) int32, wound like those around the hole.
        beside: (T,) int64 triangle of the mesh at the hole's rim.
        closed, left: how many holes were closed, and how many stay open.
        closed_area, open_area: their areas in square metres.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    beside: np.ndarray
    closed: int = 0
    left: int = 0
    closed_area: float = 0.0
    open_area: float = 0.0


@dataclass(frozen=True)
class _Loop:
    """A closed loop of open edges.

    Attributes:
        vertices: (n,) int64 in the direction of a closing, against that of the triangles at the edges.
        beside: (n,) int64 triangle at each edge, from its vertex to the next one.
    """

    vertices: np.ndarray
    beside: np.ndarray


def close_small_holes(mesh: Mesh, normals: np.ndarray, most_edges: int) -> Closing:
    """Close the holes of a mesh that have at most so many edges.

    A flat hole of more than `holes.MIN_AREA` squared edges may be a window or a mirror and stays open:
    photographs decide. So do larger holes, the rims of surfaces, and loops at triangles of other winding.

    Args:
        normals: (T, 3) unit normals of the triangles.
        most_edges: none are closed with 0.
    """
    loops = list(open_loops(mesh))
    if not loops:
        return Closing(*_triangulated(mesh, []))
    size = np.array([len(loop.vertices) for loop in loops])
    first = np.cumsum(size) - size
    vertex = np.concatenate([loop.vertices for loop in loops])
    beside = np.concatenate([loop.beside for loop in loops])
    ahead = np.arange(1, len(vertex) + 1)
    ahead[first + size - 1] = first
    corner = mesh.vertices[vertex]
    origin = np.repeat(corner[first], size, axis=0)
    turning = 0.5 * np.add.reduceat(np.cross(corner - origin, corner[ahead] - origin), first)
    area = np.linalg.norm(turning, axis=1)
    length = np.linalg.norm(corner[ahead] - corner, axis=1)
    facing = length * np.einsum("ec,ec->e", normals[beside], np.repeat(turning, size, axis=0))
    is_hole = np.add.reduceat(facing, first) >= RIM_COSINE * area * np.add.reduceat(length, first)
    edge = median_edge(mesh)
    large = size > most_edges
    for index in np.flatnonzero(is_hole & ~large & (size >= MIN_RIM) & (area >= MIN_AREA * edge**2)):
        rim = loops[index].vertices
        large[index] = rim_hole(mesh.vertices, np.stack([np.roll(rim, -1), rim], axis=1), edge) is not None
    small, left = is_hole & ~large, is_hole & large
    return Closing(
        *_triangulated(mesh, [loops[index] for index in np.flatnonzero(small)]),
        int(small.sum()),
        int(left.sum()),
        float(area[small].sum()),
        float(area[left].sum()),
    )


def open_loops(mesh: Mesh) -> Iterator[_Loop]:
    """The closed loops of edges that one triangle has.

    At each vertex a loop goes on at the last open edge of the triangles around it. Where it comes to a vertex
    again, it is divided, so that each vertex is once in a loop.
    """
    first = mesh.triangles.reshape(-1)
    after = np.arange(len(first)).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    opposite, open_edges = mesh.opposite
    # Corners of one vertex whose triangles are joined by edges form a fan; a loop goes on in the fan where an
    # edge ends. Triangles of other winding are of another fan.
    shared = np.flatnonzero((opposite > np.arange(len(first))) & (first != first[opposite]))
    beyond = opposite[shared]
    joints = np.concatenate([shared, after[shared]]), np.concatenate([after[beyond], beyond])
    graph = coo_array((np.ones(len(joints[0]), bool), joints), (len(first), len(first)))
    fan = connected_components(graph, directed=False)[1]
    starting = np.full(len(first), NONE, np.int64)
    starting[fan[open_edges]] = np.arange(len(open_edges))
    ahead = starting[fan[after[open_edges]]].tolist()
    start, triangle = first[open_edges].tolist(), (open_edges // 3).tolist()
    visited = [False] * len(ahead)
    for begin in range(len(ahead)):
        path: list[int] = []
        at: dict[int, int] = {}
        edge = begin
        while edge != NONE and not visited[edge]:
            visited[edge] = True
            if start[edge] in at:
                yield from _loop(path, at[start[edge]], start, triangle)
                for gone in path[at[start[edge]] :]:
                    at.pop(start[gone])
                del path[len(at) :]
            at[start[edge]] = len(path)
            path.append(edge)
            edge = ahead[edge]
        if edge != NONE and start[edge] in at:
            yield from _loop(path, at[start[edge]], start, triangle)


def _loop(path: list[int], begin: int, start: list[int], triangle: list[int]) -> Iterator[_Loop]:
    loop = path[begin:]
    if len(loop) >= 3:
        # Backwards: the edge from a vertex to the next one then is that which ends at the vertex.
        around = [start[edge] for edge in loop][::-1]
        beside = [triangle[edge] for edge in loop[:-1]][::-1] + [triangle[loop[-1]]]
        yield _Loop(np.array(around), np.array(beside))


def _triangulated(mesh: Mesh, loops: list[_Loop]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and triangle of the mesh beside each, of all loops together."""
    sizes = np.array([len(loop.vertices) for loop in loops], np.int64)
    vertices, triangles, owner, first = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [], 0
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        step = max(_CHUNK // int(size) ** 2, 1)
        for rows in (chosen[begin : begin + step] for begin in range(0, len(chosen), step)):
            rims = mesh.vertices[np.stack([loops[row].vertices for row in rows])]
            pieces = triangulate(rims)
            of_rim = first + int(size) * np.arange(len(rows))
            vertices.append(rims.reshape(-1, 3))
            triangles.append((pieces + of_rim[:, None, None]).reshape(-1, 3))
            owner.append(np.repeat(rows, size - 2))
            first += rims.shape[0] * int(size)
    if not loops:
        return vertices[0], triangles[0].astype(np.int32), np.zeros(0, np.int64)
    points, corners, of_loop = np.concatenate(vertices), np.concatenate(triangles), np.concatenate(owner)
    longest = _rim_edges(points, corners, of_loop, len(loops))
    rim = len(points)
    points, corners, of_loop = _refined(points, corners, of_loop, LONGEST_EDGE * longest)
    points = _relaxed(points, corners, rim)
    beside = np.array([loop.beside[0] for loop in loops])[of_loop]
    return points, corners.astype(np.int32), beside


def triangulate(rims: np.ndarray) -> np.ndarray:
    """(B, n - 2, 3) int64 triangles of least area and most regular shape that close B loops (B, n, 3)."""
    batch, size = rims.shape[:2]
    cost = np.full((batch, size, size), 0.0)
    middle = np.zeros((batch, size, size), np.int64)
    squared = ((rims[:, :, None] - rims[:, None]) ** 2).sum(axis=3)
    for gap in range(2, size):
        one = np.arange(size - gap)[:, None]
        other, between = one + gap, one + np.arange(1, gap)
        a, b, c = (squared[:, i, j] for i, j in ((one, between), (between, other), (one, other)))
        # Heron's formula in the squared edges.
        area = 0.25 * np.sqrt(np.maximum(4.0 * a * b - (a + b - c) ** 2, 0.0))
        total = cost[:, one, between] + cost[:, between, other] + area + SHAPE * (a + b + c)
        best = total.argmin(axis=2)
        rows = one[:, 0]
        cost[:, rows, rows + gap] = np.take_along_axis(total, best[:, :, None], axis=2)[:, :, 0]
        middle[:, rows, rows + gap] = rows + 1 + best
    result = np.zeros((batch, size - 2, 3), np.int64)
    for number, between in enumerate(middle.tolist()):
        open_ones, found = [(0, size - 1)], []
        while open_ones:
            low, high = open_ones.pop()
            if high - low > 1:
                corner = between[low][high]
                found.append((low, corner, high))
                open_ones += [(low, corner), (corner, high)]
        result[number] = found
    return result


def _edges(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The edges (E, 2) of triangles, (T, 3) the edge from each corner on, and (E,) how many triangles."""
    ends = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    count = int(corners.max(initial=0)) + 1
    key, place, uses = np.unique(ends[:, 0] * count + ends[:, 1], return_inverse=True, return_counts=True)
    return np.stack([key // count, key % count], axis=1), place.reshape(-1, 3), uses


def _rim_edges(points: np.ndarray, corners: np.ndarray, of_loop: np.ndarray, count: int) -> np.ndarray:
    """(count,) mean edge of each loop's rim, metres."""
    ends, place, uses = _edges(corners)
    length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    on_rim = uses[place] == 1
    loop = np.broadcast_to(of_loop[:, None], place.shape)[on_rim]
    return np.bincount(loop, length[place][on_rim], count) / np.maximum(np.bincount(loop, minlength=count), 1)


def _refined(
    points: np.ndarray, corners: np.ndarray, of_loop: np.ndarray, longest: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles with inner edges halved until none is longer than its loop's limit.

    In each round those are halved that are the longest of both their triangles.
    """
    for _ in range(_REFINEMENTS):
        ends, place, uses = _edges(corners)
        limit = np.zeros(len(ends))
        limit[place] = longest[of_loop][:, None]
        length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        rank = np.argsort(np.argsort(length, kind="stable")) + 1
        rank[(uses != 2) | (length <= limit)] = 0
        side = rank[place].argmax(axis=1)
        edge = place[np.arange(len(place)), side]
        halved = np.bincount(edge, rank[edge] > 0, len(ends)) == 2
        if not halved.any():
            break
        rows = np.flatnonzero(halved[edge])
        a, b, c = corners[rows[:, None], (side[rows, None] + np.arange(3)) % 3].T
        middle = (len(points) + np.cumsum(halved) - 1)[edge[rows]]
        points = np.concatenate([points, points[ends[halved]].mean(axis=1)])
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        corners = np.concatenate([np.delete(corners, rows, axis=0), *halves])
        of_loop = np.concatenate([np.delete(of_loop, rows), of_loop[rows], of_loop[rows]])
    return points, corners, of_loop


def _relaxed(points: np.ndarray, corners: np.ndarray, rim: int) -> np.ndarray:
    """Points (V, 3), those from index `rim` on moved to the middle of their neighbours, as in a soap film."""
    ends = _edges(corners)[0]
    one, other = np.concatenate([ends, ends[:, ::-1]]).T
    inner = one >= rim
    one, other = one[inner] - rim, other[inner]
    count = len(points) - rim
    number = np.maximum(np.bincount(one, minlength=count), 1)
    for _ in range(_RELAXATIONS if count else 0):
        total = [np.bincount(one, points[other, axis], count) for axis in range(3)]
        points = np.concatenate([points[:rim], np.stack(total, axis=1) / number[:, None]])
    return points
