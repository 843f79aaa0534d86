"""Engine command `align`: refines where the cameras of a capture are relative to the mesh of the scene.

The sparse points of the camera solve, or what depth images measure, are moved onto the mesh by ICP, after
pairs of points have placed them nearly right. Blender writes the input as for `survey` and moves the cameras.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import generate_binary_structure, maximum_filter, minimum_filter

from ..alignment.registration import refine
from ..alignment.surface import sample_surface
from ..capture.checks import judge_size
from ..capture.depth_images import check_unit, read_depth
from ..capture.formats.registry import FORMATS, read_points, read_rig
from ..capture.ingest import distinct_views
from ..capture.options import CaptureOptions
from ..capture.panorama import pinhole_views
from ..capture.rig import DepthView, Rig
from ..capture.views import View, load_capture
from ..conventions import similarity_of_poses, transform_points
from ..run.contents import Placement
from ..run.errors import FiptError
from ..run.kinds import as_matrix
from ..run.messages import Reporter
from ..run.run_files import read_room
from ..run.runfolder import RunFolder, write_json

MOST_POINTS = 4000  # more do not make the alignment better, only slower
LEAST_INLIERS = 0.6  # of the points near the mesh; a wrong alignment leaves fewer
_SEED = 0  # of the points that are drawn
_STEEP = 0.05  # relative difference between neighbouring depths above which a pixel lies at an edge


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("folder", type=Path, help="folder with capture.json, room.npz and room.json")
    parser.add_argument("capture", type=Path, help="the capture whose camera solve holds the points")
    parser.add_argument("--format", choices=("auto", *FORMATS), default="auto", help="layout of the capture")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Find the placement of the cameras and write FOLDER/align.json."""
    folder = RunFolder(arguments.folder)
    reporter.plan([1.0])
    reporter.stage("align", "Aligning the cameras to the mesh")
    points = solve_points(arguments.capture, arguments.format, list(load_capture(folder).views))
    rng = np.random.default_rng(_SEED)
    room = read_room(folder)
    surface = sample_surface(room.vertices, room.triangles, rng)
    found = refine(points[rng.permutation(len(points))[:MOST_POINTS]], surface)
    if found.inliers < LEAST_INLIERS:
        raise FiptError("alignment-failed", inliers=100.0 * found.inliers)
    if (note := judge_size(room.vertices)) is not None:
        reporter.warn(note)
    text = (
        f"{100.0 * found.inliers:.0f}% of the points of the camera solve lie near the mesh, half of all"
        f" within {1000.0 * found.error:.3g} mm"
    )
    path = folder.root / "align.json"
    write_json(path, Placement(as_matrix(found.similarity), text))
    reporter.done([str(path)])


def solve_points(capture: Path, name: str, views: list[View]) -> np.ndarray:
    """The points (N, 3) of a solve or of depth images, in the world in which the cameras are now."""
    rig = read_rig(capture, name, CaptureOptions())
    photographs = distinct_views(rig.views)
    poses = {view.name: view.camera_to_world for each in photographs for view in pinhole_views(each)}
    common = [view for view in views if view.name in poses]
    if len(common) < 2:
        raise FiptError("alignment-points.solve-points", capture=capture)
    now = np.array([view.camera_to_world for view in common], np.float64)
    return transform_points(
        similarity_of_poses(np.array([poses[view.name] for view in common]), now),
        alignment_points(capture, rig),
    )


def alignment_points(capture: Path, rig: Rig) -> np.ndarray:
    """Points (N, 3) in the coordinates of the rig."""
    if rig.depths and getattr(FORMATS[rig.source], "points", None) is None:
        return depth_points(rig.depths, np.random.default_rng(0))
    return read_points(capture, rig.source, sure=True)


def depth_points(views: Sequence[DepthView], rng: np.random.Generator) -> np.ndarray:
    """Points (N, 3) that some of the depth images measure, in metres and the coordinates of their poses.

    Pixels beside edges are left out, where depth cameras measure between both sides.
    """
    count = min(60, len(views))  # evenly spread; more do not make an alignment better
    chosen = [replace(views[index * len(views) // count], photograph=None) for index in range(count)]
    images = [read_depth(view, 1.0) for view in chosen]
    check_unit(images[:: max(1, count // 8)])
    points = []
    for image in images:
        positions = replace(image, depth=np.where(_inside(image.depth), image.depth, 0.0)).points()[0]
        points.append(positions[rng.permutation(len(positions))[:200]])
    found = np.concatenate(points)
    if not len(found):
        raise FiptError("depth-empty.depth-points")
    return found


def _inside(depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: measured, and so are the four neighbours, at similar depths."""
    cross = generate_binary_structure(2, 1)
    low, high = (each(depth, footprint=cross, mode="constant") for each in (minimum_filter, maximum_filter))
    return np.asarray((low > 0.0) & (np.maximum(high - depth, depth - low) <= _STEEP * depth))
