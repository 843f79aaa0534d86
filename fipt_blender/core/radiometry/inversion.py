"""From codes back to radiance, with the relative error that grows towards both ends of the scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..capture.encoded import CLIPPED_CODE
from .adjustment import CODE_NOISE, Adjustment, falloff_terms, usable
from .contrast import Source
from .response import COMPONENTS, interpolated, response_basis, slope

# Relative error of a radiance with which a pixel has half the weight of an exact one: that of the model.
MODEL_ERROR = 0.1
# Weight of a pixel of which only a bound is known: it counts where no other pixel says more.
BOUND_WEIGHT = 0.02
# From this share of clipped pixels on a view is warned of, and from this share of points that no response
# explains.
MUCH_CLIPPED, MUCH_UNEXPLAINED = 0.15, 0.45


@dataclass(frozen=True, eq=False)
class Radiometry:
    """The camera of a capture and the settings of its views.

    Attributes:
        adjustment: of the views that are not HDR.
        contrast: of the response, from all sources.
        sources: what each of them said.
    """

    adjustment: Adjustment
    contrast: Source
    sources: tuple[Source, ...]

    @property
    def factor(self) -> float:
        """The contrast itself."""
        return float(np.exp(self.contrast.value))

    @property
    def log_curve(self) -> np.ndarray:
        """(256,) logarithm of the light of each code, 0 at the highest."""
        return self.adjustment.shape * self.factor

    @property
    def log_gains(self) -> np.ndarray:
        """(V, 3) logarithms of the factors from radiance to light; the median view's mean is 0."""
        gains = self.adjustment.log_gains * self.factor
        return gains - np.median(gains.mean(axis=1))

    def values(self, view: int, codes: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(N, 3) logarithms of the radiance of a view's codes (N, 3), over the contrast."""
        found = self.adjustment
        middle = np.median(found.log_gains.mean(axis=1))
        share = falloff_terms(radius) @ found.falloff
        return interpolated(found.shape, codes) - (found.log_gains[view] - middle) - share[:, None]

    def errors(self, codes: np.ndarray) -> np.ndarray:
        """(N, 3) relative errors of the radiance of codes (N, 3), infinite where there is only a bound."""
        error = CODE_NOISE * slope(self.log_curve, np.maximum(codes, 1.0))
        return np.where(usable(codes), error, np.inf)

    def exposure_errors(self) -> np.ndarray:
        """(V,) standard deviations of the logarithms of the views' exposures."""
        views = len(self.adjustment.log_gains)
        first = self.adjustment.covariance.shape[0] - 3 * views
        to_grey = np.kron(np.eye(views), np.full((1, 3), 1.0 / 3.0))
        to_grey -= to_grey.mean(axis=0)
        block = self.adjustment.covariance[first:, first:]
        own = np.einsum("vp,pq,vq->v", to_grey, block, to_grey) * self.factor**2
        grey = self.log_gains.mean(axis=1)
        return np.sqrt(np.maximum(own, 0.0) + (grey * self.contrast.deviation) ** 2)

    def curve_errors(self) -> np.ndarray:
        """(256,) standard deviations of the logarithm of the curve."""
        jacobian = response_basis().components
        shape = np.einsum(
            "pc,pq,qc->c", jacobian, self.adjustment.covariance[:COMPONENTS, :COMPONENTS], jacobian
        )
        return np.sqrt(
            np.maximum(shape, 0.0) * self.factor**2 + (self.log_curve * self.contrast.deviation) ** 2
        )

    def facts(self, names: Sequence[str], clipped: np.ndarray) -> dict[str, Any]:
        """For statistics.json.

        Args:
            names: of the V views.
            clipped: (V,) share of clipped pixels of each.
        """
        gains, errors = self.log_gains, self.exposure_errors()
        grey = gains.mean(axis=1)
        views = {
            name: {
                "exposure_ev": round(float(grey[i] / np.log(2.0)), 4),
                "exposure_error_ev": round(float(errors[i] / np.log(2.0)), 4),
                "white_balance": [round(float(x), 4) for x in np.exp(gains[i] - gains[i, 1])],
                "clipped": round(float(clipped[i]), 4),
                "unexplained": round(float(self.adjustment.outliers[i]), 4),
                "shared": int(self.adjustment.shared[i]),
            }
            for i, name in enumerate(names)
        }
        return {
            "log_curve": [round(float(x), 5) for x in self.log_curve],
            "log_curve_error": [round(float(x), 5) for x in self.curve_errors()],
            "falloff": [round(float(x), 5) for x in self.adjustment.falloff * self.factor],
            "contrast": {
                s.name: [round(s.value, 4), round(s.deviation, 4)] for s in (self.contrast, *self.sources)
            },
            "noise": round(self.adjustment.noise * self.factor, 4),
            "views": views,
        }


def reliability(errors: np.ndarray) -> np.ndarray:
    """(N,) float32 information of pixels of relative errors (N, 3), relative to that of exact ones."""
    worst = errors.max(axis=1)
    weight = MODEL_ERROR**2 / (MODEL_ERROR**2 + np.where(np.isfinite(worst), worst, 0.0) ** 2)
    return np.where(np.isfinite(worst), np.maximum(weight, BOUND_WEIGHT), BOUND_WEIGHT).astype(np.float32)


def is_clipped(codes: np.ndarray) -> np.ndarray:
    """(N,) bool, pixels of codes (N, 3) that are clipped in some channel."""
    return (codes >= CLIPPED_CODE).any(axis=1)
