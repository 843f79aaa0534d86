"""The unit of light. Photographs tell radiance up to a factor, which the lumens of a lamp or the lux at a
place tell. From then on Blender's numbers are W/(m² sr) and W: a sky or lamps of the artist fit to the room.

Pictures stay as they are: the exposure of Cycles' film takes back what the lights get.
"""

from __future__ import annotations

import math

import bpy

from ...core.run.errors import FiptError
from ..marks import UNIT, lights_of, other_lights, result_world
from ..render_settings import is_set, set_once
from . import light_state
from .color import LUMENS_PER_WATT, luminance
from .irradiance import irradiance
from .power import lumens
from .tint import unit_of

# Metres above the place at which light is measured: the height of a lux meter's sensor.
_SENSOR = 0.02
# Steps of the unit beyond which a typed value is a mistake: sunlight is 1e5 times as strong as candlelight.
_MOST = 1e8


def scene_unit(scene: bpy.types.Scene) -> float:
    """W/(m² sr) for one of the photographs' unit; 1 as long as it is not known."""
    return float(scene.get(UNIT, 1.0))


def scale_light(scene: bpy.types.Scene, factor: float) -> None:
    """Multiply all lights and the environment, and divide the exposure of Cycles' film.

    Args:
        scene: those of the artist's own lights that are linked or keyed stay.
        factor: larger than 0.
    """
    light_state.refresh(scene)  # takes over what the artist has entered
    world = result_world(scene)
    for item in (*lights_of(scene), *([] if world is None else [world])):
        item[UNIT] = factor * unit_of(item)
    for light in {item.data for item in other_lights(scene)}:
        if light.library is None and light.animation_data is None:
            light.energy *= factor
    scene[UNIT] = factor * scene_unit(scene)
    if hasattr(scene, "cycles"):
        scene.cycles.film_exposure /= factor
        if is_set(scene) and scene.cycles.sample_clamp_indirect:  # also radiance
            clamp = factor * scene.cycles.sample_clamp_indirect
            set_once(scene, {"cycles.sample_clamp_indirect": clamp}, again=True)
    light_state.refresh(scene)


def calibrate_by_lamp(scene: bpy.types.Scene, item: bpy.types.Object, flux: float) -> float:
    """Scale all light so that a lamp, as it is set now, has a luminous flux; returns the factor."""
    return _calibrate(scene, lumens(item), flux, f"'{item.name}' emits nothing.", "Choose another lamp.")


def calibrate_by_lux(
    scene: bpy.types.Scene, place: tuple[float, float, float], lux: float, samples: int = 256
) -> float:
    """Scale all light so that a horizontal surface at a place gets an illuminance; returns the factor."""
    above = (place[0], place[1], place[2] + _SENSOR)
    found = irradiance(scene, above, samples).tolist()
    text, remedy = "No light comes from above to this place.", "Put the 3D cursor on a lit, open surface."
    return _calibrate(scene, LUMENS_PER_WATT * luminance(found), lux, text, remedy)


def _calibrate(scene: bpy.types.Scene, present: float, wanted: float, dark: str, remedy: str) -> float:
    if present <= 0.0:
        raise FiptError.of("calibration-dark", dark, remedy)
    if not 1.0 / _MOST < wanted / present < _MOST:
        raise FiptError("calibration-value", wanted=wanted, present=present)
    scale_light(scene, wanted / present)
    return wanted / present


def exposure_value(scene: bpy.types.Scene) -> float:
    """EV at ISO 100 of the scene's exposure: of what is shown as middle grey, with K = 12.5 (ISO 2720)."""
    nits = 0.18 * LUMENS_PER_WATT * scene_unit(scene) * 2.0**-scene.view_settings.exposure
    return math.log2(nits * 100.0 / 12.5)
