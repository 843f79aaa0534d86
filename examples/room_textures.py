"""Base-colour textures of the example room, made with numpy alone and seeded.

Every function returns linear albedo (H, W, 3) float32, row 0 at the top; `encode` turns it into sRGB bytes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Texture = np.ndarray


def smooth_noise(rng: np.random.Generator, height: int, width: int, cells_y: int, cells_x: int) -> np.ndarray:
    """Tileable value noise (H, W) in [0, 1] with `cells_y` x `cells_x` random values, cubic in between."""
    lattice = rng.random((cells_y, cells_x))
    y = np.arange(height) / height * cells_y
    x = np.arange(width) / width * cells_x
    y0, x0 = y.astype(int), x.astype(int)
    ty, tx = y - y0, x - x0
    ty, tx = (ty * ty * (3 - 2 * ty))[:, None], (tx * tx * (3 - 2 * tx))[None, :]
    y1, x1 = (y0 + 1) % cells_y, (x0 + 1) % cells_x
    top = lattice[np.ix_(y0, x0)] * (1 - tx) + lattice[np.ix_(y0, x1)] * tx
    bottom = lattice[np.ix_(y1, x0)] * (1 - tx) + lattice[np.ix_(y1, x1)] * tx
    return top * (1 - ty) + bottom * ty


def mix(a: tuple[float, ...], b: tuple[float, ...], t: np.ndarray) -> Texture:
    """Colours between `a` and `b` by the map `t` (H, W)."""
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * t[..., None]


def wood(
    rng: np.random.Generator, height: int, width: int, dark: tuple[float, ...], light: tuple[float, ...]
) -> Texture:
    """Wood whose grain runs along the width; tileable."""
    bend = smooth_noise(rng, height, width, 4, 3)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (np.arange(height)[:, None] / height * 6 + 1.5 * bend))
    fibre = smooth_noise(rng, height, width, height // 4, 6)
    return mix(dark, light, np.clip(0.55 * rings + 0.45 * fibre, 0, 1))


def planks(rng: np.random.Generator, height: int = 800, width: int = 1000) -> Texture:
    """The whole floor, 5 mm a pixel: planks of 14 cm with joints, each its own tone and grain."""
    image = np.empty((height, width, 3))
    board = 28
    for top in range(0, height, board):
        left = -int(rng.integers(20, 260))
        rows = slice(top, min(top + board, height))
        while left < width:
            right = left + int(rng.integers(200, 330))
            columns = slice(max(left, 0), min(right, width))
            size = (rows.stop - rows.start, columns.stop - columns.start)
            if min(size) > 0:
                tone = rng.uniform(0.72, 1.18)
                dark, light = (
                    (0.25 * tone, 0.13 * tone, 0.06 * tone),
                    (0.50 * tone, 0.30 * tone, 0.155 * tone),
                )
                image[rows, columns] = wood(rng, board, 330, dark, light)[: size[0], : size[1]]
                image[rows, columns.stop - 1] *= 0.45
            left = right
        image[rows.stop - 1] *= 0.45
    return image


def fabric(
    rng: np.random.Generator, colour: tuple[float, ...], contrast: float, stripes: int = 0, size: int = 256
) -> Texture:
    """A melange weave around `colour`; `stripes` pairs of lighter bands across the width. Tileable."""
    weave = smooth_noise(rng, size, size, 16, 128) + smooth_noise(rng, size, size, 128, 16)
    patches = smooth_noise(rng, size, size, 6, 6)
    tone = 1 + contrast * (0.7 * (weave - 1.0) + 0.6 * (patches - 0.5))
    image = np.asarray(colour) * tone[..., None]
    if stripes:
        band = np.sin(2 * np.pi * stripes * np.arange(size) / size)
        image = np.where(
            (band > 0.55)[None, :, None], 0.25 * image + 0.75 * np.array([0.62, 0.56, 0.46]), image
        )
    return image


def zigzag(rng: np.random.Generator, size: int = 256) -> Texture:
    """A cushion's chevrons. Tileable."""
    y, x = np.mgrid[0:size, 0:size] / size
    phase = (6 * y + 1.2 * np.abs(((4 * x) % 1) - 0.5)) % 1
    palette = np.array([[0.62, 0.55, 0.44], [0.55, 0.17, 0.09], [0.09, 0.17, 0.22], [0.55, 0.38, 0.10]])
    image = palette[(phase * 4).astype(int)]
    return image * (0.88 + 0.24 * smooth_noise(rng, size, size, 96, 96))[..., None]


