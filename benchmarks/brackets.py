# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns a capture's images into the brackets of a camera, and scores what `prepare` makes of them.

    python benchmarks/brackets.py IMAGES OUT [--kind jpeg] [--bits 12] [--frames 3] [--stops 2] [--shake 6]

writes OUT/photographs (DNG with photon and read noise, or JPEG with a response of its own and vignetting),
merges them to OUT/capture and prints the relative error of radiance.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.dng import Shot, mosaic_of, write_dng
from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.run.messages import Reporter
from fipt_blender.prepare import command

FULL_WELL, READ_ELECTRONS = 20_000.0, 4.0  # of a camera with large pixels at ISO 100
VIGNETTING = 0.35  # loss of light in the corners
BRIGHT = 4.0  # lamps: this many times the median and more
WELL_EXPOSED = (0.05, 0.9)  # shares of the ceiling
CEILING_EXPOSURE = 100.0  # a simulated exposure, which saturates a radiance of 1, over that of the header
LONGEST = 0.5  # where the longest exposure puts the median, as a share of the ceiling


@dataclass(frozen=True)
class Camera:
    """A simulated camera.

    Attributes:
        kind: raw or jpeg.
        bits: of the sensor.
        exposures: ceiling's inverse radiance of each exposure of a bracket.
        shake: largest shift between exposures in pixels of the camera, and turn of as many milliradians.
        enlargement: pixels of the camera along each pixel of the capture.
        falloff: loss of light in the corners; of JPEGs only.
    """

    kind: str
    bits: int
    exposures: tuple[float, ...]
    shake: float = 0.0
    enlargement: int = 4
    falloff: float = VIGNETTING


def vignette(height: int, width: int, falloff: float) -> np.ndarray:
    """(height, width, 1) share of the light."""
    y, x = np.mgrid[:height, :width] + 0.5
    squared = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    return (1.0 - falloff * squared)[..., None]


def mean_vignette(height: int, width: int, camera: Camera) -> np.ndarray:
    """`vignette` of a capture's image: means over the camera's pixels."""
    factor = camera.enlargement
    full = vignette(height * factor, width * factor, camera.falloff)
    return full.reshape(height, factor, width, factor, 1).mean(axis=(1, 3))


def response(linear: np.ndarray) -> np.ndarray:
    """An S-shaped response that differs between channels, 0 to 1."""
    power = linear ** (1.0 / np.array([2.3, 2.1, 2.2]))
    return power + 0.3 * power * (1.0 - power) * (2.0 * power - 1.0) + 0.05 * power * (1.0 - power)


