# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well the estimate is known: standard errors of base colour, roughness and metallic.

The factorised rendering (paper Eq. 5) is linearised around the estimate, and its residuals against the
photographs tell how far the values may be off: where little light falls, or where few views or none that
differ see a surface, a small residual leaves much open. Errors of shadings are alike within a view, so that
the views are the independent samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .projection import DARK

# Standard deviation of a value of which nothing is known but that it lies in [0, 1].
UNKNOWN = 12.0**-0.5
# Share of the error of base colour that all views have in common: what falls on a matt surface is the same
# light for all of them. Calibrated on the example room.
COMMON = 0.5
# Error of base colour that no residual shows: detail within a cell, the level of all light.
FLOOR = 0.02
# Below this sum of weighted squared slopes pixels say nothing.
NOTHING = 1e-9
# Views' worth of evidence with which a cell's residuals are drawn to those of its part.
PRIOR_VIEWS = 4.0


def confidence(errors: np.ndarray) -> np.ndarray:
    """1 - error / 0.29 of standard errors (any shape): 1 is certain, 0 as good as any value in [0, 1]."""
    return np.clip(1.0 - errors / UNKNOWN, 0.0, 1.0).astype(np.float32)


@dataclass(frozen=True)
class Evidence:
    """N pixels against the estimate, each (N, 3) float32.

    Attributes:
        residual: photographed minus rendered radiance.
        weight: of squared residuals.
        by_color, by_roughness, by_metallic: derivatives of the rendered radiance.
    """

    residual: np.ndarray
    weight: np.ndarray
    by_color: np.ndarray
    by_roughness: np.ndarray
    by_metallic: np.ndarray


def evidence(
    radiance: np.ndarray,
    color: np.ndarray,
    roughness: np.ndarray,
    metallic: np.ndarray,
    diffuse: np.ndarray,
    specular: np.ndarray,
    levels: np.ndarray,
) -> Evidence:
    """What N pixels say.

    Args:
        radiance: (N, 3) photographed, in units of the capture's median.
        color: (N, 3), roughness and metallic: (N,), the estimate.
        diffuse, specular: shadings (N, 3) and (N, K, 2, 3) at the roughness `levels` (K,).
    """
    low = np.clip(np.searchsorted(levels, roughness, side="right") - 1, 0, len(levels) - 2)
    rows = np.arange(len(roughness))
    below, above = specular[rows, low].astype(np.float32), specular[rows, low + 1].astype(np.float32)
    step = (levels[low + 1] - levels[low]).astype(np.float32)
    share = ((roughness - levels[low]) / step)[:, None, None]
    slope = (above - below) / step[:, None, None]
    s0, s1 = np.moveaxis(below + share * (above - below), 1, 0)
    m = metallic[:, None]
    gloss = 0.04 * (1.0 - m) + color * m
    by_color = (1.0 - m) * diffuse + m * s0
    rendered = (1.0 - m) * color * diffuse + gloss * s0 + s1
    return Evidence(
        radiance - rendered,
        1.0 / (radiance + DARK) ** 2,
        by_color,
        gloss * slope[:, 0] + slope[:, 1],
        (color - 0.04) * s0 - color * diffuse,
    )


