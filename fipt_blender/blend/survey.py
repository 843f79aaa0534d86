# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's survey of the views: what it is given, and what it found, for the list and the overlay."""

from __future__ import annotations

import json
from collections.abc import Generator
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json, write_json
from . import overlay
from .capture_export import read_source, view_entries, world_matrix
from .capture_import import room_missing
from .room_export import export_slices, read_room

# 0 views: red; then what hangs on few photographs, up to what many agree on
_COVERAGE = np.array(
    [[0.80, 0.05, 0.05], [0.95, 0.45, 0.05], [0.95, 0.80, 0.10], [0.60, 0.80, 0.15], [0.15, 0.65, 0.20]]
)
_COVERAGE_STEPS = np.array([0, 1, 2, 3, 5])  # fewest views of each colour
_NO_PART = np.array([0.25, 0.25, 0.25])


@dataclass(frozen=True)
class Survey:
    """What the survey found about each triangle of its room.

    Attributes:
        views: names, in the order of `seen`.
        seen: (V, ceil(T / 8)) u8, bits of whether each view sees each triangle.
        areas: (T,) f32 square metres, 0 for what is hidden from wherever the cameras stood.
        labels: part of each triangle (T,) i32 by source, -1 without.
    """

    views: list[str]
    seen: np.ndarray
    areas: np.ndarray
    labels: dict[str, np.ndarray]

    def counts(self, names: set[str]) -> np.ndarray:
        """(T,) u16, how many of these views see each triangle."""
        total = np.zeros(len(self.areas), np.uint16)
        for name, bits in zip(self.views, self.seen, strict=True):
            if name in names:
                total += np.unpackbits(bits, count=len(total))
        return total


_read: tuple[str, float, Survey] | None = None


def write_survey_input(run: RunFolder) -> Generator[float | None, None, None]:
    """All views and the room, as they stand in the context's scene, into RUN/survey.

    Raises:
        FiptError: ``room-missing``, ``mesh-empty`` and those of `view_entries`.
    """
    scene = bpy.context.scene
    objects = scene.fipt.capture.room_objects(scene)
    if not objects:
        raise room_missing()
    target = RunFolder(run.survey)
    for stale in (run.survey_json, run.survey_npz):  # of a room that may have changed
        stale.unlink(missing_ok=True)
    source = read_source(run)
    entries = view_entries(scene, run, source, ticked=False)
    for entry in entries:
        for kind in ("image", "parts", "semantics", "mask"):
            if entry.get(kind):
                entry[kind] = str(run.resolve(entry[kind]))
    mesh = None if source["mesh"] is None else str(run.resolve(source["mesh"]))
    write_json(target.capture_json, {**source, "mesh": mesh, "views": entries})
    matrices = {item.name: world_matrix(item).tolist() for item in objects}
    yield from export_slices(objects, target, scene.fipt.parts.engine_source)
    scene = bpy.context.scene
    write_json(run.survey / "matrices.json", matrices)
    scene.fipt.parts.surveyed_folder = scene.fipt.parts.folder if scene.fipt.parts.source == "folder" else ""


def take_survey(scene: bpy.types.Scene, run: RunFolder) -> None:
    """What the engine found into the list of views and the section Parts."""
    data = read_json(run.survey_json)
    found = {entry["name"]: entry for entry in data["views"]}
    settings = scene.fipt.capture
    for view in settings.views:
        entry = found.get(view.name)
        view.checked = entry is not None
        view.warning = entry["warning"] if entry else "its camera was deleted"
        view.image_missing = bool(entry and entry["image_missing"])
        view.room_share = entry["room_share"] if entry else 0.0
        view.clipped_share = entry["clipped_share"] if entry else 0.0
    settings.unseen_share = 0.0
    settings.count_views()
    parts = scene.fipt.parts
    parts.auto_source = data["parts"]["auto"]
    parts.counts = json.dumps(data["parts"]["counts"])


def coverage_changed(scene: bpy.types.Scene) -> None:
    """Count anew what the ticked views see; the overlay follows where it is shown."""
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
    """Names of the views that an estimation learns from."""
    return {view.name for view in scene.fipt.capture.views if view.enabled and view.split == "train"}


