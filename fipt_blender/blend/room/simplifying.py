"""The room simplified to a budget of triangles by Decimate modifiers, which the artist can change."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ...core.run.errors import FiptError
from ..marks import has_results
from .exporting import fresh_depsgraph

MODIFIER = "FIPT Simplify"
# Objects with fewer triangles keep them: modelled furniture and lamps, which would lose their shape.
FEW_TRIANGLES = 500


def simplify_room(objects: Sequence[bpy.types.Object], triangles: int) -> tuple[int, int]:
    """Give the larger objects a Decimate modifier, so that all together have about `triangles` triangles.

    Args:
        objects: mesh objects of the room.
        triangles: the budget; 0 only removes the modifiers.

    Returns:
        The number of triangles before and after.
    """
    if not objects:
        raise FiptError("room-empty")
    if any(has_results(item) for item in objects):
        raise FiptError("results-applied")
    for item in objects:
        modifier = item.modifiers.get(MODIFIER)
        if modifier is not None:
            item.modifiers.remove(modifier)
    before = _counts(objects)
    large = {name: count for name, count in before.items() if count >= FEW_TRIANGLES}
    total, most = sum(before.values()), sum(large.values())
    left = triangles - (total - most)
    if not triangles or total <= triangles or left <= 0:
        return total, total
    for item in objects:
        if item.name in large:
            modifier = item.modifiers.new(MODIFIER, "DECIMATE")
            modifier.ratio, modifier.use_collapse_triangulate = left / most, True
    return total, sum(_counts(objects).values())


def _counts(objects: Sequence[bpy.types.Object]) -> dict[str, int]:
    """Triangles of each object with its modifiers, by name."""
    depsgraph = fresh_depsgraph(objects)
    counts = {}
    for item in objects:
        evaluated = item.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh()
        mesh.calc_loop_triangles()
        counts[item.name] = len(mesh.loop_triangles)
        evaluated.to_mesh_clear()
    return counts
