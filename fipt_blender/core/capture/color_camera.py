# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The color camera of RGB-D frames whose photographs were assumed to have the depth camera's intrinsics.

Most depth cameras have a second lens for color, beside the first one and of another focal length. All frames
share it. It is found from what several photographs show of the same measured points, which agree at the right
camera (Gauss-Newton on the robust variance of each point over its photographs, from coarse to fine).

A shift of the principal point and one of the camera hardly differ where all depths are alike, so that small
errors of the poses could make any sum of both. Therefore each photograph counts as one measurement, whose
points share the error of its pose, beside what is usual for such cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from ..robust import LEAST_VIEWS, without_means
from ..run.errors import Problem
from .depth_images import read_depth
from .images import read_radiance
from .rig import DepthView, Lens, Rig, RigView

MOST_FRAMES = 64  # more only cost time
WIDTH = 320  # pixels to which photographs are reduced
BLURS = ((8.0, 12), (4.0, 10), (2.0, 8), (1.0, 6))  # pixels of that width, and steps
SCALE = 0.5  # of robust residuals, in standard deviations of a photograph's details
DARKEST = 0.1  # of a photograph's median, added below the logarithm: what is darker is mostly noise
# Expected sizes of the parameters: logarithm of the ratio of focal lengths, pixels, metres.
EXPECTED = np.array([0.1, 5.0, 5.0, 0.03, 0.03])
NAMES = ("focal length", "image centre", "image centre", "place", "place")
# A parameter whose standard error is more than this share of its expected size is said to be unsettled.
UNSETTLED = 0.5
# Where the fit starts: the depth camera, and cameras of wider view to either side of it, as they are built.
STARTS = np.array([[0.0, 0.0, 0.0, 0.0, 0.0], [-0.1, 0.0, 0.0, -0.025, 0.0], [-0.1, 0.0, 0.0, 0.025, 0.0]])
# The depths of a point and of the depth image where it is seen differ less: metres, and share of the depth.
VISIBLE = (0.03, 0.01)
# The camera is changed where the photographs agree clearly better with the new one.
CLEARLY_BETTER = 0.9


@dataclass(frozen=True)
class ColorCamera:
    """How the color camera differs from the depth camera.

    Attributes:
        log_focal: logarithm of the ratio of focal lengths.
        shift_x, shift_y: of the principal point, pixels of a photograph `WIDTH` pixels wide.
        x, y: metres from the depth camera's points to their places before the color camera.
        agreement: robust disagreement of the photographs, relative to that with the depth camera.
        unsettled: names of what the photographs hardly determine; it is what is usual.
    """

    log_focal: float
    shift_x: float
    shift_y: float
    x: float
    y: float
    agreement: float
    unsettled: tuple[str, ...] = ()

    def view(self, view: RigView, scale: float) -> RigView:
        """A view with the color camera in place of the depth camera.

        Args:
            scale: metres per unit of the capture's coordinates.
        """
        fx, fy, cx, cy = view.lens.parameters
        ratio, pixel = float(np.exp(self.log_focal)), view.width / WIDTH
        lens = (fx * ratio, fy * ratio, cx + self.shift_x * pixel, cy + self.shift_y * pixel)
        pose = view.camera_to_world.copy()
        pose[:3, 3] -= pose[:3, :2] @ np.array([self.x, self.y]) / scale
        return replace(view, lens=Lens("PINHOLE", lens), camera_to_world=pose)


