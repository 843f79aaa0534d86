# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Small pictures of what a run has found so far, for the window that watches it.

They lie among the checkpoints, since they are stale when those are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..light.views import ShadingStore
from ..material.fields import Fields
from ..render.lights import EmitterTable
from ..report.comparison import to_display
from ..report.pictures import write_png
from ..scene.pixels import PixelStore

MAX_SIZE = 256
_SAMPLE = 4000
# In units of the capture's median.
_LEAST_LIGHT = 1e-3
_LAMP = 20.0
_LAMP_SHARE = 0.002
_LAMP_BONUS = 1.5
_THING_PIXELS = 10


class Preview:
    """Square pictures of one view, that which sees most of the room and a lamp if any does.

    Args:
        folder: where they go.
        pixels: of all training views.
        labels: (T,) what each triangle belongs to, an object or a part: variety makes a better picture.
    """

    def __init__(self, folder: Path, pixels: PixelStore, labels: np.ndarray) -> None:
        self._folder, self._pixels = folder, pixels
        views = range(len(pixels.views))
        best = max(views, key=lambda index: _content(pixels, _square(pixels, index).reshape(-1), labels))
        self._rows = _square(pixels, best)

    def made(self, stage: str) -> list[Path]:
        """The pictures of a stage that are there already."""
        return [path for path in self._paths(stage) if path.exists()]

    def first_guess(self, stage: str, shadings: ShadingStore) -> list[Path]:
        """Base colour as if all surfaces were matt: the photograph over the light that falls on it.

        Raises:
            FiptError: ``disk-full`` or ``run-unwritable``.
        """
        rows = self._rows.reshape(-1)
        light = np.maximum(np.asarray(shadings.diffuse[rows], np.float32), _LEAST_LIGHT)
        color = np.asarray(self._pixels.radiance[rows]) / light
        color[np.asarray(self._pixels.triangle[rows]) < 0] = 0.0
        return [self._write(self._paths(stage)[0], color)]

    def estimate(self, stage: str, fields: Fields, emitters: EmitterTable) -> list[Path]:
        """Base colour and emission as they are estimated.

        Args:
            stage: names the files.
            fields: the material network.
            emitters: in units of the capture's median.

        Raises:
            FiptError: ``disk-full`` or ``run-unwritable``.
        """
        rows = self._rows.reshape(-1)
        triangle = np.asarray(self._pixels.triangle[rows])
        color = fields.query(np.asarray(self._pixels.position[rows]))[0]
        emission = _emission(emitters, triangle, np.asarray(self._pixels.front[rows]))
        color[(triangle < 0) | emission.any(axis=1)] = 0.0
        # A lamp is many times brighter than the median: what counts is where it is, and its colour.
        shown = emission / (1.0 + emission.max(axis=1, keepdims=True))
        paths = self._paths(stage)
        return [self._write(paths[0], color), self._write(paths[1], shown)]

    def _paths(self, stage: str) -> list[Path]:
        return [self._folder / f"{stage}-{name}.png" for name in ("base_color", "emission")]

    def _write(self, path: Path, values: np.ndarray) -> Path:
        write_png(path, to_display(values.reshape(*self._rows.shape, 3)))
        return path


def _emission(emitters: EmitterTable, triangle: np.ndarray, front: np.ndarray) -> np.ndarray:
    """(N, 3) radiance that leaves triangles (N,) on the side that is seen."""
    if not len(emitters.triangles):
        return np.zeros((len(triangle), 3), np.float32)
    order = np.argsort(emitters.triangles)
    place = order[np.clip(np.searchsorted(emitters.triangles[order], triangle), 0, len(order) - 1)]
    radiance = np.where(front[:, None], emitters.radiance[place], emitters.back_radiance[place])
    return np.where((emitters.triangles[place] == triangle)[:, None], radiance, 0.0)


def _square(pixels: PixelStore, view: int) -> np.ndarray:
    """(S, S) pixel indices of the middle of a view, thinned out."""
    width, height = pixels.views[view].width, pixels.views[view].height
    side = min(width, height)
    top, left, step = (height - side) // 2, (width - side) // 2, -(-side // MAX_SIZE)
    rows = np.arange(pixels.ranges[view], pixels.ranges[view + 1]).reshape(height, width)
    return rows[top : top + side : step, left : left + side : step]


def _content(pixels: PixelStore, rows: np.ndarray, labels: np.ndarray) -> float:
    """How much some pixels show: how many different things, how far apart, and whether a lamp."""
    rows = rows[:: max(len(rows) // _SAMPLE, 1)]
    rows = rows[np.asarray(pixels.triangle[rows]) >= 0]
    if not len(rows):
        return 0.0
    things = np.unique(labels[np.asarray(pixels.triangle[rows])], return_counts=True)[1]
    spread = np.asarray(pixels.position[rows]).std(axis=0).sum()
    lamp = (np.asarray(pixels.radiance[rows]).max(axis=1) > _LAMP).mean() > _LAMP_SHARE
    return float(spread * (things > _THING_PIXELS).sum() * (_LAMP_BONUS if lamp else 1.0))
