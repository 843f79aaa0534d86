"""The engine's survey of the views: its input, and its result for the list of views and the overlay."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import bpy
import numpy as np

from ...bridge.process import Message
from ...bridge.step import Slices
from ...core.run.contents import Matrices, SurveyNote
from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.kinds import as_matrix
from ...core.run.run_files import SurveyArrays, read_room
from ...core.run.runfolder import RunFolder, write_json
from ...core.run.store import read_arrays
from ..marks import was_found
from ..room.exporting import export_room
from . import overlay
from .cameras import world_matrix
from .exporting import read_source, selected_views
from .importing import not_in_room, room_missing


class Level(NamedTuple):
    """A colour of a scale."""

    least: float  # the least value of a triangle of this colour: number of views that see it
    label: str  # the value as text, of two characters at most: the panel is narrow
    color: tuple[float, float, float]  # display RGB, 0 to 1


# From dark blue to yellow by rising lightness, and magenta: colour-blind people can tell all of them apart.
COVERAGE = (
    Level(0, "0", (1.0, 0.0, 0.8)),
    Level(1, "1", (0.16, 0.14, 0.42)),
    Level(2, "2", (0.13, 0.42, 0.60)),
    Level(3, "3+", (0.15, 0.70, 0.58)),
    Level(5, "5+", (0.99, 0.91, 0.15)),
)
_NO_PART = np.array((0.25, 0.25, 0.25))


@dataclass(frozen=True)
class Survey:
    """What the survey found about each triangle of the room."""

    views: list[str]  # names, in the order of `seen`
    seen: np.ndarray  # (V, ceil(T / 8)) u8, one bit per triangle: whether the view sees it
    areas: np.ndarray  # (T,) f32 square metres, 0 for triangles hidden from everywhere the cameras stood
    labels: dict[str, np.ndarray]  # by source, the part of each triangle (T,) i32, -1 without a part

    def counts(self, names: set[str]) -> np.ndarray:
        """How many of the named views see each triangle, (T,) u16."""
        total = np.zeros(len(self.areas), np.uint16)
        for name, bits in zip(self.views, self.seen, strict=True):
            if name in names:
                total += np.unpackbits(bits, count=len(total))
        return total


_cached: tuple[str, float, Survey] | None = None  # path and modification time of its file


def write_survey_input(run: RunFolder, search: bool = False) -> Slices[list[Message]]:
    """Write all views and the room of the context's scene to RUN/survey.

    Args:
        search: write the room without what the engine has added to it, which is to be looked for again.

    Returns:
        Warnings about objects in the room's collection that are not meshes.
    """
    for stale in (run.survey_json, run.survey_npz):  # of a room that may have changed
        stale.unlink(missing_ok=True)
    warnings = yield from write_views_and_room(run, RunFolder(run.survey), search)
    parts = bpy.context.scene.fipt.parts
    parts.surveyed_folder = parts.folder if parts.source == "folder" else ""
    return warnings


def write_views_and_room(run: RunFolder, target: RunFolder, search: bool = False) -> Slices[list[Message]]:
    """Write all views, the room of the context's scene, and matrices.json to a folder.

    Args:
        run: the run folder.
        target: where to; paths of photographs become absolute.
        search: see `write_survey_input`.

    Returns:
        Warnings about objects in the room's collection that are not meshes.
    """
    scene = bpy.context.scene
    objects = scene.fipt.capture.room_objects(scene)
    objects = [item for item in objects if not (search and was_found(item))]
    if not objects:
        raise room_missing()
    source = read_source(run)
    views = []
    for view in selected_views(scene, run, source, ticked=False):
        files = [kind for kind in ("image", "parts", "semantics", "mask") if getattr(view, kind)]
        paths: dict[str, Any] = {kind: str(run.resolve(getattr(view, kind))) for kind in files}
        views.append(replace(view, **paths))
    mesh = None if source.mesh is None else str(run.resolve(source.mesh))
    write_json(target.capture_json, replace(source, mesh=mesh, views=tuple(views)))
    warnings = not_in_room(scene.fipt.capture.room_members(scene))
    matrices = {item.name: as_matrix(world_matrix(item)) for item in objects}
    completed = scene.fipt.capture.completed and not search
    yield from export_room(objects, target, scene.fipt.parts.engine_source, completed)
    write_json(target.root / "matrices.json", matrices)
    return warnings


def take_survey(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Show the engine's result in the list of views and in the section Parts."""
    survey = read_document(run.survey_json, SurveyNote, "Check the views again.")
    entries = {entry.name: entry for entry in survey.views}
    settings = scene.fipt.capture
    for view in settings.views:
        entry = entries.get(view.name)
        view.checked = entry is not None
        view.warning = entry.warning if entry else "its camera was deleted"
        view.image_missing = bool(entry and entry.image_missing)
        view.room_share = entry.room_share if entry else 0.0
        view.clipped_share = entry.clipped_share if entry else 0.0
        view.misfit = -1.0 if entry is None or entry.misfit is None else entry.misfit
    known = [view.misfit for view in settings.views if view.misfit >= 0.0]
    settings.misfit = float(np.median(known)) if known else -1.0
    settings.unseen_share = 0.0
    settings.count_views()
    parts = scene.fipt.parts
    parts.auto_source = survey.parts.auto
    parts.counts = json.dumps(survey.parts.counts)