def with_color_camera(rig: Rig, scale: float) -> Rig:
    """The rig with the color camera of its photographs, and a note of it; unchanged where none fits better.

    Args:
        rig: whose photographs have the depth images' cameras.
        scale: metres per unit of the capture's coordinates.

    Raises:
        FiptError: an image can't be read.
    """
    frames = [depth for depth in rig.depths if depth.photograph is not None]
    frames = frames[:: -(-len(frames) // MOST_FRAMES) or 1]
    camera = find_color_camera(frames, scale)
    if camera is None or camera.agreement > CLEARLY_BETTER:
        return rig
    moved = {view.image: camera.view(view, scale) for view in rig.views}
    depths = tuple(
        depth if depth.photograph is None else replace(depth, photograph=moved[depth.photograph.image])
        for depth in rig.depths
    )
    text = (
        f"The photographs' camera is not that of the depth images: its focal length is "
        f"{np.exp(camera.log_focal):.3f} of theirs, and it is {1000.0 * np.hypot(camera.x, camera.y):.0f} mm"
        f" beside them. The photographs agree to {1.0 / camera.agreement:.1f} times as well with it."
    )
    remedy = "Nothing needs to be done. Check with Check Views that edges fit."
    if camera.unsettled:
        text += f" They hardly determine its {' and '.join(camera.unsettled)}, which are near the usual ones."
        remedy = "Give the color camera's own matrix, if it is known, or frames with near and far things."
    note = Problem("color-camera", text, remedy)
    return replace(
        rig, views=tuple(moved[view.image] for view in rig.views), depths=depths, notes=(*rig.notes, note)
    )


@dataclass(frozen=True, eq=False)
class Sightings:
    """Points that depth images show to be visible from frames.

    Attributes:
        point: (N,) of each sighting.
        frame: (N,).
        place: (N, 3) in the frame's depth camera, metres.
        count: number of points.
    """

    point: np.ndarray
    frame: np.ndarray
    place: np.ndarray
    count: int


def find_color_camera(frames: Sequence[DepthView], scale: float) -> ColorCamera | None:
    """The color camera of some frames, or None where too few points are seen by several.

    Args:
        frames: with photographs.
        scale: metres per unit of the capture's coordinates.
    """
    shown = shown_points(frames, scale)
    first = frames[0].photograph if frames else None
    if shown is None or first is None:
        return None
    sightings, reduced = shown
    fx, fy, cx, cy = (value * reduced[0].shape[1] / first.width for value in first.lens.parameters)
    camera = np.array([fx, fy, cx, cy])
    candidates = STARTS
    for blur, steps in BLURS:
        images = np.stack([gradients(details(image, blur)) for image in reduced])
        for _ in range(steps):
            candidates = np.array([_step(each, images, sightings, camera).better for each in candidates])
        if len(candidates) > 1:  # the coarsest photographs decide between the starts
            unlikely = [_step(each, images, sightings, camera).unlikely for each in candidates]
            candidates = candidates[[int(np.argmin(unlikely))]]
    found = candidates[0]
    last, start = (_step(values, images, sightings, camera) for values in (found, np.zeros(5)))
    unsettled = [name for name, error in zip(NAMES, last.error / EXPECTED, strict=True) if error > UNSETTLED]
    log_focal, shift_x, shift_y, x, y = (float(value) for value in found)
    agreement = last.cost / max(start.cost, 1e-12)
    return ColorCamera(log_focal, shift_x, shift_y, x, y, agreement, tuple(dict.fromkeys(unsettled)))


def shown_points(frames: Sequence[DepthView], scale: float) -> tuple[Sightings, list[np.ndarray]] | None:
    """Measured points that frames see, and their reduced photographs.

    None where too few points are seen by several frames, or the photographs differ in size.

    Args:
        frames: with photographs.
        scale: metres per unit of the capture's coordinates.
    """
    if len(frames) < LEAST_VIEWS:
        return None
    sightings = _find_sightings(frames, scale)
    if len(sightings.point) < LEAST_VIEWS * 1000:
        return None
    reduced = [_reduced_photograph(frame) for frame in frames]
    return None if any(image.shape != reduced[0].shape for image in reduced) else (sightings, reduced)


def _find_sightings(frames: Sequence[DepthView], scale: float) -> Sightings:
    ranges = [read_depth(replace(frame, photograph=None), scale) for frame in frames]
    rng = np.random.default_rng(0)
    chosen = []
    for image in ranges:
        points = image.points(4)[0]
        chosen.append(points[rng.permutation(len(points))[: 30_000 // len(frames)]])
    points = np.concatenate(chosen)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for image in ranges:
        local = (points - image.camera_to_world[:3, 3]) @ image.camera_to_world[:3, :3]
        depth = np.maximum(local[:, 2], 1e-3)
        column = np.floor(local[:, 0] / depth * image.fx + image.cx).astype(np.int64)
        row = np.floor(local[:, 1] / depth * image.fy + image.cy).astype(np.int64)
        height, width = image.depth.shape
        inside = (local[:, 2] > 1e-3) & (column >= 2) & (column < width - 2) & (row >= 2) & (row < height - 2)
        index = np.flatnonzero(inside)
        visible = np.ones(len(index), bool)
        # Also around the place: near depth edges another camera may see another surface.
        for x, y in ((0, 0), (2, 0), (-2, 0), (0, 2), (0, -2)):
            difference = np.abs(image.depth[row[index] + y, column[index] + x] - depth[index])
            visible &= difference < VISIBLE[0] + VISIBLE[1] * depth[index]
        found.append((index[visible], local[index[visible]]))
    frame = np.repeat(np.arange(len(frames)), [len(index) for index, _ in found])
    point, place = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return Sightings(point, frame, place, len(points))


def _reduced_photograph(frame: DepthView) -> np.ndarray:
    """(H, W) logarithm of a photograph's gray values, `WIDTH` pixels wide."""
    view = frame.photograph
    assert view is not None
    gray = read_radiance(view.image, view.layer).mean(axis=2)
    size = (WIDTH, max(1, round(view.height * WIDTH / view.width)))
    reduced = np.asarray(Image.fromarray(gray.astype(np.float32), "F").resize(size, Image.Resampling.BOX))
    floor = max(DARKEST * float(np.median(reduced)), 1e-12)
    return np.asarray(np.log(np.maximum(reduced, 0.0) + floor))


def details(logarithm: np.ndarray, blur: float) -> np.ndarray:
    """(H, W) details of a photograph at one scale in units of their local size: exposures have no effect."""
    found = gaussian_filter(logarithm, blur) - gaussian_filter(logarithm, 4.0 * blur + 10.0)
    local = np.sqrt(gaussian_filter(found**2, 25.0)) + 0.05
    return np.asarray(found / local, np.float32)


def gradients(image: np.ndarray) -> np.ndarray:
    """(3, H, W): the image and its derivatives along x and y."""
    return np.stack([image, np.gradient(image, axis=1), np.gradient(image, axis=0)]).astype(np.float32)


class _Step(NamedTuple):
    """A step of Gauss-Newton from some parameters (log focal, shift x, y, offset x, y)."""

    better: np.ndarray  # (5,) the parameters after it
    error: np.ndarray  # (5,) standard errors of the parameters
    cost: float  # disagreement of the photographs at the parameters before it
    unlikely: float  # negative logarithm of the posterior of these, up to a constant


def _step(found: np.ndarray, images: np.ndarray, sightings: Sightings, camera: np.ndarray) -> _Step:
    """A step from parameters (5,).

    Args:
        images: (frames, 3, H, W) of `gradients`.
        camera: fx, fy, cx, cy of the depth camera in their pixels.
    """
    ratio, depth = np.exp(found[0]), sightings.place[:, 2]
    fx, fy = camera[0] * ratio, camera[1] * ratio
    from_x, from_y = (sightings.place[:, axis] + found[3 + axis] for axis in (0, 1))
    x, y = fx * from_x / depth, fy * from_y / depth
    where = np.stack([x + camera[2] + found[1], y + camera[3] + found[2]], axis=1)
    inside, (value, along_x, along_y) = sampled(images, sightings.frame, where)
    slopes = [along_x * x + along_y * y, along_x, along_y, along_x * fx / depth, along_y * fy / depth]

    residual, weight, cost = disagreement(value, inside, sightings)
    jacobian = np.stack([without_means(slope, sightings.point, weight) for slope in slopes], axis=1)
    # The logarithm of the likelihood is that of the cost, half of it for each photograph.
    frames, used = len(images), max(np.count_nonzero(weight), 1)
    unit = max(cost, 1e-12) * SCALE**2 * used / frames
    prior = np.diag(unit / EXPECTED**2)
    normal = (jacobian * weight[:, None]).T @ jacobian + prior
    change = np.linalg.solve(normal, (jacobian * weight[:, None]).T @ residual + prior @ found)
    error = np.sqrt(unit * np.diag(np.linalg.inv(normal)))
    unlikely = 0.5 * (frames * np.log(max(cost, 1e-12)) + float(((found / EXPECTED) ** 2).sum()))
    return _Step(found - change, error, cost, unlikely)


def sampled(images: np.ndarray, frame: np.ndarray, where: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Images at places between their pixels.

    Args:
        images: (frames, 3, H, W) of `gradients`.
        frame: (N,) image of each place.
        where: (N, 2) x, y in pixels; the center of the first pixel is (0.5, 0.5).

    Returns:
        (N,) bool, whether a place is in its image, and (N,) values, slopes along x and along y.
    """
    height, width = images.shape[2:]
    column, row = where.T - 0.5
    inside = (column >= 0) & (row >= 0) & (column < width - 1) & (row < height - 1)
    left = np.clip(np.where(inside, column, 0.0).astype(np.int64), 0, width - 2)
    top = np.clip(np.where(inside, row, 0.0).astype(np.int64), 0, height - 2)
    right, down = np.where(inside, column - left, 0.0), np.where(inside, row - top, 0.0)
    return inside, [
        images[frame, kind, top, left] * (1.0 - right) * (1.0 - down)
        + images[frame, kind, top, left + 1] * right * (1.0 - down)
        + images[frame, kind, top + 1, left] * (1.0 - right) * down
        + images[frame, kind, top + 1, left + 1] * right * down
        for kind in range(3)
    ]


def disagreement(
    value: np.ndarray, inside: np.ndarray, sightings: Sightings
) -> tuple[np.ndarray, np.ndarray, float]:
    """How the photographs of a point differ from their mean.

    Args:
        value: (N,) of each sighting. inside: (N,) bool, whether it is in its photograph.

    Returns:
        (N,) residuals, (N,) robust weights, 0 where too few photographs show the point, and their mean cost.
    """
    seen = np.bincount(sightings.point, inside, sightings.count)
    used = (inside & (seen[sightings.point] >= LEAST_VIEWS)).astype(np.float64)
    residual = without_means(value, sightings.point, used)
    weight = used / (1.0 + (residual / SCALE) ** 2)
    residual = without_means(value, sightings.point, weight)
    cost = float((used * np.log1p((residual / SCALE) ** 2)).sum() / max(float(used.sum()), 1.0))
    return residual, weight, cost