def standard_errors(
    seen: Evidence,
    roughness: np.ndarray,
    metallic: np.ndarray,
    cell: np.ndarray,
    group: np.ndarray,
    view: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard errors by least squares, never above `UNKNOWN`.

    Args:
        seen: N pixels.
        roughness, metallic: (N,), the estimate.
        cell: (N,) int from 0, surface cell of each; base colour is one of each cell.
        group: (N,) int from 0, what shares roughness and metallic; each cell lies in one group.
        view: (N,) int.

    Returns:
        (cells,) of base colour, root mean square of the channels; (groups,) of roughness and of metallic.
    """
    cells, groups = int(cell.max(initial=-1)) + 1, int(group.max(initial=-1)) + 1
    weighted = seen.weight * seen.by_color
    information = _sums(weighted * seen.by_color, cell, cells)
    information = np.maximum(information, NOTHING)
    remaining = _sums(weighted * seen.residual, cell, cells) / information
    residual = seen.residual - seen.by_color * remaining[cell]
    errors, trades = [], []
    for value, slope in ((roughness, seen.by_roughness), (metallic, seen.by_metallic)):
        # Base colour makes up for a part of each: only the rest tells.
        trade = _sums(weighted * slope, cell, cells) / information
        own = slope - seen.by_color * trade[cell]
        mean = np.bincount(group, value, minlength=groups) / np.maximum(
            np.bincount(group, minlength=groups), 1
        )
        errors.append(_shared_error(own, residual, seen.weight, mean, group, view))
        trades.append(trade)
    of_cell = np.zeros(cells, np.int64)
    of_cell[cell] = group
    views, spread = _spread(seen, information, cell, of_cell, view)
    variance = spread * (views * COMMON + 1.0 - COMMON)[:, None] / information
    variance[information <= NOTHING] = np.inf
    variance += FLOOR**2
    for error, trade in zip(errors, trades, strict=True):
        variance += (trade * error[of_cell][:, None]) ** 2
    return _bounded(variance.mean(axis=1)), errors[0], errors[1]


def _spread(
    seen: Evidence, information: np.ndarray, cell: np.ndarray, group: np.ndarray, view: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Views of each cell (cells,), and (cells, 3) variance of a view's residual in units of its weight."""
    pair, of_pair = np.unique(
        cell.astype(np.int64) * (int(view.max(initial=0)) + 1) + view, return_inverse=True
    )
    owner = pair // (int(view.max(initial=0)) + 1)
    weighted = seen.weight * seen.by_color
    score = _sums(weighted * seen.residual, of_pair, len(pair))
    known = np.maximum(_sums(weighted * seen.by_color, of_pair, len(pair)), 1e-12)
    views = np.bincount(owner, minlength=len(information)).astype(float)
    total = _sums(score**2 / known, owner, len(information))
    single = total / np.maximum(views, 1.0)[:, None]
    # A median a part: a few cells at edges are far off.
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    typical = np.zeros((int(group.max(initial=-1)) + 1, 3))
    for part in np.split(order, starts[1:]) if len(order) else []:
        typical[group[part[0]]] = np.median(single[part], axis=0)
    return views, (total + PRIOR_VIEWS * typical[group]) / (views + PRIOR_VIEWS)[:, None]


def _shared_error(
    slope: np.ndarray,
    residual: np.ndarray,
    weight: np.ndarray,
    value: np.ndarray,
    group: np.ndarray,
    view: np.ndarray,
) -> np.ndarray:
    """(groups,) standard error of a value in [0, 1] that each group shares (`value`, (groups,))."""
    groups, views = len(value), int(view.max(initial=-1)) + 1
    information = np.maximum(np.bincount(group, (weight * slope**2).sum(axis=1), minlength=groups), NOTHING)
    score = (weight * slope * residual).sum(axis=1)
    by_view = np.bincount(group * views + view, score, minlength=groups * views).reshape(groups, views)
    looks = np.bincount(group * views + view, minlength=groups * views).reshape(groups, views) > 0
    number = looks.sum(axis=1)
    # What the residuals would still change, as far as the bounds allow, counts as error too.
    change = np.clip(value + by_view.sum(axis=1) / information, 0.0, 1.0) - value
    centred = by_view - looks * (by_view.sum(axis=1) / np.maximum(number, 1))[:, None]
    variance = (centred**2).sum(axis=1) / information**2 * number / np.maximum(number - 1, 1) + change**2
    return np.where((number > 1) & (information > NOTHING), _bounded(variance), UNKNOWN)


def _bounded(variance: np.ndarray) -> np.ndarray:
    """Standard errors, together with what is known beforehand: that the value lies in [0, 1]."""
    return np.sqrt(1.0 / (1.0 / np.maximum(variance, 1e-12) + UNKNOWN**-2))


def _sums(values: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) sums of values (N, 3) by their index (N,)."""
    return np.stack([np.bincount(index, column, minlength=count) for column in values.T], axis=1)