def coverage_changed(scene: bpy.types.Scene) -> None:
    """Recompute what the ticked views see, and the overlay if it is shown."""
    survey = read_survey(RunFolder(bpy.path.abspath(scene.fipt.run_folder)))
    if survey is None:
        scene.fipt.capture.unseen_share = -1.0
        return
    counts = survey.counts(used_views(scene))
    total = float(survey.areas.sum())
    scene.fipt.capture.unseen_share = float(survey.areas[counts == 0].sum()) / total if total else 0.0
    if overlay.shown(scene) == "coverage":
        show_coverage(scene)


def used_views(scene: bpy.types.Scene) -> set[str]:
    """Names of the views that an estimation uses."""
    return {view.name for view in scene.fipt.capture.views if view.enabled and view.split == "train"}


def show_coverage(scene: bpy.types.Scene) -> None:
    """Colour the room by how many of the ticked views see each triangle."""
    run, survey = survey_of(scene)
    counts = survey.counts(used_views(scene))
    _show(scene, run, "coverage", coverage_colors(counts))


def show_parts(scene: bpy.types.Scene) -> None:
    """Colour the room by its parts from the chosen source."""
    run, survey = survey_of(scene)
    source = resolved_source(scene)
    if source == "none":
        _show(scene, run, "parts", np.tile(_NO_PART, (len(survey.areas), 1)))
        return
    if source not in survey.labels or not surveyed_folder_fits(scene):
        raise FiptError("parts-missing", get=_WHY_NONE.get(source, "the capture has none"))
    _show(scene, run, "parts", part_colors(survey.labels[source]))


_WHY_NONE = {
    "masks": "the views had no part masks when they were checked",
    "semantics": "the capture has no semantic masks",
    "materials": "the room has fewer than two materials",
    "objects": "the room is a single object",
}


def resolved_source(scene: bpy.types.Scene) -> str:
    """The source that the engine would use: for Automatic its choice, for a folder of masks "masks"."""
    parts = scene.fipt.parts
    return parts.auto_source if parts.source == "auto" else parts.engine_source


def surveyed_folder_fits(scene: bpy.types.Scene) -> bool:
    """Whether the check used the masks that are chosen now: the artist's folder, or the capture's."""
    parts = scene.fipt.parts
    if parts.source == "folder":
        return bool(parts.folder) and parts.surveyed_folder == parts.folder
    return not (parts.source == "masks" and parts.surveyed_folder)


def coverage_colors(counts: np.ndarray) -> np.ndarray:
    """(T, 3) rgb of `COVERAGE`."""
    colors = np.array([level.color for level in COVERAGE])
    return colors[np.searchsorted([level.least for level in COVERAGE], counts, side="right") - 1]


def part_colors(labels: np.ndarray) -> np.ndarray:
    """(T, 3) rgb, one colour per part, very different for neighbouring ids; grey without a part."""
    ids = np.maximum(labels, 0).astype(np.float64)
    hue, value = np.modf(ids * 0.61803398875)[0], 0.55 + 0.4 * np.modf(ids * 0.7548776662)[0]
    saturation = 0.5 + 0.4 * np.modf(ids * 0.5698402910)[0]
    wheel = np.abs(np.modf(hue[:, None] + np.array([0.0, 2.0 / 3.0, 1.0 / 3.0]))[0] * 6.0 - 3.0) - 1.0
    colors = value[:, None] * (1.0 - saturation[:, None] * (1.0 - np.clip(wheel, 0.0, 1.0)))
    return np.where(labels[:, None] >= 0, colors, _NO_PART)


def read_survey(run: RunFolder) -> Survey | None:
    """The run's survey, cached until its file changes; None where there is none."""
    global _cached
    try:
        time = run.survey_npz.stat().st_mtime
        if _cached is None or _cached[:2] != (str(run.survey_npz), time):
            names = [view.name for view in read_document(run.survey_json, SurveyNote).views]
            arrays = read_arrays(run.survey_npz, SurveyArrays)
            seen, areas = arrays.seen.astype(np.uint8), arrays.areas
            if len(seen) != len(names):  # one of the two files is still to be written
                return None
            _cached = str(run.survey_npz), time, Survey(names, seen, areas, dict(arrays.parts))
    except (OSError, FiptError):
        return None
    return _cached[2]


def survey_of(scene: bpy.types.Scene) -> tuple[RunFolder, Survey]:
    """A scene's run and its survey."""
    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
    survey = read_survey(run)
    if survey is None:
        raise FiptError("survey-missing")
    return run, survey


def _show(scene: bpy.types.Scene, run: RunFolder, kind: str, colors: np.ndarray) -> None:
    room = read_room(RunFolder(run.survey))
    matrices = read_document(run.survey / "matrices.json", Matrices, "Check the views again.")
    overlay.show(scene, kind, overlay.object_parts(room, colors, matrices))
