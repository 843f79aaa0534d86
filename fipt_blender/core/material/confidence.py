"""Standard errors of the estimated base colour by least squares, given those of roughness and metallic.

The factorised rendering (paper Eq. 5) is linearised around the estimate. The spread of its residuals between
views gives the variance of the values: it is large where little light falls, or where few views, or views
that hardly differ, see a surface, even if the residuals are small. Errors of the shadings are correlated
within a view, so the views are the independent samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..pixels.grouped import grouped_median, grouped_sums, pairs_of
from .pixel_samples import residual_weight

# Standard deviation of a value of which nothing is known but that it lies in [0, 1].
UNIFORM_DEVIATION = 12.0**-0.5
# Share of the variance of base colour that all views have in common, because the same light falls on a matt
# surface in all of them. Calibrated on the example room.
COMMON = 0.5
# Errors that nothing shows: of base colour, detail within a cell and the overall brightness of the light; of
# roughness and metallic, what the model of the shadings' errors gets wrong.
FLOOR = 0.02
# Variance that lost detail and moved borders, which no residual shows, add to base colour, per metre of the
# place's standard deviation: its share of the surface has another colour. Calibrated on the example room,
# scanned at 2 cm; checked on the living room.
LOST_VARIANCE = 0.18
# Pixels whose sum of weighted squared slopes (their Fisher information) is smaller determine nothing.
MIN_INFORMATION = 1e-9
# Number of views to which the group's typical residual variance is equivalent, as a prior for its cells.
PRIOR_VIEWS = 4.0


def errors_with_place(errors: np.ndarray, place: float) -> np.ndarray:
    """Standard errors (C, 3) of base colour, roughness and metallic; a doubtful place adds to the first.

    Args:
        place: standard deviation of the place of surfaces, metres (:attr:`.Room.place`).
    """
    color = np.hypot(errors[:, 0], np.sqrt(LOST_VARIANCE * place))
    return np.column_stack([np.minimum(color, UNIFORM_DEVIATION), errors[:, 1:]]).astype(np.float32)


def no_better_than(errors: np.ndarray, deviation: float) -> np.ndarray:
    """Standard errors (C, 3), none of which is below what re-rendered photographs allow.

    Args:
        deviation: root mean square error of display values (`Quality.deviation`). Relative to a value d of
            them, radiance and base color are off by 2.2 times as much; typical are d = 0.65 and 0.4.
    """
    least = min(2.2 * deviation / 0.65 * 0.4, UNIFORM_DEVIATION)
    return np.maximum(errors, np.float32(least))


def confidence(errors: np.ndarray) -> np.ndarray:
    """1 - error / 0.289 of standard errors (any shape), float32: 1 is certain, 0 means unknown."""
    return np.clip(1.0 - errors / UNIFORM_DEVIATION, 0.0, 1.0).astype(np.float32)


@dataclass(frozen=True)
class LinearisedPixels:
    """The rendering of N pixels, linearised around the estimate.

    Attributes:
        residual: (N, 3) photographed minus rendered radiance.
        weight: (N, 3) weight of the squared residual.
        by_color: (N, 3) derivative of the rendered radiance by base colour.
        by_roughness, by_metallic: (N, 3) its change where roughness or metallic changes by its error.
    """

    residual: np.ndarray
    weight: np.ndarray
    by_color: np.ndarray
    by_roughness: np.ndarray
    by_metallic: np.ndarray


def linearise(
    radiance: np.ndarray,
    lines: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    color: np.ndarray,
    material: np.ndarray,
    errors: np.ndarray,
) -> LinearisedPixels:
    """Eq. 5 linearised at the estimate.

    Args:
        radiance: (N, 3) photographed.
        lines: roughness and metallic (N, 2) to slope and offset of the rendering (:func:`.color_lines`).
        color: (N, 3). material, errors: (N, 2) roughness and metallic, and their standard errors.
    """

    def rendered(step: np.ndarray) -> np.ndarray:
        slope, offset = lines(np.clip(material + step * errors, 0.0, 1.0))
        return slope * color + offset

    slope, offset = lines(material)
    changes = [0.5 * (rendered(step) - rendered(-step)) for step in np.eye(2, dtype=np.float32)]
    return LinearisedPixels(radiance - slope * color - offset, residual_weight(radiance), slope, *changes)


def standard_errors(
    pixels: LinearisedPixels, cell: np.ndarray, group: np.ndarray, view: np.ndarray
) -> np.ndarray:
    """(cells,) standard errors of base colour by least squares, root mean square over the channels.

    They are never above `UNIFORM_DEVIATION`.

    Args:
        cell: (N,) int, from 0: surface cell of each pixel, which has one base colour.
        group: (N,) int, from 0: cells of similar residuals; each cell lies in one group.
        view: (N,) int.
    """
    cells = int(cell.max(initial=-1)) + 1
    weighted = pixels.weight * pixels.by_color
    information = grouped_sums(weighted * pixels.by_color, cell, cells)
    information = np.maximum(information, MIN_INFORMATION)
    group_of_cell = np.zeros(cells, np.int64)
    group_of_cell[cell] = group
    views, spread = _view_variance(pixels, cell, view, information, group_of_cell)
    variance = spread * (views * COMMON + 1.0 - COMMON)[:, None] / information
    variance[information <= MIN_INFORMATION] = np.inf
    variance += FLOOR**2
    for change in (pixels.by_roughness, pixels.by_metallic):
        # Base colour compensates part of a wrong roughness or metallic.
        variance += (grouped_sums(weighted * change, cell, cells) / information) ** 2
    return np.sqrt(1.0 / (1.0 / np.maximum(variance.mean(axis=1), 1e-12) + UNIFORM_DEVIATION**-2))


def _view_variance(
    pixels: LinearisedPixels,
    cell: np.ndarray,
    view: np.ndarray,
    information: np.ndarray,
    group_of_cell: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(cells,) number of views of each cell, and (cells, 3) variance of a view's weighted residual.

    Args:
        cell, view: (N,) int of the pixels.
        information: (cells, 3). group_of_cell: (cells,) int.
    """
    cell_of_pair, _, pair_of_pixel = pairs_of(cell, view)
    weighted = pixels.weight * pixels.by_color
    score = grouped_sums(weighted * pixels.residual, pair_of_pixel)
    pair_information = np.maximum(grouped_sums(weighted * pixels.by_color, pair_of_pixel), 1e-12)
    views = np.bincount(cell_of_pair, minlength=len(information)).astype(float)
    total = grouped_sums(score**2 / pair_information, cell_of_pair, len(information))
    of_cell = total / np.maximum(views, 1.0)[:, None]
    # The median of a group: a few cells at edges are far off.
    typical = grouped_median(of_cell, group_of_cell, int(group_of_cell.max(initial=-1)) + 1)
    return views, (total + PRIOR_VIEWS * typical[group_of_cell]) / (views + PRIOR_VIEWS)[:, None]
