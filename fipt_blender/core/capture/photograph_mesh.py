# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh of a room from its photographs alone, where there is neither a mesh nor a depth image.

Range images by stereo (:mod:`..depth.stereo`) are fused. Where that leaves nothing, mostly on blank walls,
the room's hull takes its place: the half-spaces that hold nearly all points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter

from ..depth.cleaning import without_specks
from ..depth.extraction import FusedMesh, extract
from ..depth.hull import Hull
from ..depth.range_image import RangeImage
from ..depth.stereo import Shot, range_images
from ..depth.volume import BlockVolume
from ..run.errors import FiptError
from .averaging import means
from .encoded import srgb_encoded
from .images import is_encoded, read_radiance
from .rig import Note, Pinhole

PIXELS = 36_000  # of each photograph that are compared; the time grows with them
MOST_PHOTOGRAPHS = 150  # evenly spread; more hardly show anything new
VOXEL = 2.0  # pixels' widths in the median distance
SPECK = 10.0  # voxels, side of a square; smaller pieces are dropped
LEAST_SEEN = 2.0  # range images that show a surface
# Percentiles of the solved points' depths in a view, and factors on them, between which surfaces are sought.
REACH, NEARER, FARTHER = (1.0, 99.0), 0.7, 1.3
# Without points: multiples of the largest distance between cameras.
NEAR_CAMERAS, FAR_CAMERAS = 0.25, 10.0
SPARSE = 16  # every so manieth vertex or triangle, where all are more than are needed
WIDEST = 12  # pixels, of a vertex that is near
FEW_POINTS = 20  # that a view shows; with fewer, all points' distances count
GAMMA = 1.0 / 2.2  # of HDR photographs' display values
MIDDLE = 0.18  # display value, before gamma, of a photograph's median
MADE = (
    "The room's mesh was made from {count} photographs alone: of their pixels, {seen:.0f} % have a surface"
    " that others show; the rest is the room's hull. Edges are rough and small things are missing."
)
REMEDY = (
    "Better results need a better mesh: a scan by a phone with LiDAR, or one that RealityScan, Metashape or"
    " Meshroom makes of more photographs (--mesh)."
)


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph without distortion: its file, layer, camera and (4, 4) camera to world, OpenCV axes."""

    path: Path
    layer: str
    pinhole: Pinhole
    camera_to_world: np.ndarray

    def shot(self) -> Shot:
        """It with about `PIXELS`.

        Raises:
            FiptError: those of `read_radiance`.
        """
        image, hole = read_radiance(self.path, self.layer), self.pinhole
        height, width = image.shape[:2]
        shrink = min(1.0, (PIXELS / (width * height)) ** 0.5)
        small = means(image, max(1, round(width * shrink)), max(1, round(height * shrink)))
        if is_encoded(self.path):
            shown = srgb_encoded(small)
        else:
            middle = max(float(np.median(small)), 1e-12)
            shown = np.clip(small * (MIDDLE / middle), 0.0, 1.0) ** GAMMA
        x, y = small.shape[1] / hole.width, small.shape[0] / hole.height
        camera = hole.fx * x, hole.fy * y, hole.cx * x, hole.cy * y
        return Shot(shown.mean(axis=2), *camera, self.camera_to_world, shown.astype(np.float32))


def photograph_mesh(
    photographs: Sequence[Photograph],
    points: np.ndarray,
    progress: Callable[[float], None],
) -> tuple[FusedMesh, Note]:
    """The mesh in the cameras' coordinates, and what to say of it.

    Args:
        points: (N, 3) of the solve, in these coordinates; may be none.

    Raises:
        FiptError: ``mesh-impossible``; those of `read_radiance`.
    """
    photographs = photographs[:: -(-len(photographs) // MOST_PHOTOGRAPHS)]
    shots = [photograph.shot() for photograph in photographs]
    images = range_images(shots, _reaches(shots, points), progress)
    depths = np.concatenate([image.depth[image.depth > 0.0] for image in images])
    if not len(depths):
        raise FiptError(
            "mesh-impossible",
            "The photographs show no surface from several sides: no mesh can be made of them.",
            "Take photographs that overlap, from places that are apart, or give a mesh (--mesh).",
        )
    voxel = VOXEL * float(np.median(depths)) / float(np.median([image.fx for image in images]))
    seen = without_specks(_fused(images, voxel, LEAST_SEEN), (SPECK * voxel) ** 2)
    covered = [_covered(shot, seen) for shot in shots]
    centres = np.array([shot.camera_to_world[:3, 3] for shot in shots])
    hull = Hull.around(seen.vertices, _normals(seen), centres)
    rest = _fused([_behind(*pair, hull) for pair in zip(shots, covered, strict=True)], voxel, 1.0)
    share = 100.0 * float(np.mean([each.mean() for each in covered]))
    text = MADE.format(count=len(photographs), seen=share)
    return seen.joined(rest), Note("mesh-from-photographs", text, REMEDY)


def _fused(images: Sequence[RangeImage], voxel: float, least_seen: float) -> FusedMesh:
    volume = BlockVolume(voxel, True)
    for image in images:
        volume.integrate(image)
    return extract(volume, least_seen)


def _normals(mesh: FusedMesh) -> np.ndarray:
    """(N, 3) unit normals of some triangles."""
    corners = mesh.vertices[mesh.triangles[::SPARSE]].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return np.asarray(cross[length > 0.0] / length[length > 0.0, None])


def _covered(shot: Shot, mesh: FusedMesh) -> np.ndarray:
    """(H, W) bool, whether a pixel shows the mesh at any distance: vertices as wide as edges are long."""
    covered = np.zeros(shot.gray.shape, bool)
    if not len(mesh.triangles):
        return covered
    ends = mesh.vertices[mesh.triangles[::SPARSE, :2]]
    edge = float(np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)))
    local = (mesh.vertices - shot.camera_to_world[:3, 3]) @ shot.camera_to_world[:3, :3]
    local = local[local[:, 2] > edge]
    row, column = np.rint(shot.pixels(local.T)).astype(np.int64)
    radius = np.minimum(np.ceil(shot.fx * edge / local[:, 2]), WIDEST).astype(np.int64)
    inside = (row >= 0) & (row < covered.shape[0]) & (column >= 0) & (column < covered.shape[1])
    for size in np.unique(radius[inside]):
        chosen = inside & (radius == size)
        marks = np.zeros_like(covered)
        marks[row[chosen], column[chosen]] = True
        covered |= maximum_filter(marks, 2 * int(size) + 1)
    return covered


def _behind(shot: Shot, covered: np.ndarray, hull: Hull) -> RangeImage:
    """The hull's distances in the other pixels."""
    pose = shot.camera_to_world
    depth = np.where(covered, 0.0, hull.depth(pose[:3, 3], np.tensordot(pose[:3, :3], shot.rays, 1)))
    return RangeImage(depth.astype(np.float32), shot.fx, shot.fy, shot.cx, shot.cy, pose, shot.color)


def _reaches(shots: Sequence[Shot], points: np.ndarray) -> list[tuple[float, float]]:
    """The nearest and farthest depth that each shot may show."""
    centres = np.array([shot.camera_to_world[:3, 3] for shot in shots])
    apart = max(float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()) * 2.0, 1e-6)
    found = []
    for shot in shots:
        depths = np.zeros(0)
        if len(points):
            local = (points - shot.camera_to_world[:3, 3]) @ shot.camera_to_world[:3, :3]
            local = local[local[:, 2] > 1e-6]
            row, column = shot.pixels(local.T)
            inside = (row >= 0) & (row < shot.gray.shape[0]) & (column >= 0) & (column < shot.gray.shape[1])
            depths = local[inside, 2] if inside.sum() >= FEW_POINTS else local[:, 2]
        if len(depths):
            near, far = np.percentile(depths, REACH)
            found.append((NEARER * float(near), FARTHER * float(far)))
        else:
            found.append((NEAR_CAMERAS * apart, FAR_CAMERAS * apart))
    return found
