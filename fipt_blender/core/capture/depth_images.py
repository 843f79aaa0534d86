"""Depth images of captures (16-bit PNG or EXR), and the mesh that is fused from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np

from ..depth.cleaning import simplified, without_specks
from ..depth.extraction import FusedMesh, extract
from ..depth.gaps import gap_image
from ..depth.ply import write_ply
from ..depth.range_image import RangeImage
from ..depth.volume import BlockVolume
from ..run.errors import FiptError
from ..run.made import Made, file_state
from ..run.runfolder import RunFolder
from . import checks
from .distortion import lens_pinhole
from .encoded import srgb_encoded
from .files import stand_in
from .images import open_picture, read_size
from .options import CaptureOptions
from .photograph import Photograph
from .rig import DepthView, Pinhole, RigView

# Beyond this, depth cameras of phones and consoles measure little but noise.
FARTHEST = 8.0
# Medians outside of this are no distances in a room: the unit of the depth images is another one.
PLAUSIBLE_MEDIAN = (0.1, 20.0)
# Noise of depth cameras grows with the distance from about here, metres.
NEAR = 2.0
# Weight of measurements of which the camera is not confident: they count where nothing else was measured.
DOUBTFUL = 0.05
# Weight from which on a voxel is known. A count would leave out what one image alone shows, and surfaces that
# are seen at grazing angles, behind which measurements count little: 8 to 17 % of the pixels of real rooms.
LEAST_WEIGHT = 1e-3
# Edge of voxels, where none is given: in the pixels' spacing at their median distance; the smallest, metres.
SPACINGS, FINEST = 2.0, 0.02
# Units of 16-bit depths, metres: millimetres, TUM's, Replica's, tenths of millimetres, 1/256 m. In the right
# one images confirm this share of what others measure: 0.97 in two real rooms, in other units 0.81 at most.
UNITS, CONFIRMED = (1e-3, 1.0 / 5000.0, 1.0 / 6553.5, 1e-4, 1.0 / 256.0), 0.9
SPECK_VOXELS = 10.0  # pieces of less area than a square of this side are dropped


def checked_depths(views: Sequence[DepthView]) -> tuple[DepthView, ...]:
    """The views with poses of exact rotations."""
    for view in views:
        pinhole = Pinhole(view.width, view.height, view.fx, view.fy, view.cx, view.cy)
        checks.check_intrinsics(view.path.name, pinhole)
    return tuple(
        replace(view, camera_to_world=checks.nearest_rotation(view.path.name, view.camera_to_world))
        for view in views
    )


def read_depth(view: DepthView, scale: float) -> RangeImage:
    """The range image of one view, with the photograph's colors where it has one.

    Args:
        scale: metres per unit of the capture's coordinates; the result is in metres.
    """
    width, height = depth_size(view.path)  # before any pixel is read
    if (width, height) != (view.width, view.height):
        raise FiptError(
            "depth-size", path=view.path, width=width, height=height, width_2=view.width, height_2=view.height
        )
    depth = _stored(view.path) * np.float32(view.unit)
    depth = np.where(np.isfinite(depth) & (depth > 0.0) & (depth < FARTHEST), depth, 0.0)
    pose = view.camera_to_world.copy()
    pose[:3, 3] *= scale
    weight = _confidence(view.path, depth.shape) * (NEAR / np.maximum(depth, NEAR)) ** 2
    given = (view.fx, view.fy, view.cx, view.cy, pose, _colors(view, depth, scale))
    return RangeImage(depth.astype(np.float32), *given, weight.astype(np.float32))


def _confidence(path: Path, shape: tuple[int, ...]) -> np.ndarray | np.float32:
    """Weights (H, W) from `DOUBTFUL` to 1 by the confidence map beside a depth image; 1 without one."""
    for word in ("confidence", "conf"):
        file = path.parent.parent / word / path.name if path.parent.name.lower() == "depth" else path
        file = file if file != path else path.with_name(path.name.replace("depth", word))
        if file == path or not file.is_file():
            continue
        values = open_picture(file).data()[..., 0].astype(np.float32)
        if values.shape == shape:  # apps write 0 to 2, or 0 to 255
            return np.clip(values / (2.0 if values.max() <= 2.0 else 255.0), DOUBTFUL, 1.0)
    return np.float32(1.0)


def _stored(path: Path) -> np.ndarray:
    """(H, W) float32 values, 0 where nothing was measured."""
    try:
        picture = open_picture(path)
        values = picture.data()
    except FiptError as error:
        raise _unusable(path, error) from None
    if picture.kind == "exr":
        return np.nan_to_num(values[..., 0], nan=0.0, posinf=0.0, neginf=0.0)
    if picture.kind != "png" or values.shape[2] > 1 or values.dtype != np.uint16:
        raise _no_depth(path)
    return np.where(values == 65535, 0, values)[..., 0].astype(np.float32)  # both stand for no depth


def _unusable(path: Path, error: FiptError) -> FiptError:
    """The error for a depth image, instead of that for the same file as a photograph."""
    if error.code == "image-format":
        return _no_depth(path)
    return stand_in(path) or FiptError("depth-unreadable", path=path, text=error.text)


def _no_depth(path: Path) -> FiptError:
    return FiptError("depth-format", path=path)


def _colors(view: DepthView, depth: np.ndarray, scale: float) -> np.ndarray | None:
    """The photograph's colors at the depth image's pixels, as sRGB codes from 0 to 1."""
    photograph = view.photograph
    if photograph is None or not (picture := Photograph((photograph,)).picture).is_encoded:
        return None
    pixels = srgb_encoded(picture.shown()[0])
    from_depth = np.linalg.inv(photograph.camera_to_world) @ view.camera_to_world
    depth = np.where(depth > 0.0, depth, NEAR)  # also what is not measured has a color
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    local = (
        np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], axis=2)
        * depth[..., None]
    )
    local = local @ from_depth[:3, :3].T + from_depth[:3, 3] * scale
    lens = lens_pinhole(photograph.lens, photograph.width, photograph.height)  # nearly
    far = np.maximum(local[..., 2], 1e-3)
    column = np.clip(local[..., 0] / far * lens.fx + lens.cx, 0, photograph.width - 1).astype(np.int64)
    row = np.clip(local[..., 1] / far * lens.fy + lens.cy, 0, photograph.height - 1).astype(np.int64)
    return pixels[row, column]


def check_unit(images: Sequence[RangeImage]) -> None:
    """Refuse depths that can't be those of a room."""
    measured = [image.depth[image.depth > 0.0] for image in images]
    depths = np.concatenate([*measured, np.zeros(0, np.float32)])
    if not len(depths):
        raise FiptError("depth-empty.check-unit", farthest=FARTHEST)
    median = float(np.median(depths))
    if not PLAUSIBLE_MEDIAN[0] <= median <= PLAUSIBLE_MEDIAN[1]:
        raise FiptError("depth-unit.check-unit", median=median)


