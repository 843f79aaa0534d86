"""The codes of photographs that are not HDR, in the order of the pixels of all views, and samples of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from ..capture.encoded import srgb_encoded
from ..capture.views import photographs_of
from ..checks.consistency import ConsistencyTable, lattice_hits
from ..pixels.grouped import grouped_means
from ..pixels.store import PixelStore, open_array
from ..radiometry.adjustment import Samples

# Largest difference of codes in the 3 x 3 pixels around one that is compared: edges would mix surfaces.
CALM_CODES = 24.0
# Approximate number of samples that are compared, one for each cell and view.
MAX_SAMPLES = 40_000
# Width of clusters, in cells: errors of the samples in one cluster are correlated.
CLUSTER = 8.0


@dataclass(frozen=True, eq=False)
class Codes:
    """The codes of photographs.

    Attributes:
        pixels: of all views.
        encoded: numbers of the views that are not HDR.
        stored: (N, 3) uint16 codes from 0 to 65535; memory-mapped.
    """

    pixels: PixelStore
    encoded: list[int]
    stored: np.ndarray

    @classmethod
    def of(cls, pixels: PixelStore, scale: float, folder: Path) -> Codes:
        """Those of pixels whose values are decoded by sRGB's curve, and divided by the scale."""
        stored = open_array(folder / "codes.npy", (len(pixels), 3), np.uint16, create=True)
        encoded = [index for index, view in enumerate(pixels.views) if view.encoded]
        for index in encoded:
            rows = pixels.rows(index)
            values = srgb_encoded(np.asarray(pixels.radiance[rows], np.float64) * scale)
            stored[rows] = np.round(np.minimum(values, 1.0) * 65535.0)
        return cls(pixels, encoded, stored)

    @property
    def photograph(self) -> np.ndarray:
        """(E,) int photograph of each of the views that are not HDR."""
        return photographs_of([self.pixels.views[index] for index in self.encoded])

    def of_view(self, index: int) -> np.ndarray:
        """(n, 3) float64 codes from 0 to 255 of a view."""
        return self.stored[self.pixels.rows(index)] / 257.0

    def radius(self, index: int) -> np.ndarray:
        """(H * W,) distance of a view's pixels from its principal point, 1 in the farthest corner.

        In panoramas it is 0: their stitching has evened the lenses' vignetting.
        """
        view = self.pixels.views[index]
        if view.panorama is not None:
            return np.zeros(view.width * view.height)
        x = (np.arange(view.width) + 0.5 - view.cx)[None]
        y = (np.arange(view.height) + 0.5 - view.cy)[:, None]
        squared = (x**2 + y**2).ravel()
        return np.sqrt(squared / squared.max())


def calm_samples(cells: ConsistencyTable, codes: Codes) -> Samples:
    """Mean codes of surface cells in each of the views that are not HDR."""
    pixels = codes.pixels
    # Cells are thinned out rather than pixels, so that each keeps all views that share it.
    step = max(1, cells.pixel_count // (2 * MAX_SAMPLES))
    coarse = replace(cells.grid, size=CLUSTER * cells.grid.size)
    columns: list[tuple[np.ndarray, ...]] = []
    for place, index in enumerate(codes.encoded):
        rows, view = pixels.rows(index), pixels.views[index]
        every = codes.of_view(index)
        image = every.reshape(view.height, view.width, 3)
        spread = maximum_filter(image, (3, 3, 1)) - minimum_filter(image, (3, 3, 1))
        chosen = lattice_hits(pixels, index)
        chosen = chosen[(spread.max(axis=-1).ravel() <= CALM_CODES)[chosen - rows.start]]
        cell = np.searchsorted(cells.keys, cells.grid.keys(pixels, chosen))
        chosen, cell = chosen[cell % step == 0], cell[cell % step == 0]
        point, first, group = np.unique(cell, return_index=True, return_inverse=True)
        inside = chosen - rows.start
        means = grouped_means(np.column_stack([every[inside], codes.radius(index)[inside]]), group)
        cluster = coarse.keys(pixels, chosen[first])
        columns.append((point, cluster, np.full(len(point), place), means[:, 3], means[:, :3]))
    point, cluster, view_number, radius, means_of = (np.concatenate(c) for c in zip(*columns, strict=True))
    point, cluster = (np.unique(keys, return_inverse=True)[1].reshape(-1) for keys in (point, cluster))
    return Samples(point, cluster, view_number, radius, means_of)
