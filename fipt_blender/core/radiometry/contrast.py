"""The response's contrast, which the agreement of the views leaves open: from EXIF's exposures, and from what
is usual. Light on the surfaces is evidence of it, too (:mod:`..light.clipped`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robust import student_weights
from .response import Basis

# Standard deviation of exposures as files state them, rounded to a third of a stop and true to a tenth or so,
# before they are compared with the gains: it counts as much as one view.
EXIF_DEVIATION = 0.12 * np.log(2.0)


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
    """The contrast by which the gains of the views fit the exposures that their files state.

    How well they fit shows how far the files can be trusted: exact exposures count more than rounded ones.

    Args:
        log_gains: (V,) found, in contrasts. exposures: (V,) relative ones, NaN where unknown.

    Returns:
        None with too few exposures, or with equal ones.
    """
    known = np.isfinite(exposures) & (exposures > 0.0)
    if known.sum() < 4:
        return None
    gains, stated = log_gains[known], np.log(exposures[known])
    weight = np.ones(len(gains))
    value, deviation = 0.0, EXIF_DEVIATION
    for _ in range(15):
        centered = gains - np.average(gains, weights=weight)
        target = stated - np.average(stated, weights=weight)
        information = float((weight * centered**2).sum())
        if information <= 1e-9:
            return None
        value = float((weight * centered * target).sum()) / information
        squared = (target - value * centered) ** 2
        # Two unknowns, the contrast and the unit, are fitted to the exposures.
        scatter = (EXIF_DEVIATION**2 + float((weight * squared).sum())) / (len(gains) - 1)
        deviation = float(np.sqrt(scatter))
        weight = student_weights(squared / scatter)
    if value <= 0.0:
        return None
    return Source("exif", float(np.log(value)), deviation / (float(np.sqrt(information)) * value))


def combined(sources: list[Source]) -> Source:
    """What independent sources say together."""
    precision = np.array([source.deviation**-2.0 for source in sources])
    values = np.array([source.value for source in sources])
    return Source(
        "combined", float((precision * values).sum() / precision.sum()), float(precision.sum() ** -0.5)
    )
