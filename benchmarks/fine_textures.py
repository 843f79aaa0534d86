# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The example room's textures with about 1,000 to 2,000 texels a metre, for photographs of real size.

The textures of examples/room_textures.py are enlarged, and what a close look shows is added: grain, pores,
scratches and weave as a factor, and print (lines of letters) on pictures and bindings. Seeded.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from room_textures import MAKERS, encode, make_texture, smooth_noise  # noqa: E402

# By how much a texture's width and height grow; the floor has 200 texels a metre, the others 250 to 512.
ENLARGED = {name: 5 if name == "floor" else 4 for name in MAKERS}
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789"
DARKEST, LIGHTEST = 0.02, 0.9  # albedo


def enlarged(linear: np.ndarray, factor: int) -> np.ndarray:
    """A linear texture (H, W, 3) with `factor` times as many rows and columns, bicubic."""
    size = (linear.shape[1] * factor, linear.shape[0] * factor)
    planes = [
        Image.fromarray(np.ascontiguousarray(plane)).resize(size, Image.Resampling.BICUBIC)
        for plane in np.moveaxis(linear.astype(np.float32), -1, 0)
    ]
    return np.stack([np.asarray(plane) for plane in planes], axis=-1)


def grain(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """(H, W) factor of wood: fibres of 3 texels along the width, dark pores, a few scratches."""
    fibre = smooth_noise(rng, height, width, height // 3, max(width // 70, 2)) - 0.5
    pores = smooth_noise(rng, height, width, height // 4, max(width // 24, 2)) > 0.93
    factor = (1.0 + 0.35 * fibre) * np.where(pores, 0.6, 1.0)
    image = Image.new("F", (width, height), 1.0)
    draw = ImageDraw.Draw(image)
    for _ in range(height * width // 40_000):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        turn, reach = rng.uniform(0, np.pi), rng.uniform(15, 80)
        draw.line(
            (x, y, x + reach * np.cos(turn), y + reach * np.sin(turn)), fill=rng.uniform(0.6, 1.4), width=2
        )
    return factor * np.asarray(image)


def weave(rng: np.random.Generator, height: int, width: int, period: int = 8) -> np.ndarray:
    """(H, W) factor of cloth: crossing yarns of `period` texels, each of its own tone."""
    y, x = np.mgrid[0:height, 0:width]
    over = ((x // period) + (y // period)) % 2 == 0
    warp = rng.uniform(0.75, 1.25, width // period + 1)[x // period]
    weft = rng.uniform(0.75, 1.25, height // period + 1)[y // period]
    rounding = np.where(
        over, np.sin(np.pi * (x % period + 0.5) / period), np.sin(np.pi * (y % period + 0.5) / period)
    )
    return np.where(over, warp, weft) * (0.7 + 0.4 * rounding)


def printed(
    rng: np.random.Generator, linear: np.ndarray, boxes: list[tuple[int, int, int, int]], size: int
) -> None:
    """Print lines of random letters of `size` texels into boxes (left, top, right, bottom), in place."""
    font = ImageFont.load_default(size)
    for left, top, right, bottom in boxes:
        sheet = Image.new("L", (right - left, bottom - top), 0)
        draw = ImageDraw.Draw(sheet)
        for line in range(0, bottom - top - size, int(1.3 * size)):
            words = "".join(rng.choice(list(LETTERS + "    "), 3 + 2 * (right - left) // size))
            draw.text((0, line), words, fill=255, font=font)
        cover = np.asarray(sheet, np.float32)[..., None] / 255
        part = linear[top:bottom, left:right]
        ink = np.where(part.mean() < 0.25, 0.65, 0.05)
        part += cover * (ink - part)


def fine_texture(name: str, seed: int) -> np.ndarray:
    """A texture of room_textures.MAKERS, larger and with fine detail: linear albedo (H, W, 3) float32."""
    rng = np.random.default_rng([seed, 1000 + sorted(MAKERS).index(name)])
    linear = enlarged(make_texture(name, seed), ENLARGED[name])
    height, width = linear.shape[:2]
    if name in ("floor", "walnut", "oak"):
        linear *= grain(rng, height, width)[..., None]
    elif name in ("landscape", "abstract_a", "abstract_b"):
        brush = smooth_noise(rng, height, width, height // 4, width // 14) - 0.5
        linear *= (1.0 + 0.25 * brush)[..., None]
        third = height // 3
        boxes = [
            (width // 12, height - third, 11 * width // 12, height - height // 12),
            (width // 12, height // 14, width // 2, height // 4),
        ]
        printed(rng, linear, boxes[:1], 18)
        printed(rng, linear, boxes[1:], 42)
    elif name == "books":
        cell = width // 8
        edge = cell // 10
        boxes = [
            (column * cell + edge, row * cell + edge, (column + 1) * cell - edge, (row + 1) * cell - edge)
            for row in range(8)
            for column in range(8)
        ]
        printed(rng, linear, boxes, 22)
    else:
        linear *= weave(rng, height, width)[..., None]
    return np.clip(linear, DARKEST, LIGHTEST).astype(np.float32)


def write_fine_textures(folder: Path, seed: int) -> None:
    """Replace the PNG textures in `folder`."""
    for name in MAKERS:
        Image.fromarray(encode(fine_texture(name, seed))).save(folder / f"{name}.png", compress_level=1)
