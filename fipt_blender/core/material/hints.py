"""What the artist knows of surfaces, on the mesh: which triangles a hint is about, and what it allows there.

Hints name positions (run/hints.py). A hint is about the part at its position or, where no parts are known,
about the connected piece of the mesh, which becomes a part of its own. So does a painted area.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..alignment.surface import closest_points
from ..parts.labels import NO_PART, Parts
from ..run.hints import DIELECTRIC, METAL, UNKNOWN, Hint

NO_HINT = -1  # in place of a hint
# A point of an area lies on the triangle whose center is nearest if that is closer than this share of the
# distance from the center to the corners; else all triangles are searched.
ON_TRIANGLE = 0.5


@dataclass(frozen=True)
class KnownMaterials:
    """What is known of the materials of G groups.

    Attributes:
        roughness: (G, 2) lowest and highest; 0 and 1 where nothing is known.
        metallic: (G, 2) the same: 0 and 0 for dielectrics, 1 and 1 for metals, else 0 and 1.
        same: (G,) int, lowest number of the groups of the same material; a group's own where there is none.
    """

    roughness: np.ndarray
    metallic: np.ndarray
    same: np.ndarray

    @classmethod
    def none(cls, groups: int) -> KnownMaterials:
        """Nothing is known."""
        unknown = np.tile([0.0, 1.0], (groups, 1))
        return cls(unknown, unknown.copy(), np.arange(groups))

    def allows(self, roughness: np.ndarray, metallic: np.ndarray) -> np.ndarray:
        """(S, G) bool, whether each of the materials (S,) is possible.

        Where no material has a roughness in a range, those next to it are.
        """
        low, high = self.roughness.T
        within = (roughness[:, None] >= low) & (roughness[:, None] <= high)
        values = np.unique(roughness)
        below = values[np.maximum(np.searchsorted(values, low, side="right") - 1, 0)]
        above = values[np.minimum(np.searchsorted(values, high), len(values) - 1)]
        beside = (roughness[:, None] == below) | (roughness[:, None] == above)
        within |= beside & ~within.any(axis=0)
        return (
            within & (metallic[:, None] >= self.metallic[:, 0]) & (metallic[:, None] <= self.metallic[:, 1])
        )


@dataclass(frozen=True)
class SurfaceHints:
    """H hints on a mesh of T triangles.

    Attributes:
        names: of the hints.
        triangle: (T,) int32 hint of each triangle, NO_HINT without one.
        own: (H,) bool, whether its triangles become a part of their own.
        roughness, metallic: (H, 2) what is known; see :class:`KnownMaterials`.
        same: (H,) int lowest hint of the same material.
        emits: (H,) int8: 1 emits, -1 does not, 0 unknown.
        left_alone: (H,) bool.
        base_color: (H, 3) that are known, else NaN.
        problems: what could not be honoured, in words.
    """

    names: tuple[str, ...]
    triangle: np.ndarray
    own: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    same: np.ndarray
    emits: np.ndarray
    left_alone: np.ndarray
    base_color: np.ndarray
    problems: tuple[str, ...] = ()

    @property
    def about_material(self) -> np.ndarray:
        """(H,) bool, hints that say something of roughness or metallic."""
        shared = np.bincount(self.same, minlength=len(self.same))[self.same] > 1
        return shared | self.decides[:, :2].any(axis=1)

    @property
    def decides(self) -> np.ndarray:
        """(H, 3) bool, whether they say how rough a surface is, whether it is metal, and whether it emits."""
        narrow = [np.ptp(values, axis=1) < 1.0 for values in (self.roughness, self.metallic)]
        return np.column_stack([*narrow, self.emits != 0])

    def of_triangles(self, values: np.ndarray) -> np.ndarray:
        """(T, ...) the value (H, ...) of the hint on each triangle; zero without a hint."""
        return np.append(values, np.zeros((1, *values.shape[1:]), values.dtype), axis=0)[self.triangle]

    def split_parts(self, parts: Parts) -> Parts:
        """Known parts, with new ones at the end for the hints on triangles of their own."""
        if parts.kind != "part":
            return parts
        label = parts.triangle_part
        return replace(parts, triangle_part=self.split(label, int(label.max(initial=-1)) + 1))

    def split(self, label: np.ndarray, count: int) -> np.ndarray:
        """(T,) int32 labels (T,), with new ones from `count` on for the hints on triangles of their own."""
        number = count + np.cumsum(self.own) - 1
        own = self.of_triangles(self.own)
        return np.where(own, self.of_triangles(number), label).astype(np.int32)

    def known(self, group_of_hint: np.ndarray, groups: int) -> KnownMaterials:
        """What they say of so many groups.

        Args:
            group_of_hint: (H,) int, negative for none.
        """
        known = KnownMaterials.none(groups)
        chosen = np.flatnonzero(group_of_hint >= 0)
        group = group_of_hint[chosen]
        known.roughness[group], known.metallic[group] = self.roughness[chosen], self.metallic[chosen]
        lowest = np.full(len(self.same), groups)
        np.minimum.at(lowest, self.same[chosen], group)
        known.same[group] = lowest[self.same[chosen]]
        return known


def known_colors(
    hints: Sequence[Hint],
    vertices: np.ndarray,
    triangles: np.ndarray,
    parts: Parts,
    surface: np.ndarray,
) -> np.ndarray:
    """(T, 3) base colour of each triangle that hints know, else NaN; arguments as of :func:`place_hints`."""
    placed = place_hints(hints, vertices, triangles, parts, surface)
    return np.append(placed.base_color, [[np.nan] * 3], axis=0)[placed.triangle]


def values_of_hints(hints: SurfaceHints, of_triangle: np.ndarray) -> np.ndarray:
    """(H,) int value (T,) at the first triangle of each hint; -1 for hints without triangles."""
    first = np.full(len(hints.names) + 1, -1, np.int64)
    order = np.arange(len(of_triangle))[::-1]
    first[hints.triangle[order]] = order
    found = first[:-1]
    return np.where(found >= 0, of_triangle[np.maximum(found, 0)], -1)


def place_hints(
    hints: Sequence[Hint],
    vertices: np.ndarray,
    triangles: np.ndarray,
    parts: Parts,
    surface: np.ndarray,
) -> SurfaceHints:
    """Find the surfaces that hints are about.

    Areas go first, so that a hint on a part is about the rest of the part. Of two hints on one part the later
    one counts.

    Args:
        vertices, triangles: of the mesh, (V, 3) and (T, 3).
        parts: of the triangles.
        surface: (T,) int of :func:`.surface_labels`.
    """
    corners = np.asarray(vertices, np.float64)[triangles]
    triangle = np.full(len(triangles), NO_HINT, np.int32)
    problems: list[str] = []
    for number, hint in enumerate(hints):
        if hint.area:
            triangle[_area(hint, corners)] = number
    areas = triangle >= 0
    entries = list(hints)

    def take(number: int, at: int) -> None:
        """Note hint `number` on the surface of triangle `at`, without the areas."""
        name = entries[number].name
        if areas[at]:
            problems.append(f"'{name}' lies in the area '{entries[triangle[at]].name}'.")
            return
        if surface[at] == NO_PART:
            problems.append(f"'{name}' lies on a surface without a part.")
            return
        if triangle[at] >= 0:
            problems.append(f"'{entries[triangle[at]].name}' is on the same part as '{name}'.")
        triangle[(surface == surface[at]) & ~areas] = number

    for number, hint in enumerate(hints):
        if not hint.area:
            take(number, int(nearest_triangles(np.array(hint.points[:1]), corners)[0]))
    same = np.arange(len(hints))
    for number, hint in enumerate(hints):
        if hint.same_as is None:
            continue
        at = int(nearest_triangles(np.array([hint.same_as]), corners)[0])
        if triangle[at] < 0:
            entries.append(Hint(points=(hint.same_as,), name=f"like {hint.name}"))
            same = np.append(same, len(entries) - 1)
            take(len(entries) - 1, at)
        if triangle[at] >= 0:
            same[same == same[number]] = same[triangle[at]]
    own = np.array([hint.area or parts.kind != "part" for hint in entries], bool)
    return _placed(entries, triangle, own, same, problems)


def _placed(
    hints: Sequence[Hint], triangle: np.ndarray, own: np.ndarray, same: np.ndarray, problems: list[str]
) -> SurfaceHints:
    """The hints with what they say; those of one material agree on it."""
    ranges = {UNKNOWN: (0.0, 1.0), DIELECTRIC: (0.0, 0.0), METAL: (1.0, 1.0)}
    roughness = np.array([hint.roughness or (0.0, 1.0) for hint in hints]).reshape(-1, 2)
    metallic = np.array([ranges[hint.material] for hint in hints]).reshape(-1, 2)
    lowest = np.array([int(np.flatnonzero(same == number)[0]) for number in same], np.int64)
    for values, what in ((roughness, "roughness"), (metallic, "material")):
        for number in np.unique(lowest):
            members = lowest == number
            low, high = values[members, 0].max(), values[members, 1].min()
            if low > high:
                problems.append(f"'{hints[number].name}' and what is like it have no common {what}.")
                low, high = values[number]
            values[members] = low, high
    emits = {None: 0, True: 1, False: -1}
    empty = set(range(len(hints))) - set(np.unique(triangle).tolist())
    problems += [f"'{hints[number].name}' is about no surface." for number in sorted(empty)]
    return SurfaceHints(
        names=tuple(hint.name for hint in hints),
        triangle=triangle,
        own=own,
        roughness=roughness,
        metallic=metallic,
        same=lowest,
        emits=np.array([emits[hint.emits] for hint in hints], np.int8),
        left_alone=np.array([hint.leave_alone for hint in hints], bool),
        base_color=np.array([hint.base_color or (np.nan,) * 3 for hint in hints]).reshape(-1, 3),
        problems=tuple(dict.fromkeys(problems)),
    )


def _area(hint: Hint, corners: np.ndarray) -> np.ndarray:
    """(n,) int triangles of an area."""
    points = np.array(hint.points)
    centers, radius = _balls(corners)
    distance, nearest = cKDTree(centers).query(points)
    found = np.asarray(nearest, np.int64)
    far = distance > ON_TRIANGLE * radius[found]
    found[far] = nearest_triangles(points[far], corners)
    return np.unique(found)


def nearest_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(P,) int64 triangle (T, 3, 3) nearest to each of a few points (P, 3)."""
    centers, radius = _balls(corners)
    result = np.zeros(len(points), np.int64)
    for row, point in enumerate(points):
        to_center = np.linalg.norm(centers - point, axis=1)
        near = np.flatnonzero(to_center - radius <= to_center.min())
        distance = np.linalg.norm(closest_points(point, corners[near]) - point, axis=1)
        result[row] = near[distance.argmin()]
    return result


def _balls(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) centers of triangles (T, 3, 3), and (T,) distance of the farthest corner from each."""
    centers = corners.mean(axis=1)
    return centers, np.linalg.norm(corners - centers[:, None], axis=2).max(axis=1)
