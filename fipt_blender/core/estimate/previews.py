"""Small pictures of what a run has found so far, shown in Blender while it goes on.

They are kept with the checkpoints and become stale together with them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..light.baking import ShadingStore
from ..optics.lights import EmitterTable
from ..photometry.refit import MIN_LIGHT
from ..pixels.store import PixelStore
from ..report.comparison import to_display
from ..report.pictures import write_png

MAX_SIZE = 256  # pixels along an edge
# The view shown is that with the best score; see `_content`.
_SAMPLED_PIXELS = 4000
_LAMP_RADIANCE = 20.0  # in units of the capture's median
_LAMP_SHARE = 0.002  # of the sampled pixels
_LAMP_BONUS = 1.5  # of a view that shows a lamp
_LABEL_PIXELS = 10  # of a label that counts


class Preview:
    """Square pictures of the view that shows most of the room, preferably with a lamp.

    Where it hardly shows a lamp, the emission is that of the view that shows most of the lamps.

    Args:
        folder: for the pictures.
        pixels: of all training views.
        labels: (T,) int object or part of each triangle; a view that shows many is preferred.
    """

    def __init__(self, folder: Path, pixels: PixelStore, labels: np.ndarray) -> None:
        self._folder, self._pixels = folder, pixels
        views = range(len(pixels.views))
        best = max(views, key=lambda index: _content(pixels, _square(pixels, index).reshape(-1), labels))
        self._rows = _square(pixels, best)

    def first_guess(self, stage: str, shadings: ShadingStore) -> list[Path]:
        """Base colour as if all surfaces were diffuse: radiance of the photograph divided by L_d."""
        rows = self._rows.reshape(-1)
        light = np.maximum(np.asarray(shadings.diffuse[rows], np.float32), MIN_LIGHT)
        color = np.asarray(self._pixels.radiance[rows]) / light
        color[np.asarray(self._pixels.triangle[rows]) < 0] = 0.0
        return [self._write(self._paths(stage)[0], color, self._rows.shape)]

    def estimate(
        self, stage: str, colors: Callable[[np.ndarray], np.ndarray], emitters: EmitterTable
    ) -> list[Path]:
        """Estimated base colour and emission.

        Args:
            stage: used in the names of the files.
            colors: (R,) pixels to their (R, 3) base colour.
            emitters: radiance in units of the capture's median.
        """
        color = colors(self._rows.reshape(-1))
        emission = self._emission(emitters, self._rows)
        triangle = np.asarray(self._pixels.triangle[self._rows.reshape(-1)])
        color[(triangle < 0) | emission.any(axis=1)] = 0.0
        lamp_rows = self._rows
        if len(emitters.triangles) and emission.any(axis=1).mean() < _LAMP_SHARE:
            lamp_rows = self._lamp_view(emitters)
            emission = self._emission(emitters, lamp_rows)
        # Lamps are many times brighter than the median; compressed, their colour stays visible.
        shown = emission / (1.0 + emission.max(axis=1, keepdims=True))
        paths = self._paths(stage)
        return [self._write(paths[0], color, self._rows.shape), self._write(paths[1], shown, lamp_rows.shape)]

    def _paths(self, stage: str) -> list[Path]:
        return [self._folder / f"{stage}-{name}.png" for name in ("base_color", "emission")]

    def _lamp_view(self, emitters: EmitterTable) -> np.ndarray:
        """(S, S) pixel indices of the view with the largest share of pixels that emit."""
        squares = (_square(self._pixels, index) for index in range(len(self._pixels.views)))
        return max(squares, key=lambda rows: self._emission(emitters, rows).any(axis=1).mean())

    def _emission(self, emitters: EmitterTable, rows: np.ndarray) -> np.ndarray:
        """(S * S, 3) radiance that pixels (S, S) show of what emits, on the side that is visible."""
        rows = rows.reshape(-1)
        if not len(emitters.triangles):
            return np.zeros((len(rows), 3), np.float32)
        triangle, front = np.asarray(self._pixels.triangle[rows]), np.asarray(self._pixels.front[rows])
        order = np.argsort(emitters.triangles)
        nearest = order[np.clip(np.searchsorted(emitters.triangles[order], triangle), 0, len(order) - 1)]
        radiance = np.where(front[:, None], emitters.radiance[nearest], emitters.back_radiance[nearest])
        return np.where((emitters.triangles[nearest] == triangle)[:, None], radiance, 0.0)

    def _write(self, path: Path, values: np.ndarray, size: tuple[int, ...]) -> Path:
        write_png(path, to_display(values.reshape(*size, 3)))
        return path


def _square(pixels: PixelStore, view: int) -> np.ndarray:
    """(S, S) pixel indices of the central square of a view, subsampled to at most `MAX_SIZE` a side."""
    width, height = pixels.views[view].width, pixels.views[view].height
    side = min(width, height)
    top, left, step = (height - side) // 2, (width - side) // 2, -(-side // MAX_SIZE)
    rows = np.arange(pixels.ranges[view], pixels.ranges[view + 1]).reshape(height, width)
    return rows[top : top + side : step, left : left + side : step]


def _content(pixels: PixelStore, rows: np.ndarray, labels: np.ndarray) -> float:
    """Score of a picture of these pixels: extent of the points x number of labels, more with a lamp."""
    rows = rows[:: max(len(rows) // _SAMPLED_PIXELS, 1)]
    rows = rows[np.asarray(pixels.triangle[rows]) >= 0]
    if not len(rows):
        return 0.0
    counts = np.unique(labels[np.asarray(pixels.triangle[rows])], return_counts=True)[1]
    extent = np.asarray(pixels.position[rows]).std(axis=0).sum()
    lamp = (np.asarray(pixels.radiance[rows]).max(axis=1) > _LAMP_RADIANCE).mean() > _LAMP_SHARE
    return float(extent * (counts > _LABEL_PIXELS).sum() * (_LAMP_BONUS if lamp else 1.0))
