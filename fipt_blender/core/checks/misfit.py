# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""By how many pixels the mesh is displaced in a view: its edges are compared with those of the photograph."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..pixels.camera_rays import opaque_vector, trace_pixels
from ..surface.room import Room
from .edges import MeshEdges, edge_misfit, mesh_edges

TRACED = 960  # least number of pixels that are traced along the longer side; at most twice as many are
COMPARED = 1280  # most pixels along the longer side of the photograph that is compared
_SEED = 0  # of the edges that are drawn


def edge_image(view: View, pixels: np.ndarray) -> np.ndarray | None:
    """(h, w) logarithm of a photograph (H, W, 3), reduced by an integer factor; None where it is black."""
    factor = _factor(view)
    height, width = view.height // factor, view.width // factor
    # Rows first: numpy is slow along short axes, as those of the channels and of the columns of a block are.
    rows = pixels[: height * factor].reshape(height, factor, -1).mean(axis=1, dtype=np.float64)
    blocks = rows.reshape(height, -1, 3)[:, : width * factor].reshape(height, width, -1)
    gray = np.maximum(blocks.mean(axis=2), 0.0)
    lit = gray[gray > 0.0]
    if not lit.size:
        return None
    return np.log(gray + 1e-2 * float(np.median(lit)))


def image_misfit(room: Room, view: View, image: np.ndarray | None) -> tuple[float, int] | None:
    """Compare the mesh's edges with those of a photograph; None without a verdict.

    Args:
        room: the mesh.
        view: the camera.
        image: of its photograph, by `edge_image`.

    Returns:
        The displacement in pixels of the photograph reduced by an integer factor, and this factor.
    """
    if image is None:
        return None
    factor = _factor(view)
    intrinsics = np.diag([1.0 / factor, 1.0 / factor, 1.0]) @ view.intrinsics
    misfit = edge_misfit(image, view_edges(room, view).over(factor), intrinsics)
    return None if misfit is None else (misfit, factor)


def _factor(view: View) -> int:
    """The integer factor by which a view's photograph is reduced."""
    return -(-max(view.width, view.height) // COMPARED)


def view_edges(room: Room, view: View) -> MeshEdges:
    """The mesh's edges in a view, in pixels of its photograph."""
    scale: float = max(round(TRACED / max(view.width, view.height)), 1)
    if max(view.width, view.height) > 2 * TRACED:
        scale = TRACED / max(view.width, view.height)
    width, height = round(view.width * scale), round(view.height * scale)
    surface = trace_pixels(room, view.resized(width, height))
    pose = np.asarray(view.camera_to_world, np.float64)
    axes = [opaque_vector(mi.Vector3f, pose[:3, axis]) for axis in range(3)]
    toward = surface.position - opaque_vector(mi.Point3f, pose[:3, 3])
    point = mi.Vector3f(*(dr.select(surface.valid, dr.dot(toward, axis), 0.0) for axis in axes))
    normal = mi.Vector3f(*(dr.dot(surface.normal, axis) for axis in axes))
    dr.eval(surface.valid, point, normal)  # together, or each would trace the rays again
    valid, points, normals = np.array(surface.valid), np.array(point).T, np.array(normal).T
    shape = (height, width)
    edges = mesh_edges(
        points.reshape(*shape, 3),
        normals.reshape(*shape, 3),
        valid.reshape(shape),
        np.random.default_rng(_SEED),
    )
    return edges.over(width / view.width)
