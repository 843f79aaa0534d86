# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `align`: finds where the cameras of a capture belong relative to the mesh of the scene.

The sparse points of the camera solve are registered with the mesh, without a first guess or from a placement
that is nearly right; or the edges of the mesh are matched with those of the photographs, which corrects a few
pixels. Blender writes the input as for `survey`, and moves the cameras.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..alignment.polish import polish
from ..alignment.registration import refine
from ..alignment.surface import sample_surface
from ..capture.align_mesh import LEAST_INLIERS, MOST_POINTS, check_fit, placements, unit_notes
from ..capture.color_camera import with_color_camera
from ..capture.depth_points import alignment_points
from ..capture.formats.registry import FORMATS, read_rig
from ..capture.images import read_radiance, threads_for
from ..capture.ingest import distinct_views
from ..capture.options import CaptureOptions
from ..capture.panorama import pinhole_views
from ..capture.views import View, load_capture
from ..conventions import transform_points
from ..device.variant import set_variant
from ..run.contents import Placement, Placements
from ..run.errors import FiptError
from ..run.kinds import as_matrix
from ..run.messages import Reporter
from ..run.run_files import read_room_files
from ..run.runfolder import RunFolder, write_json
from ..run.threads import in_threads

HOW = ("points", "near", "edges")
_ROUNDS = 3  # of tracing the edges again after the cameras have moved
_SEED = 0  # of the points that are drawn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("folder", type=Path, help="folder with capture.json, room.npz and room.json")
    parser.add_argument("how", choices=HOW, help="by the solve's points, from anywhere or near; by edges")
    parser.add_argument("--capture", type=Path, help="the capture whose camera solve holds the points")
    parser.add_argument("--format", choices=("auto", *FORMATS), default="auto", help="layout of the capture")
    parser.add_argument("--device", default="auto", help="auto, cuda or llvm")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Find the placement of the cameras and write FOLDER/align.json.

    Raises:
        FiptError: ``alignment-points``, ``-failed``, ``-edges``, ``mesh-mirrored``, or a reader's.
    """
    folder = RunFolder(arguments.folder)
    reporter.plan([1.0])
    reporter.stage("align", "Aligning the cameras to the mesh")
    views = list(load_capture(folder).views)
    if arguments.how == "edges":
        aligned = _by_edges(folder, views, arguments.device, reporter)
    else:
        if arguments.capture is None:
            raise FiptError("alignment-points", "No capture is given.", "Import the capture from its files.")
        points = solve_points(arguments.capture, arguments.format, views)
        aligned = _by_points(folder, views, points, arguments.how == "near", reporter)
    path = folder.root / "align.json"
    write_json(path, aligned)
    reporter.done([str(path)])


def solve_points(capture: Path, name: str, views: list[View]) -> np.ndarray:
    """The points (N, 3) of a solve or of depth images, in the world in which the cameras are now.

    Raises:
        FiptError: ``alignment-points`` or an error of the readers.
    """
    rig = read_rig(capture, name, CaptureOptions())
    if rig.one_camera:
        rig = with_color_camera(rig, 1.0)
    photographs = distinct_views(rig.views)
    poses = {view.name: view.camera_to_world for each in photographs for view in pinhole_views(each)}
    common = [view for view in views if view.name in poses]
    if len(common) < 2:
        raise FiptError(
            "alignment-points",
            f"{capture} holds other views than the scene.",
            "Import the capture again.",
        )
    now = np.array([view.camera_to_world for view in common], np.float64)
    return transform_points(
        similarity_of_poses(np.array([poses[view.name] for view in common]), now),
        alignment_points(capture, rig),
    )


def similarity_of_poses(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The similarity (4, 4) that maps poses (N, 4, 4) to others: rotation first, then scale and shift."""
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", target[:, :3, :3], source[:, :3, :3]))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    start, end = source[:, :3, 3] @ rotation.T, target[:, :3, 3]
    spread = np.linalg.norm(start - start.mean(axis=0))
    scale = float(np.linalg.norm(end - end.mean(axis=0)) / spread) if spread > 0.0 else 1.0
    result = np.eye(4)
    result[:3, :3] = scale * rotation
    result[:3, 3] = end.mean(axis=0) - scale * start.mean(axis=0)
    return result


