"""Colours of light: luminance, the colour of a black body and the temperature of a colour.

Linear Rec.709 throughout. Standard library only, since the panel uses it while drawing.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from functools import lru_cache

Rgb = tuple[float, float, float]
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of Rec.709's primaries (ITU-R BT.709)
# Lumens per watt of channels that LUMINANCE weights: these weights are the eye's response, so that only its
# maximum is left, that of SI (at 540 THz). Blender's glTF files and its sky count in the same watts.
LUMENS_PER_WATT = 683.0
KELVIN_MIN, KELVIN_MAX = 1000.0, 20000.0
# Distance in CIE 1960 uv up to which a temperature describes a colour; the 0.05 of CIE 15 include pale green.
MAX_DUV = 0.02
_RGB_FROM_XYZ = (
    (3.2404542, -1.5371385, -0.4985314),
    (-0.9692660, 1.8760108, 0.0415560),
    (0.0556434, -0.2040259, 1.0572252),
)
_XYZ_FROM_RGB = (
    (0.4124564, 0.3575761, 0.1804375),
    (0.2126729, 0.7151522, 0.0721750),
    (0.0193339, 0.1191920, 0.9503041),
)


def luminance(rgb: Sequence[float]) -> float:
    """Luminance of a linear Rec.709 colour, in the colour's unit."""
    return sum(weight * value for weight, value in zip(LUMINANCE, rgb, strict=True))


def with_luminance(rgb: Sequence[float], target: float) -> Rgb:
    """A colour scaled to a luminance; black becomes white."""
    present = luminance(rgb)
    if present <= 1e-9:
        return (target, target, target)
    red, green, blue = (value * target / present for value in rgb)
    return (red, green, blue)


@lru_cache(maxsize=64)
def blackbody(kelvin: float) -> Rgb:
    """Colour of a black body, of luminance 1, without negative values.

    Args:
        kelvin: temperature; clamped to 1,000 to 20,000.
    """
    u, v = _blackbody_uv(min(max(kelvin, KELVIN_MIN), KELVIN_MAX))
    xyz = (1.5 * u / v, 1.0, (2.0 - 0.5 * u - 5.0 * v) / v)
    red, green, blue = (max(sum(map(operator.mul, row, xyz)), 0.0) for row in _RGB_FROM_XYZ)
    return with_luminance((red, green, blue), 1.0)


def temperature_of(rgb: Rgb) -> float:
    """Correlated colour temperature in kelvin: the nearest black body in the CIE 1960 diagram.

    Colours far from the black bodies get the nearer end of the scale, 1,000 or 20,000.
    """
    return _nearest(rgb)[0]


def near_blackbody(rgb: Rgb) -> bool:
    """Whether a colour is so near to a black body's that a temperature describes it."""
    return _nearest(rgb)[1] <= MAX_DUV


@lru_cache(maxsize=256)
def _nearest(rgb: Rgb) -> tuple[float, float]:
    """Temperature in kelvin of the nearest black body, and the distance to it (Duv)."""
    xyz = [sum(map(operator.mul, row, rgb)) for row in _XYZ_FROM_RGB]
    if xyz[1] <= 0.0 or not all(map(math.isfinite, xyz)):
        return 6504.0, 0.0
    uv = _uv(xyz)
    points = _locus()
    distances = [math.dist(uv, point) for _, point in points]
    nearest = min(range(len(points)), key=distances.__getitem__)
    # Interpolate between the neighbours of the nearest point of the locus.
    low, high = max(nearest - 1, 0), min(nearest + 1, len(points) - 1)
    (mired, start), (mired_end, end) = points[low], points[high]
    segment = (end[0] - start[0], end[1] - start[1])
    along = (uv[0] - start[0]) * segment[0] + (uv[1] - start[1]) * segment[1]
    share = min(max(along / (segment[0] ** 2 + segment[1] ** 2), 0.0), 1.0)
    foot = (start[0] + share * segment[0], start[1] + share * segment[1])
    return 1.0e6 / (mired + share * (mired_end - mired)), math.dist(uv, foot)


@lru_cache(maxsize=1)
def _locus() -> list[tuple[float, tuple[float, float]]]:
    """The black bodies' locus: reciprocal temperature in mired, and CIE 1960 uv."""
    count = 80
    first, last = 1.0e6 / KELVIN_MAX, 1.0e6 / KELVIN_MIN
    mireds = [first + (last - first) * index / (count - 1) for index in range(count)]
    return [(mired, _blackbody_uv(1.0e6 / mired)) for mired in mireds]


def _uv(xyz: Sequence[float]) -> tuple[float, float]:
    """CIE 1960 chromaticity."""
    x, y, z = xyz
    total = x + 15.0 * y + 3.0 * z
    return 4.0 * x / total, 6.0 * y / total


def _blackbody_uv(kelvin: float) -> tuple[float, float]:
    """CIE 1960 chromaticity of a black body (Krystek 1985, within 1e-4 from 1,000 to 15,000 K)."""
    u = (0.860117757 + 1.54118254e-4 * kelvin + 1.28641212e-7 * kelvin**2) / (
        1.0 + 8.42420235e-4 * kelvin + 7.08145163e-7 * kelvin**2
    )
    v = (0.317398726 + 4.22806245e-5 * kelvin + 4.20481691e-8 * kelvin**2) / (
        1.0 - 2.89741816e-5 * kelvin + 1.61456053e-7 * kelvin**2
    )
    return u, v