def _check_other_units(views: Sequence[DepthView], scale: float) -> None:
    """Refuse a unit in which the images contradict each other, where they agree in another usual one."""
    own = _confirmed(views, scale)
    if own >= CONFIRMED or views[0].unit == 1.0:  # metres of OpenEXR
        return
    shares = [_confirmed([replace(view, unit=unit) for view in views], scale) for unit in UNITS]
    best, unit = max(zip(shares, UNITS, strict=True))
    if best >= CONFIRMED:
        text = f"Depth images confirm {100.0 * own:.0f} % of what others measure, in steps of {unit:.4g} m"
        raise FiptError("depth-unit.check-other-units", text=text, best=100.0 * best, unit=unit)


def _confirmed(views: Sequence[DepthView], scale: float) -> float:
    """Share of measured points that other images measure, too, among these and those they look through."""
    images = [read_depth(replace(view, photograph=None), scale) for view in views]
    points = [image.points(8)[0] for image in images]
    same = through = 0
    for first, second in permutations(range(len(images)), 2):
        other = images[second]
        local = (points[first] - other.camera_to_world[:3, 3]) @ other.camera_to_world[:3, :3]
        depth = np.maximum(local[:, 2], 1e-3)
        column = np.floor(local[:, 0] / depth * other.fx + other.cx)
        row = np.floor(local[:, 1] / depth * other.fy + other.cy)
        height, width = other.depth.shape
        inside = (local[:, 2] > 1e-3) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        measured = other.depth[row[inside].astype(np.int64), column[inside].astype(np.int64)]
        share = measured / depth[inside]
        same += int((np.abs(share - 1.0) < 0.05).sum())
        through += int((share >= 1.05).sum())
    return same / max(same + through, 1)


