"""Response curves in a small basis: which radiance a camera's code stands for.

A curve is the logarithm of the light of each code, 0 at the highest. Views that see the same surfaces
determine its shape but not its contrast: with all logarithms times a factor, they agree as well. Therefore a
curve is its contrast, the logarithm between two codes, times a shape of contrast 1. The basis of the shapes
comes from a principal component analysis of curves drawn from four families of functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

LEVELS = 256  # codes of a channel
COMPONENTS = 4  # of the basis of responses
# Codes between which a curve's contrast is measured, as shares of the highest.
LOW_ANCHOR, HIGH_ANCHOR = 51, 204
# Codes below this are mostly noise; curves are steep there.
LOWEST_CODE = 4.0
# Curves that the basis is made of.
DRAWN = 800
_GAMMAS = (1.6, 2.8)


@dataclass(frozen=True, eq=False)
class Basis:
    """Shapes of curves.

    Attributes:
        mean: (256,) mean shape.
        components: (COMPONENTS, 256), each with the size of its standard deviation.
        contrast: mean of the logarithm of the curves' contrast.
        contrast_deviation: its standard deviation.
    """

    mean: np.ndarray
    components: np.ndarray
    contrast: float
    contrast_deviation: float

    def shape(self, weights: np.ndarray) -> np.ndarray:
        """(256,) increasing shape of contrast 1 with these weights (COMPONENTS,)."""
        curve = self.mean + weights @ self.components
        # Curves rise from each code to the next, so that they have an inverse.
        steps = np.maximum(np.diff(curve), 1e-4)
        curve = np.concatenate([[0.0], np.cumsum(steps)])
        curve -= curve[-1]
        return curve / (curve[HIGH_ANCHOR] - curve[LOW_ANCHOR])


@cache
def response_basis() -> Basis:
    """The basis of the shapes, the same in every process."""
    rng = np.random.default_rng(7)
    curves = np.stack([_drawn_curve(rng) for _ in range(DRAWN)])
    contrast = curves[:, HIGH_ANCHOR] - curves[:, LOW_ANCHOR]
    shapes = curves / contrast[:, None]
    mean = shapes.mean(axis=0)
    # The darkest codes vary most between curves and are known least: their weight is lower.
    weight = np.clip(np.arange(LEVELS) / 32.0, 0.1, 1.0)
    centered = (shapes - mean) * weight
    variances, directions = np.linalg.eigh(centered.T @ centered / DRAWN)
    sizes, directions = (
        np.sqrt(variances[: -COMPONENTS - 1 : -1]),
        directions.T[: -COMPONENTS - 1 : -1] / weight,
    )
    signs = np.sign(directions[:, LOW_ANCHOR // 2])  # otherwise arbitrary
    logarithm = np.log(contrast)
    return Basis(mean, directions * (signs * sizes)[:, None], float(logarithm.mean()), float(logarithm.std()))


def interpolated(curve: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Values of a curve (256,) at codes from 0 to 255 that need not be whole."""
    return np.interp(codes, np.arange(LEVELS), curve)


def slope(curve: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Derivatives of a curve (256,) by the code."""
    return np.interp(codes, np.arange(LEVELS), np.gradient(curve))


def _drawn_curve(rng: np.random.Generator) -> np.ndarray:
    """(256,) logarithm of the light of each code of one curve drawn by chance."""
    light = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 1024)])
    family = rng.integers(4)
    power = 1.0 / rng.uniform(*_GAMMAS)
    if family == 0:  # a power with a linear foot, as in video standards
        offset = rng.uniform(0.0, 0.12)
        value = _powers_with_foot(light, power, offset)
    elif family == 1:  # film: the exponential approach to its densest value
        strength = rng.uniform(0.1, 2.5)
        value = (1.0 - np.exp(-strength * light**power)) / (1.0 - np.exp(-strength))
    elif family == 2:  # saturation of receptors
        half = rng.uniform(0.4, 6.0)
        value = light**power * (1.0 + half) / (light**power + half)
    else:  # a power followed by an S of tanh
        value = light**power
        steepness, centre = rng.uniform(0.2, 2.2), rng.uniform(0.35, 0.65)
        low, high = np.tanh(-steepness * centre), np.tanh(steepness * (1.0 - centre))
        value = (np.tanh(steepness * (value - centre)) - low) / (high - low)
    toe = rng.uniform(0.0, 0.4) * (rng.random() < 0.5)  # darker shadows
    value = value * (1.0 - toe * np.exp(-value / rng.uniform(0.05, 0.3)))
    codes = np.arange(LEVELS) / (LEVELS - 1.0)
    codes[0] = 0.5 / (LEVELS - 1.0)
    return np.interp(codes, value / value[-1], np.log(np.maximum(light, 1e-7)))


def _powers_with_foot(light: np.ndarray, power: float, offset: float) -> np.ndarray:
    """A power law that is linear below the light at which its tangent passes through zero."""
    if offset < 1e-4:
        return light**power
    joint = (offset / ((1.0 + offset) * (1.0 - power))) ** (1.0 / power)
    foot = ((1.0 + offset) * joint**power - offset) / joint
    return np.where(light < joint, foot * light, (1.0 + offset) * light**power - offset)