def _by_points(
    folder: RunFolder, views: list[View], points: np.ndarray, near: bool, reporter: Reporter
) -> Placements:
    """Candidates from the points of the solve.

    Raises:
        FiptError: ``alignment-points``, ``alignment-failed`` or ``mesh-mirrored``.
    """
    rng = np.random.default_rng(_SEED)
    arrays, _ = read_room_files(folder)
    surface = sample_surface(arrays["vertices"], arrays["triangles"], rng)
    up = -np.mean([view.camera_to_world[:3, 1] for view in views], axis=0)
    if near:
        candidates = [refine(points[rng.permutation(len(points))[:MOST_POINTS]], surface, np.eye(4))]
        check_fit(candidates[0], "the mesh")
    else:
        candidates = placements(points, surface, rng, up, "the mesh")
    best = candidates[0]
    for note in unit_notes(surface, best.similarity, up):
        reporter.warning(note.code, note.text, note.remedy)
    text = (
        f"{100.0 * best.inliers:.0f}% of the points of the camera solve lie near the mesh, half of all within"
        f" {1000.0 * best.error:.3g} mm"
    )
    likely = (candidate for candidate in candidates if candidate.inliers >= LEAST_INLIERS)
    return Placements(
        tuple(Placement(as_matrix(each.similarity), each.error, each.inliers) for each in likely), text, {}
    )


def _by_edges(folder: RunFolder, views: list[View], device: str, reporter: Reporter) -> Placements:
    """Poses of all views after polishing by edges.

    Raises:
        FiptError: ``alignment-edges`` where too few views have edges, or nothing is gained.
    """
    set_variant(device)
    from ..surface.room import load_room
    from .misfit import edge_image, image_misfit  # Mitsuba's types exist only after the variant is set

    room = load_room(folder)
    most = threads_for(view.width * view.height for view in views)
    images = list(in_threads(lambda view: _read(view, edge_image), views, most))
    before: float | None = None
    alone: set[int] = set()
    best, least = views, np.inf
    for index in range(_ROUNDS + 1):
        misfits = [image_misfit(room, view, image) for view, image in zip(views, images, strict=True)]
        known = [item[0].misfit * item[1] for item in misfits if item is not None]
        misfit = float(np.median(known)) if known else np.inf
        before = misfit if before is None else before
        if misfit < least:
            best, least = views, misfit
        step = polish(
            [view.camera_to_world for view in views], [None if item is None else item[0] for item in misfits]
        )
        if step is None:
            break
        alone |= set(step.alone)
        views = [replace(view, camera_to_world=pose) for view, pose in zip(views, step.poses, strict=True)]
        reporter.progress((index + 1) / (_ROUNDS + 1))
    if before is None or not np.isfinite(before) or least >= before:
        raise FiptError(
            "alignment-edges",
            "The edges of mesh and photographs do not say how the cameras should move.",
            "Nothing was changed. If the mesh is far off, align by points or pairs first.",
        )
    text = (
        f"The edges are off by {least:.1f} pixels in the median view, before by {before:.1f};"
        f" {len(alone)} cameras were moved by themselves"
    )
    return Placements((), text, {view.name: as_matrix(view.camera_to_world) for view in best})


def _read(view: View, make: Callable[[View, np.ndarray], np.ndarray | None]) -> np.ndarray | None:
    """The result of `make` for the view's photograph (H, W, 3); None if the photograph can't be used."""
    try:
        pixels = read_radiance(view.image)
    except FiptError:
        return None
    return make(view, pixels) if pixels.shape[:2] == (view.height, view.width) else None
