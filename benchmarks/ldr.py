"""Makes a capture of photographs that are not HDR out of one that is, with a camera drawn by chance.

    python benchmarks/ldr.py CAPTURE --output DIR --seed 1 [--format jpg|png|exr] [--exif none|rounded|exact]
                             [--frames 3 --stops 2]

The capture has the FIPT authors' synthetic layout. Everything but the photographs is linked to the original.
With more than one frame, each training pose has so many photographs, which differ in exposure: a bracket
whose photographs are views of their own.
DIR/ldr.json tells the true response, exposures and white balances; the engine never reads it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.metrics import Maps
from fipt_blender.core.capture.encoded import srgb_decoded, srgb_encoded
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.radiometry.adjustment import usable
from fipt_blender.core.radiometry.response import HIGH_ANCHOR, LOW_ANCHOR, interpolated
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder, write_json

TRUTH = "ldr.json"
SPLITS = ("train", "val")
GAMMAS = (1.8, 2.6)
MOST_TOE, MOST_SHOULDER = 0.35, 0.35
MOST_FALLOFF = 0.3  # of the light in the corners
METERED = 0.16  # linear value at which automatic exposure puts the geometric mean of a view
COMPENSATION = 1.0 / 3.0  # EV by which it errs at most
BALANCE_DRIFT = 0.04  # standard deviation of the logarithm of red and blue
FULL_WELL = 20_000.0  # electrons
QUALITY = 92
SHUTTER, APERTURE = 1.0 / 60.0, 4.0  # of an exposure of 1
CURVE_STEPS = 256
EXIF = ("none", "rounded", "exact")


@dataclass(frozen=True)
class Camera:
    """A camera drawn by chance.

    Attributes:
        gamma, toe, shoulder: of its response.
        falloff: share of the light that is missing in the corners.
        suffix: of its files, ".jpg" or ".png"; ".exr" for the ablations without adjustment.
        exif: how the files tell their exposure, one of EXIF.
    """

    gamma: float
    toe: float
    shoulder: float
    falloff: float
    suffix: str = ".jpg"
    exif: str = "none"

    def respond(self, light: np.ndarray) -> np.ndarray:
        """Values 0 to 1 that stand for light, which saturates at 1."""
        value = np.clip(light, 0.0, 1.0) ** (1.0 / self.gamma)
        value = value - self.toe * value * (1.0 - value) ** 3
        return value + self.shoulder * value**2 * (1.0 - value)

    def vignette(self, height: int, width: int) -> np.ndarray:
        """(height, width, 1) share of the light."""
        y, x = np.mgrid[:height, :width] + 0.5
        squared = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
        return (1.0 - self.falloff * squared)[..., None]


def draw_camera(rng: np.random.Generator, suffix: str, exif: str) -> Camera:
    """A camera."""
    toe, shoulder, falloff = rng.random(3) * (MOST_TOE, MOST_SHOULDER, MOST_FALLOFF)
    return Camera(float(rng.uniform(*GAMMAS)), float(toe), float(shoulder), float(falloff), suffix, exif)


def draw_gains(radiance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(3,) factors from radiance (H, W, 3) to light by automatic exposure and white balance."""
    grey = radiance.mean(axis=-1)
    exposure = METERED / np.exp(np.log(grey[grey > 0.0]).mean())
    exposure *= 2.0 ** rng.uniform(-COMPENSATION, COMPENSATION)
    return exposure * np.exp(rng.normal(0.0, BALANCE_DRIFT, 3) * (1.0, 0.0, 1.0))


def photograph(
    radiance: np.ndarray, gains: np.ndarray, camera: Camera, rng: np.random.Generator
) -> np.ndarray:
    """Values 0 to 1 (H, W, 3) that the camera stores, before they are rounded."""
    light = radiance * gains * camera.vignette(*radiance.shape[:2])
    light = light + rng.normal(size=light.shape) * np.sqrt(np.maximum(light, 0.0) / FULL_WELL)
    return camera.respond(light)