def sensor(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Values relative to the ceiling with photon and read noise, not clipped."""
    electrons = rng.poisson(np.minimum(light, 4.0) * FULL_WELL) + rng.normal(0.0, READ_ELECTRONS, light.shape)
    return electrons / FULL_WELL


def write_bracket(folder: Path, index: int, radiance: np.ndarray, camera: Camera, seed: int) -> None:
    """Write the exposures of one view."""
    rng = np.random.default_rng([seed, index])
    scene = radiance.repeat(camera.enlargement, 0).repeat(camera.enlargement, 1)
    scene = scene[: len(scene) // 2 * 2, : scene.shape[1] // 2 * 2]
    for place, exposure in enumerate(camera.exposures):
        light = scene * exposure
        if camera.shake and place != len(camera.exposures) // 2:
            light = shaken(light, rng.uniform(-1.0, 1.0, 3) * camera.shake)
        seconds = index * 30 + place
        clock = f"2026:05:01 {12 + seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
        shot = Shot(shutter=exposure / CEILING_EXPOSURE, aperture=1.0, time=clock)
        name = folder / f"IMG_{index * len(camera.exposures) + place:05d}"
        if camera.kind == "raw":
            white = 2**camera.bits - 1
            black = white // 64
            values = sensor(mosaic_of(light), rng) * (white - black) + black
            write_dng(name.with_suffix(".dng"), np.clip(np.round(values), 0, white), shot, black, white)
        else:
            values = sensor(light * vignette(*light.shape[:2], camera.falloff), rng)
            codes = np.round(255.0 * response(np.clip(values, 0.0, 1.0))).astype(np.uint8)
            _write_jpeg(name.with_suffix(".jpg"), codes, shot)


def shaken(image: np.ndarray, amount: np.ndarray) -> np.ndarray:
    """An image shifted by amount[:2] pixels and turned by amount[2] milliradians about its center."""
    cos, sin = np.cos(1e-3 * amount[2]), np.sin(1e-3 * amount[2])
    matrix = np.array([[cos, -sin], [sin, cos]])
    center = (np.array(image.shape[:2]) - 1.0) / 2.0
    offset = center - matrix @ center + amount[:2]
    planes = [
        ndimage.affine_transform(image[..., c], matrix, offset, order=1, mode="nearest") for c in range(3)
    ]
    return np.stack(planes, -1)


def score(images: list[np.ndarray], truths: list[np.ndarray], camera: Camera) -> dict[str, float]:
    """Relative errors where some exposure is well exposed, after one factor for all views."""
    ratios, bright, centers = [], [], []
    median = np.median([np.median(truth) for truth in truths])
    for image, truth in zip(images, truths, strict=True):
        levels = [truth.max(axis=-1) * exposure for exposure in camera.exposures]
        least = truth.min(axis=-1)
        good = np.zeros(truth.shape[:2], bool)
        for level, exposure in zip(levels, camera.exposures, strict=True):
            good |= (level < WELL_EXPOSED[1] * 0.65) & (least * exposure > WELL_EXPOSED[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = image / truth
        ratios.append(ratio[good].ravel())
        bright.append(np.repeat(truth[good].max(axis=-1) > BRIGHT * median, 3))
        centers.append(np.median(ratios[-1]) if good.any() else np.nan)
    every, lamps = np.concatenate(ratios), np.concatenate(bright)
    every = every / np.median(every)
    return {
        "share of pixels": len(every) / sum(truth.size for truth in truths),
        "median error": float(np.median(np.abs(every - 1.0))),
        "90 % below": float(np.quantile(np.abs(every - 1.0), 0.9)),
        "spread of views": float(np.nanstd(np.array(centers) / np.nanmedian(centers))),
        "bright pixels": float(lamps.sum()),
        "bias of bright": float(np.median(every[lamps]) - 1.0) if lamps.any() else float("nan"),
    }


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """Options that describe the simulated camera."""
    parser.add_argument("--kind", choices=("raw", "jpeg"), default="raw")
    parser.add_argument("--bits", type=int, choices=(12, 14), default=14)
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--stops", type=float, default=1.0)
    parser.add_argument("--reach", type=float, default=0.0, metavar="FACTOR",
                        help="the darkest exposure clips at so many times the brightest pixel; otherwise the"
                        " longest one puts the median at half the ceiling")  # fmt: skip
    parser.add_argument("--shake", type=float, default=0.0)
    parser.add_argument("--enlargement", type=int, default=4)
    parser.add_argument("--falloff", type=float, default=VIGNETTING)
    parser.add_argument("--seed", type=int, default=0)


def make_camera(truths: Sequence[np.ndarray], arguments: argparse.Namespace) -> Camera:
    """The camera that the options describe."""
    count, stops = arguments.frames, arguments.stops
    shortest = (
        LONGEST / float(np.median([np.median(truth) for truth in truths])) * 2.0 ** (-stops * (count - 1))
    )
    if arguments.reach:
        shortest = 1.0 / (arguments.reach * max(float(truth.max()) for truth in truths))
    exposures = tuple(shortest * 2.0 ** (stops * place) for place in range(count))
    kind, bits, shake = arguments.kind, arguments.bits, arguments.shake
    return Camera(kind, bits, exposures, shake, arguments.enlargement, arguments.falloff)


def merge(photographs: Path, folder: Path, side: int, camera: Camera) -> tuple[Path, list[dict[str, str]]]:
    """Merge brackets to images of a size; returns the folder and the warnings."""
    settings = [f"working_width={side}", f"align={'true' if camera.shake else 'false'}"]
    options = argparse.Namespace(
        photographs=photographs.absolute(), run=folder, steps="read,merge", set=settings
    )
    reporter = Reporter()
    command.run(options, reporter)
    return folder, reporter.warnings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("images", type=Path, help="folder of EXR images")
    parser.add_argument("out", type=Path)
    add_camera_arguments(parser)
    parser.add_argument("--views", type=int, default=0, help="only the first N")
    arguments = parser.parse_args()
    files = sorted(arguments.images.glob("*.exr"))[: arguments.views or None]
    truths = [read_radiance(file) for file in files]
    camera = make_camera(truths, arguments)
    for index, truth in enumerate(truths):
        write_bracket(arguments.out / "photographs", index, truth, camera, arguments.seed)
    started = time.monotonic()
    folder, warnings = merge(
        arguments.out / "photographs", arguments.out / "capture", max(truths[0].shape[:2]), camera
    )
    for message in warnings:
        print(f"warning: {message['text']}")
    merged = [read_radiance(file) for file in sorted((folder / "images").glob("*.exr"))]
    print(f"{len(files)} views of {truths[0].shape[1]} x {truths[0].shape[0]}, {camera.kind},"
          f" {arguments.frames} x {arguments.stops:g} EV, {time.monotonic() - started:.0f} s")  # fmt: skip
    if camera.kind == "jpeg":  # the lens is another step's work
        shade = [mean_vignette(*truth.shape[:2], camera) for truth in truths]
        print("with the vignetting:", score(merged, truths, camera))
        truths = [truth * part for truth, part in zip(truths, shade, strict=True)]
    print(score(merged, truths, camera))


def _write_jpeg(path: Path, codes: np.ndarray, shot: Shot) -> None:
    tags = Image.Exif()
    tags[0x010F], tags[0x0110] = "Make", shot.model
    inner = tags.get_ifd(0x8769)
    inner[0x829A], inner[0x829D] = IFDRational(round(shot.shutter * 1e9), 10**9), IFDRational(1, 1)
    inner[0x8827], inner[0x9003], inner[0x920A] = shot.iso, shot.time, IFDRational(24, 1)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(codes).save(path, quality=95, exif=tags)


if __name__ == "__main__":
    main()