def rug(rng: np.random.Generator, height: int = 384, width: int = 512) -> Texture:
    """A woven rug: border, diamonds, worn pile."""
    y, x = np.mgrid[0:height, 0:width]
    edge = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    diamond = np.abs(((x - width / 2) / 64) % 2 - 1) + np.abs(((y - height / 2) / 64) % 2 - 1)
    image = np.where((diamond < 0.45)[..., None], [0.52, 0.42, 0.28], [0.33, 0.07, 0.055])
    image = np.where(((diamond > 0.75) & (diamond < 0.95))[..., None], [0.06, 0.10, 0.17], image)
    image = np.where((edge < 58)[..., None], [0.06, 0.10, 0.17], image)
    motif = (edge >= 16) & (edge < 46) & (((x // 16 + y // 16) % 2) == 0)
    image = np.where(motif[..., None], [0.50, 0.30, 0.12], image)
    image = np.where(((edge >= 52) & (edge < 58) | (edge < 8))[..., None], [0.55, 0.47, 0.34], image)
    pile = smooth_noise(rng, height, width, 192, 256) * 0.3 + smooth_noise(rng, height, width, 5, 7) * 0.2
    return image * (0.75 + pile)[..., None]


def landscape(rng: np.random.Generator, height: int = 192, width: int = 288) -> Texture:
    """A painted evening: sky, sun, ranges of hills."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    image = mix((0.10, 0.20, 0.36), (0.72, 0.42, 0.20), np.clip(y / (0.62 * height), 0, 1) ** 1.4)
    sun = np.hypot(x - 0.68 * width, y - 0.42 * height) < 0.09 * height
    image[sun] = (0.80, 0.62, 0.30)
    for k, colour in enumerate(
        [(0.30, 0.22, 0.30), (0.15, 0.20, 0.22), (0.08, 0.14, 0.09), (0.16, 0.20, 0.07)]
    ):
        ridge = (0.5 + 0.13 * k) * height + (
            smooth_noise(rng, 1, width, 1, 5 + 3 * k)[0] - 0.5
        ) * 0.28 * height
        image[y > ridge[None, :]] = colour
    return image * (0.8 + 0.4 * smooth_noise(rng, height, width, 48, 18))[..., None]


def abstract(rng: np.random.Generator, height: int = 192, width: int = 144) -> Texture:
    """Cut-paper shapes on a pale ground."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    image = np.full((height, width, 3), (0.66, 0.61, 0.52))
    palette = [
        (0.55, 0.13, 0.07),
        (0.08, 0.20, 0.30),
        (0.60, 0.40, 0.09),
        (0.10, 0.24, 0.16),
        (0.06, 0.06, 0.07),
    ]
    for colour in palette:
        cy, cx = rng.uniform(0.2, 0.8, 2) * (height, width)
        ry, rx = rng.uniform(0.10, 0.26, 2) * height
        turn = rng.uniform(0, np.pi)
        u = (x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)
        v = (y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)
        image[(np.abs(u / rx) ** 2.6 + np.abs(v / ry) ** 2.6) < 1] = colour
    return image * (0.94 + 0.12 * smooth_noise(rng, height, width, 40, 40))[..., None]


def book_covers(rng: np.random.Generator, tiles: int = 8, size: int = 512) -> Texture:
    """An atlas of `tiles` x `tiles` bindings: a colour, bands and a title block each."""
    image = np.empty((size, size, 3))
    cell = size // tiles
    bindings = np.array(
        [
            (0.30, 0.06, 0.05),
            (0.05, 0.12, 0.20),
            (0.07, 0.16, 0.09),
            (0.42, 0.30, 0.16),
            (0.10, 0.07, 0.05),
            (0.50, 0.44, 0.34),
            (0.36, 0.15, 0.05),
            (0.09, 0.20, 0.22),
            (0.22, 0.20, 0.18),
        ]
    )
    for row in range(tiles):
        for column in range(tiles):
            ground = bindings[rng.integers(len(bindings))] * rng.uniform(0.7, 1.2)
            block = np.tile(ground, (cell, cell, 1))
            ink = np.array([0.62, 0.52, 0.30]) if ground.mean() < 0.25 else np.array([0.08, 0.07, 0.08])
            for start in rng.choice(np.arange(6, cell - 10, 6), 2, replace=False):
                block[start : start + int(rng.integers(2, 6))] = ink
            middle = int(rng.integers(cell // 3, cell // 2))
            block[middle : middle + cell // 5, cell // 4 : -cell // 4] = ink
            image[row * cell : (row + 1) * cell, column * cell : (column + 1) * cell] = block
    return image


MAKERS: dict[str, Callable[[np.random.Generator], Texture]] = {
    "floor": planks,
    "walnut": lambda rng: wood(rng, 256, 256, (0.085, 0.042, 0.022), (0.20, 0.105, 0.055)),
    "oak": lambda rng: wood(rng, 256, 256, (0.30, 0.19, 0.10), (0.47, 0.32, 0.18)),
    "sofa": lambda rng: fabric(rng, (0.30, 0.34, 0.37), 0.35),
    "armchair": lambda rng: fabric(rng, (0.50, 0.27, 0.065), 0.35),
    "striped": lambda rng: fabric(rng, (0.10, 0.19, 0.24), 0.25, stripes=5),
    "zigzag": zigzag,
    "curtain": lambda rng: fabric(rng, (0.44, 0.40, 0.33), 0.25),
    "rug": rug,
    "landscape": landscape,
    "abstract_a": abstract,
    "abstract_b": abstract,
    "books": book_covers,
}


def make_texture(name: str, seed: int) -> Texture:
    """The texture `name` of MAKERS, albedo kept within [0.03, 0.85]."""
    rng = np.random.default_rng([seed, sorted(MAKERS).index(name)])
    return np.clip(MAKERS[name](rng), 0.03, 0.85).astype(np.float32)


def encode(linear: Texture) -> np.ndarray:
    """Linear [0, 1] to sRGB bytes (IEC 61966-2-1)."""
    curve = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.round(np.clip(curve, 0, 1) * 255).astype(np.uint8)
