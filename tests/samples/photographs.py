"""Tiny photographs with EXIF, as cameras write them."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy import ndimage

START = datetime(2026, 5, 1, 12, 0, 0)


def exif(
    shutter: float | None,
    seconds: float = 0.0,
    aperture: float = 8.0,
    iso: int = 100,
    model: str = "Model X",
    orientation: int = 1,
) -> Image.Exif:
    """EXIF of a photograph, taken some seconds after a common start; without a shutter time almost none."""
    tags = Image.Exif()
    tags[0x0112] = orientation
    if shutter is None:
        return tags
    tags[0x010F], tags[0x0110] = "Make", model
    inner = tags.get_ifd(0x8769)
    inner[0x829A] = IFDRational(round(shutter * 1e6), 1_000_000)
    inner[0x829D] = IFDRational(round(aperture * 10), 10)
    inner[0x8827] = iso
    inner[0x920A] = IFDRational(24, 1)
    time = START + timedelta(seconds=seconds)
    inner[0x9003] = time.strftime("%Y:%m:%d %H:%M:%S")
    inner[0x9291] = f"{time.microsecond // 10_000:02d}"
    return tags


def write_jpeg(path: Path, pixels: np.ndarray, tags: Image.Exif) -> Path:
    """Write (height, width, 3) uint8 pixels as JPEG without chroma subsampling."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, quality=98, subsampling=0, exif=tags)
    return path


def write_brackets(folder: Path, groups: int, shutters: tuple[float, ...], pause: float = 30.0) -> list[Path]:
    """Brackets of grey pictures in one folder: one second between exposures, a pause between groups."""
    paths = []
    for group in range(groups):
        for index, shutter in enumerate(shutters):
            seconds = group * (len(shutters) + pause) + index
            number = group * len(shutters) + index + 1
            pixels = np.full((6, 8, 3), 100 + index, np.uint8)
            paths.append(write_jpeg(folder / f"IMG_{number}.jpg", pixels, exif(shutter, seconds)))
    return paths


def smooth_radiance(seed: int = 0, height: int = 48, width: int = 64, spread: float = 1.0) -> np.ndarray:
    """Smooth radiance (height, width, 3) around 1 with a range of some stops."""
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.standard_normal((height, width, 3)), (6, 6, 0), mode="wrap")
    return np.minimum(np.exp(spread * smooth / smooth.std()), 12.0)
