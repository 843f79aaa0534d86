"""Pixels with their shadings, read from the memory-mapped arrays of a run."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..light.observations import Observations
from ..run.threads import cached_property, in_threads

# Pixels whose windows are averaged at a time, so that their arrays stay in the processor's cache.
WINDOW_BLOCK = 1 << 13
# Residuals are relative to radiance plus this, in units of the capture's median radiance.
RADIANCE_FLOOR = 0.05


@dataclass(frozen=True)
class PixelSamples:
    """N pixels with the shadings of the surfaces that they see.

    Attributes:
        rows: (N,) int64 indices among the pixels of the run.
        radiance: (N, 3) float32 radiance of the surface that the pixel's centre sees, in units of the
            capture's median.
        diffuse: (N, 3) float32 diffuse shading L_d, in the same unit.
        specular: (N, K, 2, 3) float32 specular shadings L_s0 and L_s1 at the roughness `levels`.
        levels: (K,) float32 roughness levels, ascending.
        cell: (N,) int, from 0: surface cell in which base colour is constant.
        group: (N,) int part, or the group in its place (:mod:`.groups`), with one roughness and one metallic;
            negative for pixels without one.
        view: (N,) int index of the view.
        weight: (N,) float32 information of the radiance, 1 for pure pixels and less for mixed ones: the
            inverse variance of its residuals relative to those of pure pixels.
    """

    rows: np.ndarray
    radiance: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    levels: np.ndarray
    cell: np.ndarray
    group: np.ndarray
    view: np.ndarray
    weight: np.ndarray

    def take(self, chosen: np.ndarray, **changes: np.ndarray) -> PixelSamples:
        """The samples `chosen` ((n,) int or (N,) bool), with other values of the attributes `changes`."""
        names = {field.name for field in fields(self)} - {"levels", *changes}
        arrays: dict[str, Any] = {name: getattr(self, name)[chosen] for name in names}
        return PixelSamples(levels=self.levels, **arrays, **changes)

    @cached_property
    def square_weight(self) -> np.ndarray:
        """(N, 3) weight of the squared residuals of the pixels' radiance."""
        return residual_weight(self.radiance) * self.weight[:, None]


def residual_weight(radiance: np.ndarray) -> np.ndarray:
    """Weight of squared residuals, the same shape: they count relative to the photographed radiance."""
    return 1.0 / (radiance + RADIANCE_FLOOR) ** 2


def window_means(
    arrays: Sequence[np.ndarray],
    rows: np.ndarray,
    pure: np.ndarray,
    group: np.ndarray,
    ranges: np.ndarray,
    widths: np.ndarray,
) -> list[np.ndarray]:
    """Means over the pure pixels of the same group and view in the 3 × 3 window around each pixel.

    The rendering is linear in the shadings, so the means of both sides of Eq. 5 agree where base colour is
    constant. Averaging reduces the noise, and with it the errors that differ between roughness levels.

    Args:
        arrays: each (N, ...), values of all pixels, ordered by view and row-major; may be memory-mapped.
        rows: (M,) int indices of the pixels whose means are wanted; these count in any case.
        pure: (N,) bool, whether a pixel sees a single surface. group: (N,) int.
        ranges: (views + 1,) int index of the first pixel of each view, and N.
        widths: (views,) int image width of each view.

    Returns:
        (M, ...) float32 each.
    """

    def of_block(rows: np.ndarray) -> list[np.ndarray]:
        sums = [np.zeros((len(rows), *array.shape[1:]), np.float32) for array in arrays]
        count = np.zeros(len(rows), np.float32)
        view = np.searchsorted(ranges, rows, side="right") - 1
        first, end, width, row_group = ranges[view], ranges[view + 1], widths[view], group[rows]
        column = (rows - first) % width
        for down, right in itertools.product((-1, 0, 1), repeat=2):
            neighbour = rows + down * width + right
            inside = (neighbour >= first) & (neighbour < end)
            inside &= (column + right >= 0) & (column + right < width)
            neighbour = np.where(inside, neighbour, rows)
            counted = inside & (group[neighbour] == row_group) & pure[neighbour]
            counted |= (down == 0) & (right == 0)
            index = np.flatnonzero(counted)
            for total, array in zip(sums, arrays, strict=True):
                total[index] += array[neighbour[index]]
            count[index] += 1.0
        return [total / count.reshape(-1, *[1] * (total.ndim - 1)) for total in sums]

    blocks = [rows[start : start + WINDOW_BLOCK] for start in range(0, max(len(rows), 1), WINDOW_BLOCK)]
    return [np.concatenate(found) for found in zip(*in_threads(of_block, blocks), strict=True)]


def rows_with_donor(observations: Observations, view: int) -> np.ndarray:
    """(n,) int64 pixels of a view that have a donor."""
    rows = observations.pixels.rows(view)
    return np.flatnonzero(observations.donor[rows] >= 0) + rows.start
