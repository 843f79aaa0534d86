"""The contact sheet of a capture: its views, one held-back view's maps, the relit images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from room_files import read_exr

COLUMNS = 8


def displayable(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """sRGB bytes of linear radiance with a soft shoulder towards white."""
    value = np.maximum(np.asarray(radiance, np.float32) * exposure, 0)
    value = np.where(value < 0.6, value, 1 - 0.4 * np.exp(-(value - 0.6) / 0.4))
    curve = np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(np.clip(curve, 0, 1) * 255).astype(np.uint8)


def colored_ids(ids: np.ndarray) -> np.ndarray:
    """A colour for every id, always the same one."""
    palette = np.random.default_rng(8).integers(40, 256, (1024, 3)).astype(np.uint8)
    palette[0] = 0
    return palette[ids.astype(int) % 1024]


def tiles_of(folder: Path) -> list[np.ndarray]:
    """The sheet's pictures: training, held-back, relit views, maps of the first held-back view."""
    tiles = [
        displayable(read_exr(path))
        for split in ("train", "val")
        for path in sorted((folder / split / "Image").glob("*.exr"))
    ]
    tiles += [displayable(read_exr(path)) for path in sorted((folder / "relight").glob("*.exr"))]
    maps = folder / "val"
    for name in ("BaseColor", "DiffCol", "albedo", "Roughness", "Metallic", "Emit"):
        path = next((maps / name).glob("000*.exr"))
        tiles.append(displayable(read_exr(path)))
    for name in ("IndexMA", "IndexOB", "segmentation"):
        tiles.append(colored_ids(read_exr(next((maps / name).glob("000*.exr")))[..., 0]))
    tiles.append(displayable(read_exr(next((maps / "Normal").glob("000*.exr"))) * 0.5 + 0.5))
    depth = read_exr(next((maps / "Depth").glob("000*.exr"))).astype(np.float32)
    tiles.append(displayable(np.repeat((depth / max(float(depth.max()), 1e-6))[..., None], 3, 2)))
    return tiles


def make_sheet(folder: Path) -> None:
    """Write sheet.png into the capture's folder."""
    tiles = tiles_of(folder)
    height, width = tiles[0].shape[:2]
    rows = -(-len(tiles) // COLUMNS)
    sheet = np.zeros((rows * height, COLUMNS * width, 3), np.uint8)
    for k, tile in enumerate(tiles):
        y, x = k // COLUMNS * height, k % COLUMNS * width
        sheet[y : y + height, x : x + width] = tile
    small = Image.fromarray(sheet).resize(
        (COLUMNS * width * 2 // 3, rows * height * 2 // 3), Image.Resampling.LANCZOS
    )
    small.quantize(255, dither=Image.Dither.NONE).save(folder / "sheet.png", optimize=True)
