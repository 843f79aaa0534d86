"""Hints of the scene to hints.json, and the questions of doubts.json to the scene."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Vector

from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.hints import MOST_HINTS, MOST_POINTS, Hint, write_hints
from ...core.run.result_contents import Doubt, Doubts
from ...core.run.runfolder import RunFolder
from .anchors import in_scene, kept_object, set_area, surface_at_point, world_points

# What an answer to a question says: properties of the hint.
GLOSSY, MATT = (0.0, 0.5), (0.5, 1.0)
ANSWERS: dict[str, dict[str, str | float | bool]] = {
    "METAL": {"material": "METAL"},
    "DIELECTRIC": {"material": "DIELECTRIC"},
    "GLOSSY": {"roughness_known": "RANGE", "roughness": GLOSSY[0], "roughness_most": GLOSSY[1]},
    "MATT": {"roughness_known": "RANGE", "roughness": MATT[0], "roughness_most": MATT[1]},
    "EMITS": {"emission": "EMITS"},
    "NOT": {"emission": "NOT"},
    "LEAVE": {"leave_alone": True},
}


def scene_hints(scene: bpy.types.Scene) -> list[Hint]:
    """The scene's hints for the engine; those on removed objects are left out."""
    hints = [_hint(row, scene) for row in scene.fipt.hints.hints if in_scene(row.object, scene)]
    if len(hints) > MOST_HINTS or sum(len(hint.points) for hint in hints) > MOST_POINTS:
        raise FiptError("hints-many", most_hints=MOST_HINTS, most_points=MOST_POINTS)
    return hints


def _hint(row: bpy.types.PropertyGroup, scene: bpy.types.Scene) -> Hint:
    same = None
    if in_scene(row.same_object, scene):
        same = tuple(row.same_object.matrix_world @ Vector(row.same_point))
    return Hint(
        points=tuple(tuple(point) for point in world_points(row).tolist()),
        name=row.name,
        area=row.area,
        material=row.material.lower(),
        roughness=row.bounds(),
        base_color=row.known_color(),
        emits={"UNKNOWN": None, "EMITS": True, "NOT": False}[row.emission],
        same_as=same,
        leave_alone=row.leave_alone,
    )


def write_for_run(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Write the hints that a complete estimation honours."""
    hints = scene_hints(scene)
    run.hints_again_json.unlink(missing_ok=True)
    if hints:
        write_hints(run.hints_json, hints)
    else:
        run.hints_json.unlink(missing_ok=True)


def write_hints_rerun(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Write the hints that a re-estimation honours instead of those of the run."""
    hints = scene_hints(scene)
    if hints or run.hints_json.exists():
        write_hints(run.hints_again_json, hints, scene.fipt.hints.light)
    else:
        run.hints_again_json.unlink(missing_ok=True)


def read_doubts(scene: bpy.types.Scene, run: RunFolder) -> int:
    """List the questions of a run in the scene; returns their number, 0 where the run has none."""
    settings = scene.fipt.hints
    doubts: Sequence[Doubt] = ()
    if run.doubts_json.exists():
        doubts = read_document(run.doubts_json, Doubts, "Run the estimation again.").doubts
    settings.doubts.clear()
    for doubt in doubts:
        row = settings.doubts.add()
        row.name, row.text, row.view = doubt.name, doubt.text, doubt.view
        row.question, row.point = doubt.question.upper(), doubt.point
        row.picture = str(run.doubts / doubt.picture)
        row.answered = any(_answers(hint, row) for hint in settings.hints)
    settings.active_doubt = min(settings.active_doubt, max(len(settings.doubts) - 1, 0))
    return len(settings.doubts)


def _answers(hint: bpy.types.PropertyGroup, doubt: bpy.types.PropertyGroup) -> bool:
    """Whether a hint says what is asked of a part, of which it has the name."""
    known = {
        "METAL": hint.material != "UNKNOWN",
        "GLOSS": hint.roughness_known != "UNKNOWN",
        "LAMP": hint.emission != "UNKNOWN",
    }
    return hint.name == doubt.name and (hint.leave_alone or known[doubt.question])


def answer_doubt(scene: bpy.types.Scene, index: int, answer: str) -> None:
    """Make a hint of the answer to a question, one of ANSWERS."""
    settings = scene.fipt.hints
    doubt = settings.doubts[index]
    surface = surface_at_point(scene, Vector(doubt.point))
    if surface is None:
        raise FiptError("surface-missing.answer-doubt")
    hint = add_hint(scene, doubt.name, *surface)
    for name, value in ANSWERS[answer].items():
        setattr(hint, name, value)
    doubt.answered = True


def add_hint(
    scene: bpy.types.Scene, name: str, item: bpy.types.Object, point: Vector
) -> bpy.types.PropertyGroup:
    """A new hint, the active one, on an object at a point in the world."""
    settings, item = scene.fipt.hints, kept_object(scene, item)
    hint = settings.hints.add()
    settings.active_hint = len(settings.hints) - 1
    hint.name, hint.object = name, item
    hint.point = item.matrix_world.inverted_safe() @ point
    return hint


def lamp_hint(scene: bpy.types.Scene, lamp: bpy.types.Object) -> bpy.types.PropertyGroup | None:
    """The hint that `hint_on_lamp` has made of a fixture; None without one."""
    return next((hint for hint in scene.fipt.hints.hints if hint.area and hint.name == lamp.name), None)


def hint_on_lamp(scene: bpy.types.Scene, lamp: bpy.types.Object, emission: str) -> None:
    """Make a hint of whether all faces of a fixture emit light, in place of an earlier one.

    Args:
        emission: an item of `properties.hints.EMISSION`.
    """
    hint = lamp_hint(scene, lamp) or add_hint(scene, lamp.name, lamp, lamp.matrix_world.translation)
    set_area(hint, lamp, np.ones(len(lamp.data.polygons), bool))
    hint.emission = emission