def write_photograph(path: Path, values: np.ndarray, camera: Camera, exposure: float) -> None:
    """Write values 0 to 1 (H, W, 3) as JPEG or PNG of 8 bits.

    As EXR, they are taken for radiance without any adjustment: decoded by sRGB's curve, and divided by the
    exposure that the file would tell.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    stops = np.log2(exposure)
    # Two thirds of a stop lie between neighbours of a rounded scale at most.
    told = 2.0 ** (stops if camera.exif == "exact" else np.round(3.0 * stops) / 3.0)
    if camera.suffix == ".exr":
        radiance = srgb_decoded(np.round(values * 255.0) / 255.0)
        write_exr(path, (radiance / (1.0 if camera.exif == "none" else told)).astype(np.float32))
        return
    image = Image.fromarray(np.round(values * 255.0).astype(np.uint8))
    tags = Image.Exif()
    if camera.exif != "none":
        shutter = SHUTTER * told
        inner = tags.get_ifd(0x8769)
        inner[0x829A] = IFDRational(round(shutter * 1e7), 10_000_000)
        inner[0x829D] = IFDRational(round(APERTURE * 10), 10)
        inner[0x8827] = 100
    # A pixel of the capture stands for many of a camera, so that its subsampled colors do not show.
    image.save(path, quality=QUALITY, subsampling=0, exif=tags)


@dataclass(frozen=True)
class Bracket:
    """Exposures of one pose, the middle one of which is automatic.

    Attributes:
        frames: number of them.
        stops: EV between neighbours.
    """

    frames: int = 1
    stops: float = 2.0

    @property
    def factors(self) -> np.ndarray:
        """(frames,) exposures relative to the automatic one."""
        return 2.0 ** (self.stops * (np.arange(self.frames) - (self.frames - 1) / 2.0))

    def stems(self, stem: str) -> list[str]:
        """Names of the frames of a view, whose name starts with its number."""
        number, rest = _numbered(stem)
        return [f"{int(number) * self.frames + frame:03d}{rest}" for frame in range(self.frames)]


SINGLE = Bracket()


def _numbered(stem: str) -> tuple[str, str]:
    """The digits that a name starts with, and the rest."""
    rest = stem.lstrip("0123456789")
    return stem[: len(stem) - len(rest)], rest


def make_capture(
    source: Path,
    target: Path,
    seed: int,
    suffix: str = ".jpg",
    exif: str = "none",
    bracket: Bracket = SINGLE,
) -> Camera:
    """Write the capture and its truth; the camera that took it.

    Args:
        bracket: of the training views; held-back ones have one photograph.

    Raises:
        FiptError: where the source has no readable photographs in the expected layout.
    """
    camera = draw_camera(np.random.default_rng(seed), suffix, exif)
    views: dict[str, Any] = {}
    for number, split in enumerate(name for name in SPLITS if (source / name).is_dir()):
        own = bracket if split == SPLITS[0] else SINGLE
        link_others(source / split, target / split, {"Image", "transforms.json"}, own)
        for index, path in enumerate(sorted((source / split / "Image").glob("*.exr"))):
            rng = np.random.default_rng([seed, number, index])
            radiance = read_radiance(path)
            gains = draw_gains(radiance, rng)
            for stem, factor in zip(own.stems(path.stem), own.factors, strict=True):
                name, light = Path(split, "Image", stem + suffix), gains * factor
                write_photograph(target / name, photograph(radiance, light, camera, rng), camera, light[1])
                views[f"{split}/{stem.removesuffix('_0001')}"] = {"gains": light.tolist(), "hdr": str(path)}
        write_rig(source / split / "transforms.json", target / split / "transforms.json", suffix, own)
    link_others(source, target, set(SPLITS))
    light = np.linspace(0.0, 1.0, CURVE_STEPS)
    truth = {"camera": asdict(camera), "light": light.tolist(), "values": camera.respond(light).tolist()}
    write_json(target / TRUTH, {**truth, "seed": seed, "views": views})
    return camera


def link_others(source: Path, target: Path, made: set[str], bracket: Bracket = SINGLE) -> None:
    """Link everything in a folder but what is made anew, images of views for each frame of a bracket."""
    target.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.iterdir()):
        if path.name in made:
            continue
        if bracket.frames > 1 and path.is_dir():
            link_others(path, target / path.name, set(), bracket)
            continue
        several = bracket.frames > 1 and _numbered(path.stem)[0]
        for stem in bracket.stems(path.stem) if several else [path.stem]:
            place = target / (stem + path.suffix)
            if not place.exists():
                os.symlink(path.resolve(), place)


def write_rig(source: Path, target: Path, suffix: str, bracket: Bracket = SINGLE) -> None:
    """Copy transforms.json with the photographs' new names."""
    data = json.loads(source.read_text(encoding="utf-8"))
    frames = []
    for index, frame in enumerate(data["frames"]):
        path = str(frame.get("file_path") or "")
        name = Path(path if path.lower().endswith(".exr") else f"Image/{index:03d}_0001.exr")
        frames += [
            {**frame, "file_path": str(name.with_name(stem + suffix))} for stem in bracket.stems(name.stem)
        ]
    write_json(target, {**data, "frames": frames})


