"""The scene's ticked views to capture.json, with the present poses of their cameras."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.capture.files import Folders, ambiguous
from ...core.run.contents import CapturedView, CapturedViews
from ...core.run.errors import FiptError
from ...core.run.kinds import as_matrix
from ...core.run.run_files import read_capture
from ...core.run.runfolder import RunFolder, write_json
from ..marks import view_cameras
from .cameras import camera_geometry, camera_pose

MIN_VIEWS = 2
_LENS = ("fx", "fy", "cx", "cy")
# An unchanged camera keeps pose and lens as read, which are more precise than Blender's single floats.
_UNMOVED = 2e-6


def export_capture(scene: bpy.types.Scene, run: RunFolder) -> int:
    """Write capture.json from the ticked views, with their cameras' present poses and lenses and the splits.

    Everything else stays as `ingest` read it. Views that are not ticked, or whose cameras were deleted, are
    left out. The file is written only if something changed, so that a run can resume; results of other views
    are deleted then.

    Returns:
        The number of views.
    """
    source = read_source(run)
    views = selected_views(scene, run, source, ticked=True)
    train = sum(view.split == "train" for view in views)
    if train < MIN_VIEWS:
        listed, present = scene.fipt.capture.views, view_cameras(scene)
        gone = sum(view.name not in present for view in listed)
        text = f"Only {train} of {len(listed)} views are ticked for estimating"
        text += f" and have a camera: those of {gone} were deleted" if gone else ""
        raise FiptError(
            "views-few",
            text=text,
            min_views=MIN_VIEWS,
            value="Import the capture again, which brings back deleted cameras."
            if gone
            else "Tick more views in the list, or change some from Held Back to Estimation.",
        )
    selected = replace(source, views=tuple(views), up=None)  # `up` is what the panel tells of the import
    if not run.capture_json.exists() or read_capture(run.capture_json) != selected:
        run.drop_results()
        write_json(run.capture_json, selected)
    return len(views)


def read_source(run: RunFolder) -> CapturedViews:
    """ingest.json: all views as they were read."""
    if not run.ingest_json.exists():
        raise FiptError("capture-missing.read-source")
    return read_capture(run.ingest_json)


def selected_views(
    scene: bpy.types.Scene, run: RunFolder, source: CapturedViews, ticked: bool
) -> list[CapturedView]:
    """The views that have a camera, for capture.json.

    Args:
        scene: with the list of views.
        run: the run folder.
        source: result of `read_source`.
        ticked: leave out views that are not ticked; otherwise their split is "unused".
    """
    known = {view.name: view for view in source.views}
    masks, cameras = part_folder(scene), view_cameras(scene)
    views, folders = [], Folders()
    taken: dict[Path, str] = {}
    for view in scene.fipt.capture.views:
        camera = cameras.get(view.name)
        if camera is None or view.name not in known or (ticked and not view.enabled):
            continue
        source_view = known[view.name]
        changes: dict[str, Any] = {"split": view.split if view.enabled else "unused"}
        pose, before = camera_pose(camera), np.array(source_view.camera_to_world)
        if np.abs(pose - before).max() > _UNMOVED * (1.0 + np.abs(before[:3, 3]).max()):
            changes["camera_to_world"] = as_matrix(pose)
        lens = camera_geometry(scene, camera).lens
        change = np.abs(np.subtract(lens, [getattr(source_view, name) for name in _LENS]))
        if change.max() > _UNMOVED * max(source_view.width, *lens):
            changes.update(zip(_LENS, lens, strict=True))
        if masks is not None:
            # Named after the view ("train/000") or its photograph's file.
            mask = folders.ids(masks, [view.name, Path(source_view.image).name])
            changes["parts"] = None if mask is None else str(mask)
            if mask is not None and (other := taken.setdefault(mask, view.name)) != view.name:
                raise ambiguous(mask.name, [other, view.name])
        views.append(replace(source_view, **changes))
    if masks is not None and views and not any(view.parts for view in views):
        stem = Path(views[0].image).stem
        raise FiptError("parts-folder.selected-views", masks=masks, number_of_views=len(views), stem=stem)
    return views


def part_folder(scene: bpy.types.Scene) -> Path | None:
    """The artist's folder of part masks; None where the parts have another source."""
    settings = scene.fipt.parts
    if settings.source != "folder":
        return None
    folder = Path(bpy.path.abspath(settings.folder)) if settings.folder else None
    if folder is None or not folder.is_dir():
        raise FiptError(
            "parts-folder.part-folder",
            value=f"The folder of masks {folder} does not exist."
            if folder
            else "No folder of masks is chosen.",
        )
    return folder
