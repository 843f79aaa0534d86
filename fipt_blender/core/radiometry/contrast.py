# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The response's contrast, which the agreement of the views leaves open: from EXIF's exposures, and from what
is usual. Light on the surfaces tells it, too (:mod:`..light.clipped`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .response import Basis

# Exposures as files tell them: rounded to a third of a stop, and true to a tenth or so.
EXIF_DEVIATION = 0.12 * np.log(2.0)
_LEAST_EXPOSURES = 4
_DEGREES = 3.0
_ITERATIONS = 15


@dataclass(frozen=True)
class Source:
    """What one source says of the logarithm of the contrast.

    Attributes:
        name: ``usual``, ``exif``, ``light`` or, of all together, ``combined``.
        value: expected logarithm.
        deviation: its standard deviation.
    """

    name: str
    value: float
    deviation: float


def usual_contrast(basis: Basis) -> Source:
    """The prior: the contrast of the basis's curves."""
    return Source("usual", basis.contrast, basis.contrast_deviation)


def exif_contrast(log_gains: np.ndarray, exposures: np.ndarray) -> Source | None:
    """The contrast by which the gains of the views fit the exposures that their files tell.

    Args:
        log_gains: (V,) found, in contrasts. exposures: (V,) relative ones, NaN where unknown.

    Returns:
        None with too few exposures, or with equal ones.
    """
    known = np.isfinite(exposures) & (exposures > 0.0)
    if known.sum() < _LEAST_EXPOSURES:
        return None
    found, told = log_gains[known], np.log(exposures[known])
    weight = np.ones(len(found))
    value = residual = 0.0
    for _ in range(_ITERATIONS):
        centered = found - np.average(found, weights=weight)
        target = told - np.average(told, weights=weight)
        information = float((weight * centered**2).sum())
        if information <= 1e-9:
            return None
        value = float((weight * centered * target).sum()) / information
        residual = (target - value * centered) / EXIF_DEVIATION
        weight = (_DEGREES + 1.0) / (_DEGREES + residual**2)
    if value <= 0.0:
        return None
    scatter = max(1.0, float(np.average(np.square(residual), weights=weight)))
    return Source(
        "exif", float(np.log(value)), EXIF_DEVIATION * float(np.sqrt(scatter / information)) / value
    )


def combined(sources: list[Source]) -> Source:
    """What independent sources say together."""
    precision = np.array([source.deviation**-2.0 for source in sources])
    values = np.array([source.value for source in sources])
    return Source(
        "combined", float((precision * values).sum() / precision.sum()), float(precision.sum() ** -0.5)
    )
