"""Checks of a capture: errors and warnings about poses, intrinsics and pixels.

Nothing here writes files; `ingest` runs all checks before it writes anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from ..run.errors import FiptError, Problem, problem
from ..run.shapes import FARTHEST
from .encoded import srgb_encoded
from .rig import Pinhole

CLIPPED_SHARE = 5e-4  # of the sampled values, at the highest one
CLIPPED_TOLERANCE = 4e-3  # a few steps of half floats: the pixels of a uniform lamp differ by as much
# Heights and widths of rooms, metres, outside of which the unit is doubted: closets to halls.
HEIGHTS, WIDTHS = (1.6, 6.0), (1.0, 40.0)
USUAL_HEIGHT = 2.5
OUTLIERS = 2.0  # percent of the points at either end that do not count
# Focal lengths over an image's longer side: views of 179 degrees, and lenses of 3.6 m on 36 mm film.
FOCAL_LENGTHS = (0.01, 100.0)


def nearest_rotation(name: str, pose: np.ndarray) -> np.ndarray:
    """The pose (4, 4) with its rotation made exactly orthonormal."""
    remedy = "Export the camera poses without scale."
    if not np.isfinite(pose).all():
        reason, remedy = "contains NaN or infinity", "Leave the view out, or export the camera poses again."
    elif np.linalg.det(pose[:3, :3]) < 0.0:
        reason = "is mirrored (its determinant is negative)"
        remedy = "Its axes are left-handed, as of Unity and Unreal: export cameras and mesh right-handed."
    elif (error := float(np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max())) > 1e-3:
        reason = f"is scaled or sheared (off by {error:.2g})"
    else:
        u, _, vt = np.linalg.svd(pose[:3, :3])
        result = np.eye(4)
        result[:3, :3] = u @ vt
        result[:3, 3] = pose[:3, 3]
        return result
    raise FiptError("pose-not-rotation.nearest-rotation", name=name, reason=reason, remedy=remedy)


def check_intrinsics(name: str, pinhole: Pinhole) -> None:
    """Refuse intrinsics that no photograph has.

    Args:
        name: of the view, for the error.
    """
    width, height, fx, fy, cx, cy = astuple(pinhole)
    finite = np.isfinite([fx, fy, cx, cy]).all()
    near = -0.5 * width <= cx <= 1.5 * width and -0.5 * height <= cy <= 1.5 * height
    least, most = (share * max(width, height) for share in FOCAL_LENGTHS)
    focal = finite and least <= fx <= most and least <= fy <= most
    if width < 1 or height < 1 or not focal or not near:
        raise FiptError(
            "intrinsics-invalid", name=name, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy
        )


def check_view(name: str, pinhole: Pinhole, camera_to_world: np.ndarray) -> None:
    """Check a view as capture.json has it, after all conversions, in whatever way it has come there.

    Args:
        name: of the view.
        pinhole: size and intrinsics without distortion.
        camera_to_world: (4, 4) pose in Blender's world.
    """
    check_intrinsics(name, pinhole)
    distance = float(np.abs(nearest_rotation(name, camera_to_world)[:3, 3]).max())
    if distance > FARTHEST:
        raise FiptError("pose-far", name=name, distance=distance, farthest=FARTHEST)


@dataclass(frozen=True)
class PixelStatistics:
    """Statistics of one photograph's values."""

    minimum: float  # lowest value
    median: float  # median of the positive values, 0 where there are none
    looks_ldr: bool  # all values are 8-bit steps between 0 and 1, linear or sRGB-encoded
    clipped: float  # share of pixels at the highest value, 0 unless that looks like a sensor's limit
    transparent: float = 0.0  # share of pixels whose alpha is 0


def pixel_statistics(path: Path, pixels: np.ndarray) -> PixelStatistics:
    """Statistics of one photograph (height, width, 3) float32."""
    minimum = float(pixels.min())
    maximum = float(pixels.max())
    if not (np.isfinite(minimum) and np.isfinite(maximum)):  # both are NaN where any value is
        bad = ~np.isfinite(pixels).all(axis=-1)
        y, x = (int(index[0]) for index in np.nonzero(bad))
        raise FiptError("image-not-finite", path=path, sum=int(bad.sum()), x=x, y=y)
    sample = pixel_sample(pixels)
    positive = sample[sample > 0.0]
    return PixelStatistics(
        minimum=minimum,
        median=float(np.median(positive)) if positive.size else 0.0,
        looks_ldr=maximum > 0.0 and _is_8bit(sample),
        clipped=_clipped_share(sample),
    )