def fuse(
    views: Sequence[DepthView], options: CaptureOptions, scale: float, progress: Callable[[float], None]
) -> FusedMesh:
    """The mesh of a capture's depth images, in the capture's coordinates.

    Args:
        scale: metres per unit of these.
        progress: called with the finished share.
    """
    some = [read_depth(view, scale) for view in views[:: max(1, len(views) // 8)]]
    check_unit(some)
    _check_other_units(views[:: max(1, len(views) // 8)], scale)
    voxel = options.voxel or max(FINEST, SPACINGS * pixel_spacing(some))
    with_color = any(view.photograph and Photograph((view.photograph,)).picture.is_encoded for view in views)
    volume, gaps = BlockVolume(voxel, with_color), BlockVolume(voxel, with_color)
    for index, view in enumerate(views):
        gaps.integrate(gap_image(read_depth(view, scale)))
        progress(0.5 * (index + 1) / (len(views) + 1))
    volume.allocate(gaps.keys)  # so that it is known which of them images look through
    for index, view in enumerate(views):
        volume.integrate(read_depth(view, scale))
        progress(0.5 + 0.5 * (index + 1) / (len(views) + 1))
    volume.adopt(gaps)
    mesh = without_specks(extract(volume, LEAST_WEIGHT), (SPECK_VOXELS * voxel) ** 2)
    if not len(mesh.triangles):
        raise FiptError("depth-empty.fuse")
    if options.triangles:
        mesh = simplified(mesh, options.triangles)
    progress(1.0)
    return FusedMesh(mesh.vertices / np.float32(scale), mesh.triangles, mesh.colors)


def pixel_spacing(images: Sequence[RangeImage]) -> float:
    """Median distance in metres between the points that neighbouring pixels measure."""
    spacings = [image.depth[image.depth > 0.0] / min(image.fx, image.fy) for image in images]
    return float(np.median(np.concatenate(spacings)))


def write_fused(
    run: RunFolder, views: Sequence[DepthView], options: CaptureOptions, progress: Callable[[float], None]
) -> Path:
    """The mesh file of a capture's depth images in its run folder, fused anew where they have changed."""
    facts = []
    for view in views:
        states = [file_state(view.path)]
        camera = [view.unit, view.fx, view.fy, view.cx, view.cy, *view.camera_to_world.ravel().tolist()]
        if (photograph := view.photograph) is not None:
            states.append(file_state(photograph.image))
            camera += [*photograph.lens.parameters, *photograph.camera_to_world.ravel().tolist()]
        facts.append([states, camera])
    chosen = options.voxel, options.triangles, options.scale
    made = Made(run, "fused", chosen, facts, outputs=[run.fused_ply])
    if made.kept() is None:
        with made.making():
            write_ply(run.fused_ply, fuse(views, options, options.scale, progress))
    return run.fused_ply


def depth_size(path: Path) -> tuple[int, int]:
    """Width and height of a depth image."""
    try:
        return read_size(path)
    except FiptError as error:
        raise _unusable(path, error) from None


def registered_depths(
    views: Sequence[RigView], paths: Sequence[Path | None], unit: float
) -> tuple[DepthView, ...]:
    """The depth images that exist; they have the camera and field of view of a photograph, and other sizes.

    Args:
        views: with pinhole lenses; their photographs need not exist.
        paths: for each view, None where it has none.
        unit: metres per stored unit; EXR files always hold metres.
    """
    found = []
    for view, path in zip(views, paths, strict=True):
        if path is not None:
            width, height = depth_size(path)
            x, y = width / view.width, height / view.height
            fx, fy, cx, cy = view.lens.parameters
            own, photograph = 1.0 if path.suffix.lower() == ".exr" else unit, None if view.missing else view
            camera = (fx * x, fy * y, cx * x, cy * y, own, view.camera_to_world)
            found.append(DepthView(path, width, height, *camera, photograph))
    return tuple(found)
