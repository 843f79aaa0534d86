"""Pairs of points picked on the mesh and in photographs: kept with the scene, solved, and applied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core import conventions
from ...core.alignment.pairs import PairFit
from ...core.alignment.sights import Sights, fit_sights
from ...core.run.contents import Placement
from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..marks import VIEW, is_view, view_cameras
from ..outliner import CAMERAS, collection
from .cameras import camera_geometry, camera_pose, world_matrix

MOST_SIGHTS = 2  # photographs in which a point is picked


@dataclass(frozen=True)
class PickedSight:
    """A point in a photograph: the view's name, and pixels from the top left corner."""

    view: str
    u: float
    v: float


def add_pair(
    scene: bpy.types.Scene, item: bpy.types.Object, location: Vector, sights: Sequence[PickedSight]
) -> None:
    """Add a point of the mesh, given in the world, with its places in photographs; then solve all pairs."""
    cameras = view_cameras(scene)
    for sight in sights:
        if sight.view not in cameras:
            raise FiptError("view-missing.add-pair", view=sight.view)
        geometry = camera_geometry(scene, cameras[sight.view])
        if not (0.0 <= sight.u <= geometry.width and 0.0 <= sight.v <= geometry.height):
            raise FiptError("alignment-pairs.add-pair", view=sight.view)
    settings = scene.fipt.alignment
    pair = settings.pairs.add()
    pair.name = item.name
    pair.point = Matrix(world_matrix(item).tolist()).inverted_safe() @ location
    for sight in sights:
        stored = pair.sights.add()
        stored.name, stored.pixel = sight.view, (sight.u, sight.v)
    settings.active_pair = len(settings.pairs) - 1
    solve_pairs(scene)


def remove_pair(scene: bpy.types.Scene, index: int) -> None:
    """Remove a pair, and solve the others."""
    settings = scene.fipt.alignment
    settings.pairs.remove(index)
    settings.active_pair = max(min(settings.active_pair, len(settings.pairs) - 1), 0)
    solve_pairs(scene)


def solve_pairs(scene: bpy.types.Scene) -> PairFit | None:
    """Solve the pairs and store each one's error; None where they do not decide a placement."""
    settings = scene.fipt.alignment
    for pair in settings.pairs:
        pair.error = -1.0
    settings.error, settings.problem = -1.0, ""
    if not settings.pairs:
        return None
    used = usable_pairs(scene)
    try:
        fit = fit_sights(
            pair_sights(scene, used), np.array([mesh_point(scene, pair) for pair in used]).reshape(-1, 3)
        )
    except FiptError as error:
        settings.problem = f"{error.text} {error.remedy}"
        return None
    for pair, residual in zip(used, fit.residuals, strict=True):
        pair.error = float(residual)
    settings.error = fit.error
    if fit.mirrored:
        settings.problem = (
            "The pairs fit much better if the mesh is mirrored. Export it again without negated axes,"
            " or scale its object by -1 along one axis."
        )
    return fit


def usable_pairs(scene: bpy.types.Scene) -> list[bpy.types.PropertyGroup]:
    """The pairs whose object and cameras are still there."""
    cameras = view_cameras(scene)
    return [
        pair
        for pair in scene.fipt.alignment.pairs
        if pair.name in scene.objects and pair.sights and all(sight.name in cameras for sight in pair.sights)
    ]


def pair_sights(scene: bpy.types.Scene, pairs: Sequence[bpy.types.PropertyGroup]) -> Sights:
    """The rays through the pairs' points in the photographs, with the present poses of the cameras."""
    cameras = view_cameras(scene)
    index, origins, directions = [], [], []
    for number, pair in enumerate(pairs):
        for sight in pair.sights:
            origin, direction = camera_geometry(scene, cameras[sight.name]).ray(*sight.pixel)
            index.append(number)
            origins.append(origin)
            directions.append(direction)
    rays = np.array(origins).reshape(-1, 3), np.array(directions).reshape(-1, 3)
    return Sights(np.array(index, np.int64), *rays)


def mesh_point(scene: bpy.types.Scene, pair: bpy.types.PropertyGroup) -> np.ndarray:
    """A pair's point on the mesh in the world, (3,)."""
    matrix = world_matrix(scene.objects[pair.name])
    return np.asarray(conventions.transform_points(matrix, np.array(pair.point, np.float64)))


def align_by_pairs(scene: bpy.types.Scene) -> PairFit:
    """Move the cameras to the mesh by the pairs."""
    fit = solve_pairs(scene)
    if fit is None:
        problem = scene.fipt.alignment.problem or "No points are picked."
        raise FiptError("alignment-pairs.align-by-pairs", problem=problem)
    move_cameras(scene, fit.similarity)
    return fit


def take_alignment(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Move the cameras as RUN/align/align.json says."""
    found = read_document(run.align / "align.json", Placement, "Align the cameras again.")
    scene.fipt.alignment.summary = found.text
    move_cameras(scene, np.array(found.similarity))


def move_cameras(scene: bpy.types.Scene, similarity: np.ndarray) -> None:
    """Move all imported cameras by a similarity (4, 4) of the world; the mesh stays.

    What depended on the cameras' poses is no longer known.
    """
    for item in imported_cameras(scene):
        place_camera(item, conventions.transform_poses(similarity, camera_pose(item)))
    solve_pairs(scene)
    capture = scene.fipt.capture
    for view in capture.views:
        view.checked, view.warning, view.misfit = False, "", -1.0
    capture.misfit = capture.unseen_share = -1.0
    capture.count_views()


def imported_cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The views' cameras that an import has made."""
    items = [item for item in collection(scene, CAMERAS).objects if is_view(item)]
    if not items:
        raise FiptError("alignment-own-cameras")
    return items


def place_camera(item: bpy.types.Object, pose: np.ndarray) -> None:
    """Give a camera a pose (4, 4) in the world, OpenCV axes, whatever the scale of its parents."""
    local = conventions.opencv_to_blender_camera(pose)
    if item.parent is not None:
        parent = world_matrix(item.parent) @ np.array(item.matrix_parent_inverse, np.float64)
        local = conventions.transform_poses(np.linalg.inv(parent), local)
    item.matrix_basis = Matrix(local.tolist())


def camera_view(camera: bpy.types.Object | None) -> str:
    """The view that a camera shows, "" where it shows none."""
    return str(camera[VIEW]) if camera is not None and is_view(camera) else ""
