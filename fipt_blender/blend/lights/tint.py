"""A light's colour and power from its settings. Quick to import, since panels use it while drawing."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ..color_spaces import to_scene_linear
from ..marks import BACK, BASE, COLOR, KELVIN, STOPS, TINT, UNIT
from .color import Rgb, blackbody, luminance, near_blackbody, temperature_of, with_luminance

_ESTIMATED, _COLOR, _TEMPERATURE = 0, 1, 2


def tinted(item: bpy.types.Object, base: Sequence[float]) -> Rgb:
    """A base rgb (radiance or watts) in the light's colour, with its luminance unchanged."""
    kind = item.get(TINT, _ESTIMATED)
    if kind == _COLOR:
        return with_luminance(item.get(COLOR, (1.0, 1.0, 1.0)), luminance(base))
    if kind == _TEMPERATURE:
        return with_luminance(blackbody(item.get(KELVIN, 6504.0)), luminance(base))
    red, green, blue = base
    return (red, green, blue)


def powered(item: bpy.types.Object, base: Sequence[float]) -> Rgb:
    """A base rgb in the light's colour and at its power."""
    factor = 2.0 ** item.get(STOPS, 0.0)
    red, green, blue = (value * factor for value in tinted(item, base))
    return (red, green, blue)


def unit_of(item: bpy.types.Object | bpy.types.World) -> float:
    """By which a light's base is multiplied: W/(m² sr) for one of the photographs' unit, 1 if unknown."""
    return float(item.get(UNIT, 1.0))


def shone(item: bpy.types.Object, base: Sequence[float]) -> Rgb:
    """`powered` in the unit of the scene, which Blender's strengths are in."""
    unit = unit_of(item)
    red, green, blue = (value * unit for value in powered(item, base))
    return (red, green, blue)


def base_of(item: bpy.types.Object) -> Sequence[float]:
    """A light's base rgb: the front's, or the back's where the front is black."""
    base: Sequence[float] = item.get(BASE, (1.0, 1.0, 1.0))
    return item.get(BACK, base) if max(base) <= 0.0 else base


def shown_color(item: bpy.types.Object) -> Rgb:
    """The light's colour, its strongest channel 1."""
    return split(tinted(item, base_of(item)))[0]


def shown_temperature(item: bpy.types.Object) -> float:
    """The light's colour temperature in kelvin: the chosen one, or the nearest to its colour."""
    if item.get(TINT, _ESTIMATED) == _TEMPERATURE:
        return float(item.get(KELVIN, 6504.0))
    return temperature_of(shown_color(item))


def has_temperature(item: bpy.types.Object) -> bool:
    """Whether a temperature was chosen for the light, or describes its colour."""
    return item.get(TINT, _ESTIMATED) == _TEMPERATURE or near_blackbody(shown_color(item))


def blender_color(rgb: Sequence[float]) -> tuple[Rgb, float]:
    """Colour and strength of a Blender light or an emission node that shine with a linear Rec.709 rgb."""
    return split(to_scene_linear(rgb).tolist())


def split(rgb: Sequence[float]) -> tuple[Rgb, float]:
    """A colour whose strongest channel is 1, and its strength; white at strength 0."""
    strength = float(max(rgb))
    if strength <= 0.0:
        return (1.0, 1.0, 1.0), 0.0
    red, green, blue = (float(value) / strength for value in rgb)
    return (red, green, blue), strength