def show_coverage(scene: bpy.types.Scene) -> None:
    """Colour the room by how many of the ticked views see each of its triangles.

    Raises:
        FiptError: ``survey-missing``.
    """
    run, survey = _needed(scene)
    counts = survey.counts(used_views(scene))
    _show(scene, run, "coverage", coverage_colors(counts))


def show_parts(scene: bpy.types.Scene) -> None:
    """Colour the room by its parts, from the source that is chosen.

    Raises:
        FiptError: ``survey-missing``, ``parts-missing``.
    """
    run, survey = _needed(scene)
    source = resolved_source(scene)
    if source == "none":
        _show(scene, run, "parts", np.tile(_NO_PART, (len(survey.areas), 1)))
        return
    if source not in survey.labels or not surveyed_folder_fits(scene):
        raise FiptError(
            "parts-missing",
            "The check found no such parts: " + _WHY_NONE.get(source, "the capture has none") + ".",
            "Check the views again, or choose another source of parts.",
        )
    _show(scene, run, "parts", part_colors(survey.labels[source]))


_WHY_NONE = {
    "masks": "the views had no part masks when they were checked",
    "semantics": "the capture has no semantic masks",
    "materials": "the room has no two materials",
    "objects": "the room is one object",
}


def resolved_source(scene: bpy.types.Scene) -> str:
    """The source that the engine would use: what Automatic chose, masks for a folder of them."""
    parts = scene.fipt.parts
    return parts.auto_source if parts.source == "auto" else parts.engine_source


def surveyed_folder_fits(scene: bpy.types.Scene) -> bool:
    """Whether the check looked at the masks that are chosen now: the artist's own, or the capture's."""
    parts = scene.fipt.parts
    if parts.source == "folder":
        return bool(parts.folder) and parts.surveyed_folder == parts.folder
    return not (parts.source == "masks" and parts.surveyed_folder)


def coverage_colors(counts: np.ndarray) -> np.ndarray:
    """(T, 3) from red (no view) to green (five and more)."""
    return _COVERAGE[np.searchsorted(_COVERAGE_STEPS, counts, side="right") - 1]


def part_colors(labels: np.ndarray) -> np.ndarray:
    """(T, 3) a colour a part, neighbouring ids far apart; grey without a part."""
    ids = np.maximum(labels, 0).astype(np.float64)
    hue, value = np.modf(ids * 0.61803398875)[0], 0.55 + 0.4 * np.modf(ids * 0.7548776662)[0]
    saturation = 0.5 + 0.4 * np.modf(ids * 0.5698402910)[0]
    wheel = np.abs(np.modf(hue[:, None] + np.array([0.0, 2.0 / 3.0, 1.0 / 3.0]))[0] * 6.0 - 3.0) - 1.0
    colors = value[:, None] * (1.0 - saturation[:, None] * (1.0 - np.clip(wheel, 0.0, 1.0)))
    return np.where(labels[:, None] >= 0, colors, _NO_PART)


def read_survey(run: RunFolder) -> Survey | None:
    """The run's survey, kept in memory while its file stays the same; None where there is none."""
    global _read
    try:
        time = run.survey_npz.stat().st_mtime
        if _read is None or _read[:2] != (str(run.survey_npz), time):
            with np.load(run.survey_npz, allow_pickle=False) as arrays:
                labels = {name[6:]: arrays[name] for name in arrays.files if name.startswith("parts_")}
                seen, areas = arrays["seen"], arrays["areas"]
            names = [view["name"] for view in read_json(run.survey_json)["views"]]
            _read = str(run.survey_npz), time, Survey(names, seen, areas, labels)
    except (OSError, ValueError, KeyError, FiptError):
        return None
    return _read[2]


def _needed(scene: bpy.types.Scene) -> tuple[RunFolder, Survey]:
    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
    survey = read_survey(run)
    if survey is None:
        raise FiptError("survey-missing", "The views have not been checked yet.", "Press Check Views first.")
    return run, survey


def _show(scene: bpy.types.Scene, run: RunFolder, kind: str, colors: np.ndarray) -> None:
    room = read_room(RunFolder(run.survey))
    matrices = read_json(run.survey / "matrices.json")
    overlay.show(scene, kind, overlay.object_parts(room, colors, matrices))