def camera_errors(run: RunFolder, capture: Path) -> dict[str, float] | None:
    """Errors of the response, its contrast and the exposures that a run has found; None for HDR photographs.

    Returns:
        `response`: root mean square over all codes, in units of the light that saturates; `contrast`: found
        over true one; `exposures`, `exposures_most`: root mean square and largest error over the
        views, EV, apart from the scale of all.
    """
    photometry = _photometry(run)
    if photometry is None or not (capture / TRUTH).is_file():
        return None
    true, found = read_document(capture / TRUTH, dict), photometry["views"]
    codes, curve = np.arange(CURVE_STEPS) / (CURVE_STEPS - 1.0), np.array(photometry["log_curve"])
    light = np.interp(codes, true["values"], true["light"])
    logarithm = np.log(np.maximum(light, 1e-9))
    contrast = (curve[HIGH_ANCHOR] - curve[LOW_ANCHOR]) / (logarithm[HIGH_ANCHOR] - logarithm[LOW_ANCHOR])
    gains = {name: np.mean(np.log2(true["views"][name]["gains"])) for name in found}
    error = np.array([found[name]["exposure_ev"] - gains[name] for name in found])
    error -= error.mean()
    return {
        "response": float(np.sqrt(np.mean((np.exp(curve) - light) ** 2))),
        "contrast": float(contrast),
        "exposures": float(np.sqrt(np.mean(error**2))),
        "exposures_most": float(np.abs(error).max()),
    }


def in_true_units(maps: Sequence[Maps], run: RunFolder, capture: Path) -> list[Maps]:
    """Maps with their emission in the units of the HDR capture, if the run's photographs are not HDR.

    One factor for all, by which the exposures that the run has found differ from the true ones.
    """
    photometry = _photometry(run)
    if photometry is None or not (capture / TRUTH).is_file():
        return list(maps)
    true = read_document(capture / TRUTH, dict)["views"]
    found = photometry["views"]
    offsets = [
        np.log(2.0) * found[name]["exposure_ev"] - np.mean(np.log(true[name]["gains"])) for name in found
    ]
    scale = np.float32(np.exp(np.median(offsets)))
    return [replace(view, emission=view.emission * scale) for view in maps]


def as_photographed(images: Sequence[np.ndarray], run: RunFolder, views: Sequence[View]) -> list[np.ndarray]:
    """Rendered radiance as the camera would have stored it, decoded like the photographs that are not HDR.

    The factor of each channel is the median over the pixels of a view, as its exposure is not known where it
    was held back.

    Args:
        images: (H, W, 3) of each view.
    """
    photometry = _photometry(run)
    if photometry is None:
        return list(images)
    curve, falloff = np.array(photometry["log_curve"]), np.array(photometry["falloff"])
    result = []
    for image, view in zip(images, views, strict=True):
        if not view.encoded:
            result.append(image)
            continue
        codes = srgb_encoded(view.radiance().astype(np.float64)) * 255.0
        y, x = np.mgrid[: view.height, : view.width] + 0.5
        squared = (x - view.cx) ** 2 + (y - view.cy) ** 2
        radius = np.sqrt(squared / squared.max())
        share = (radius[..., None] ** (2 * np.arange(1, len(falloff) + 1))) @ falloff
        light = np.log(np.maximum(image.astype(np.float64), 1e-9)) + share[..., None]
        good = usable(codes).all(axis=-1)
        gains = np.median((interpolated(curve, codes) - light)[good], axis=0) if good.any() else np.zeros(3)
        found = np.interp(light + gains, curve, np.arange(len(curve))) / 255.0
        result.append(srgb_decoded(found).astype(np.float32))
    return result


def _photometry(run: RunFolder) -> dict[str, Any] | None:
    """What a run has found of photographs that are not HDR, None where they are."""
    if not run.statistics_json.exists():
        return None
    return read_document(run.statistics_json, dict).get("photometry")


def main(argv: Sequence[str]) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", choices=("jpg", "png", "exr"), default="jpg")
    parser.add_argument(
        "--exif",
        choices=EXIF,
        default="none",
        help="how the files tell their exposure: not, in thirds of a stop, or exactly (default: none)",
    )
    parser.add_argument("--frames", type=int, default=1, help="photographs of each training pose")
    parser.add_argument("--stops", type=float, default=2.0, help="EV between them (default: 2)")
    arguments = parser.parse_args(list(argv))
    bracket = Bracket(arguments.frames, arguments.stops)
    suffix = f".{arguments.format}"
    camera = make_capture(
        arguments.capture, arguments.output, arguments.seed, suffix, arguments.exif, bracket
    )
    print(camera)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