def pixel_sample(pixels: np.ndarray) -> np.ndarray:
    """(N, 3) values of at most 65,536 pixels all over a photograph (height, width, 3)."""
    flat = pixels.reshape(-1, 3)
    return np.ascontiguousarray(flat[:: -(-len(flat) // 65536)])


def _is_8bit(values: np.ndarray) -> bool:
    """Whether all values lie in [0, 1] on the 255 steps of an 8-bit image, linear or sRGB-decoded."""
    if values.min() < 0.0 or values.max() > 1.0:
        return False
    for steps in (255.0 * values, 255.0 * srgb_encoded(values)):
        # Half floats deviate from a step by up to 2^-11 of their value.
        if (np.abs(steps - np.round(steps)) <= 1e-3 + steps * 2.0**-11).all():
            return True
    return False


def _clipped_share(sample: np.ndarray) -> float:
    """Share of pixels (N, 3) at the sensor's limit, 0 where the highest values are not such a limit.

    Where a sensor clips, the channels reach their limit one after the other towards a highlight. Where a lamp
    of uniform radiance is seen directly, all channels have their highest values in the same pixels.
    """
    highest = sample.max(axis=0)
    at_limit = (sample == highest).any(axis=1).sum()
    if at_limit < max(16, CLIPPED_SHARE * len(sample)):
        return 0.0
    near = sample >= highest * (1.0 - CLIPPED_TOLERANCE)
    any_near, all_near = int(near.any(axis=1).sum()), int(near.all(axis=1).sum())
    return float(at_limit) / len(sample) if any_near - all_near >= 0.05 * any_near else 0.0


def judge_pixels(
    names: Sequence[str], statistics: Sequence[PixelStatistics], clamp_negative: bool
) -> Iterator[Problem]:
    """Warnings about the photographs of a whole capture.

    Args:
        names: of the views, for the texts.
        statistics: of each view.
        clamp_negative: accept negative values of any size.
    """
    medians = [item.median for item in statistics if item.median > 0.0]
    if not medians:
        raise FiptError("image-black")
    limit = -1e-3 * float(np.median(medians))  # of the capture's median radiance
    pairs = list(zip(names, statistics, strict=True))
    if negative := [(name, item.minimum) for name, item in pairs if item.minimum < 0.0]:
        name, lowest = min(negative, key=lambda pair: pair[1])
        text = f"{len(negative)} photographs contain negative values (the lowest is {lowest:.3g}, in {name})"
        if lowest < limit and not clamp_negative:
            raise FiptError("image-negative.judge-pixels", text=text)
        remedy = "Resampling filters produce such values; nothing needs to be done."
        yield problem("image-negative.judge-pixels-2", text=text, remedy=remedy)
    if clear := [item.transparent for item in statistics if item.transparent > 0.0]:
        text = f"{len(clear)} photographs have pixels with alpha 0, or that their files do not hold"
        text += f" (up to {100.0 * max(clear):.0f} %)."
        remedy = "They are left out, as by a mask; remove the alpha channel or the crop to use them."
        yield Problem("image-transparent", text, remedy)
    if ldr := [name for name, item in pairs if item.looks_ldr]:
        text = f"{len(ldr)} photographs (the first is {ldr[0]}) contain only 8-bit values between 0 and 1"
        remedy = "Merge several exposures into HDR: the radiance of lamps and windows must not be clipped."
        yield problem("image-maybe-ldr", text=text, remedy=remedy)
    if clipped := [(name, item.clipped) for name, item in pairs if item.clipped > 0.0]:
        name, share = max(clipped, key=lambda pair: pair[1])
        most = f"{name} most ({100.0 * share:.1f} % of its pixels)"
        text = f"{len(clipped)} photographs look over-exposed, {most}."
        remedy = "Add shorter exposures to the HDR merge: clipped lamps are estimated too dark."
        yield Problem("image-clipped", text, remedy)


def judge_size(points: np.ndarray, slack: float = 1.0) -> Problem | None:
    """A warning where a room can't have the size that it has; None where it can.

    Args:
        points: (N, 3) on its surfaces, world metres, Z up.
        slack: factor by which the bounds are wider.
    """
    low, high = np.percentile(points, (OUTLIERS, 100.0 - OUTLIERS), axis=0)
    width, depth, height = high - low
    longest = max(width, depth)
    sizes = (height, HEIGHTS), (longest, WIDTHS)
    if all(least / slack <= size <= most * slack for size, (least, most) in sizes):
        return None
    if not height > 0.0:
        return None
    return problem(
        "size-implausible",
        height=height,
        width=width,
        depth=depth,
        usual_height=USUAL_HEIGHT,
        height_2=USUAL_HEIGHT / height,
    )


def judge_encoded(encoded: Sequence[bool], exposures: Sequence[float | None]) -> Iterator[Problem]:
    """What is assumed of photographs that are not HDR.

    Args:
        encoded: whether each photograph is one of these.
        exposures: stored in each file, or None.
    """
    if count := sum(encoded):
        told = sum(exposure is not None for exposure in exposures)
        some = f"{count} of {len(encoded)}" if count < len(encoded) else f"The {count}"
        known = f"{told} files tell their exposure" if told else "their files tell no exposures"
        yield problem("images-not-hdr", some=some, known=known)
