"""State of the section Lights: fixtures, new lights and the environment.

The settings of a light are custom properties of its object, so that they move with the object into other
scenes and files; the list only shows them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import bpy

from ..blend.marks import (
    BAKED,
    COLOR,
    FIXTURE,
    KELVIN,
    MAPPING,
    ON,
    SOLO,
    STOPS,
    TINT,
    UNIT,
    VISIBILITY,
    WORLD,
    WORLD_FACTOR,
    WORLD_ON,
    is_linked,
    light_probe,
    result_world,
)

TINTS = (
    ("ESTIMATED", "As Estimated", "The estimated color", "EYEDROPPER", 0),
    ("COLOR", "Color", "A custom color with unchanged brightness", "COLOR", 1),
    ("TEMPERATURE", "Temperature", "A blackbody color with unchanged brightness", "LIGHT_SUN", 2),
)
_MAX_STOPS = 20.0

Value = TypeVar("Value", bool, int, float)


def _get(key: str, default: Value) -> Callable[[FIPT_Light], Value]:
    def get(self: FIPT_Light) -> Value:
        return default if self.object is None else self.object.get(key, default)

    return get


def _set(key: str) -> Callable[[FIPT_Light, float], None]:
    def set_value(self: FIPT_Light, value: float) -> None:
        _change(self, {key: value})

    return set_value


def _change(self: FIPT_Light, values: Mapping[str, float | Sequence[float]]) -> None:
    if self.object is not None and not is_linked(self.object):
        from ..blend.lights.light_state import change

        change(self.id_data, self.object, values)


def _switch(key: str, name: str, text: str, default: bool) -> object:
    """A switch of a light."""
    shown = {"name": name, "description": text, "options": set()}
    return bpy.props.BoolProperty(get=_get(key, default), set=_set(key), **shown)


def _quantity(name: str, label: str, text: str, step: int, precision: int) -> object:
    """A quantity of `blend.lights.power` that is proportional to a light's power."""

    def get(self: FIPT_Light) -> float:
        if self.object is None:
            return 0.0
        from ..blend.lights import power

        return float(getattr(power, name)(self.object))

    def set_value(self: FIPT_Light, value: float) -> None:
        from ..blend.lights import power

        stops = power.stops_for(value, get(self), float(_get(STOPS, 0.0)(self)))
        _change(self, {STOPS: min(max(stops, -_MAX_STOPS), _MAX_STOPS)})

    shown = {"name": label, "description": text, "step": step, "precision": precision}
    return bpy.props.FloatProperty(min=0.0, options=set(), get=get, set=set_value, **shown)


def _tinted(function: str, default: Any, key: str, tint: int) -> dict[str, Callable[..., object]]:
    """Getter and setter of what a light's color is made from, by a function of `blend.lights.tint`."""

    def get(self: FIPT_Light) -> object:
        if self.object is None:
            return default
        from ..blend.color_spaces import to_scene_linear
        from ..blend.lights import tint as tints

        found = getattr(tints, function)(self.object)
        return to_scene_linear(found).tolist() if key == COLOR else found

    def set_value(self: FIPT_Light, value: Any) -> None:
        if key == COLOR:
            from ..blend.color_spaces import from_scene_linear

            value = from_scene_linear(value).clip(0.0).tolist()
        _change(self, {key: value, TINT: tint})

    return {"get": get, "set": set_value}


class FIPT_Light(bpy.types.PropertyGroup):
    """One row of the list: a fixture or an added light."""

    object: bpy.props.PointerProperty(type=bpy.types.Object)
    on: _switch(
        ON, "On", "Switch the light on or off. A fixture that is off is black and still blocks light", True
    )
    solo: _switch(SOLO, "Solo", "Switch off the environment and all lights that are not solo", False)
    stops: bpy.props.FloatProperty(
        name="Stops",
        description="Power in stops: 0 is as estimated, +1 is twice as bright, -1 is half as bright",
        min=-_MAX_STOPS,
        max=_MAX_STOPS,
        soft_min=-5.0,
        soft_max=5.0,
        step=10,
        precision=2,
        options=set(),
        get=_get(STOPS, 0.0),
        set=_set(STOPS),
    )
    watts: _quantity(
        "watts",
        "Power (W)",
        "Power as in Blender's own lights, of the strongest channel. Only ratios count"
        " until the light is calibrated by one lamp",
        100,
        2,
    )
    lumens: _quantity(
        "lumens",
        "Lumens",
        "Luminous flux: what a lamp's package says. True once the light is calibrated",
        1000,
        0,
    )
    radiance: _quantity(
        "radiance",
        "Radiance",
        "Radiance of the lamp's surface, W/(m² sr) once the light is calibrated, of the strongest channel;"
        " that of the first of joined lamps",
        100,
        2,
    )
    tint: bpy.props.EnumProperty(
        name="Color From",
        description="Source of the light's color. The brightness does not change",
        items=TINTS,
        options=set(),
        get=_get(TINT, 0),
        set=_set(TINT),
    )
    color: bpy.props.FloatVectorProperty(
        name="Color",
        description="Color of the light. The brightness does not change",
        subtype="COLOR",
        size=3,
        min=0.0,
        max=1.0,
        options=set(),
        **_tinted("shown_color", (1.0, 1.0, 1.0), COLOR, 1),
    )
    kelvin: bpy.props.FloatProperty(
        name="Temperature (K)",
        description="Color temperature in kelvin: 2,700 is a warm lamp, 6,500 is daylight. The brightness"
        " does not change",
        min=1000.0,
        max=20000.0,
        soft_min=1800.0,
        soft_max=12000.0,
        step=5000,
        precision=0,
        options=set(),
        **_tinted("shown_temperature", 6504.0, KELVIN, 2),
    )

    def has_power(self) -> bool:
        """Whether the light has a power in watts."""
        from ..blend.lights.power import has_power

        return has_power(self.object)

    def has_temperature(self) -> bool:
        """Whether the light's color is that of a temperature."""
        from ..blend.lights.tint import has_temperature

        return has_temperature(self.object)

    def is_here(self) -> bool:
        """Whether the light is still in the list's scene."""
        return self.object is not None and self.id_data in self.object.users_scene

    def is_alive(self) -> bool:
        """As `is_here`, but quick enough for drawing: whether anything besides this row uses the object."""
        return self.object is not None and self.object.users > 1


def _world_value(key: str, default: Value) -> Callable[[FIPT_LightsSettings], Value]:
    def get(self: FIPT_LightsSettings) -> Value:
        world = result_world(self.id_data)
        return default if world is None else world.get(key, default)

    return get


def _set_world_value(key: str) -> Callable[[FIPT_LightsSettings, float], None]:
    def set_value(self: FIPT_LightsSettings, value: float) -> None:
        world = result_world(self.id_data)
        if world is not None:
            from ..blend.lights.light_state import refresh_world

            world[key] = value
            refresh_world(self.id_data)

    return set_value


def _get_rotation(self: FIPT_LightsSettings) -> float:
    node = self.mapping_node()
    return 0.0 if node is None else float(node.inputs["Rotation"].default_value[2])


def _set_rotation(self: FIPT_LightsSettings, value: float) -> None:
    node = self.mapping_node()
    if node is not None:
        node.inputs["Rotation"].default_value[2] = value


class FIPT_LightsSettings(bpy.types.PropertyGroup):
    """The section Lights."""

    lights: bpy.props.CollectionProperty(type=FIPT_Light)
    active: bpy.props.IntProperty(
        name="Light", description="Fixtures and added lights of the room", options=set()
    )
    environment_on: bpy.props.BoolProperty(
        name="Environment",
        description="Switch the light from outside the room on or off",
        options=set(),
        get=_world_value(WORLD_ON, True),
        set=_set_world_value(WORLD_ON),
    )
    environment_factor: bpy.props.FloatProperty(
        name="Strength",
        description="Strength of the environment: 1 is as estimated",
        min=0.0,
        soft_max=10.0,
        precision=3,
        options=set(),
        get=_world_value(WORLD_FACTOR, 1.0),
        set=_set_world_value(WORLD_FACTOR),
    )
    environment_rotation: bpy.props.FloatProperty(
        name="Rotation",
        description="Rotation of the environment about the vertical axis",
        subtype="ANGLE",
        soft_min=-math.pi,
        soft_max=math.pi,
        options=set(),
        get=_get_rotation,
        set=_set_rotation,
    )
    median_radiance: bpy.props.FloatProperty(
        description="Median radiance of the photographs, in their unit; 0 if unknown", min=0.0
    )
    median_shown: bpy.props.FloatProperty(
        description="Value between black and white at which the photographs show their median radiance",
        default=0.18,
        min=1e-6,
    )

    def result_world(self) -> bpy.types.World | None:
        """The world that applying results created for the scene, whether it is shown or not."""
        return result_world(self.id_data)

    def needs_cycles(self) -> bool:
        """Whether the engine is EEVEE and a fixture's surface emits, which lights nothing there."""
        return "EEVEE" in self.id_data.render.engine and any(
            row.is_alive() and row.on and FIXTURE in row.object and VISIBILITY not in row.object
            for row in self.lights
        )

    def needs_probe(self) -> bool:
        """Whether the engine is EEVEE and no baked volume gives it the light that the room reflects."""
        scene = self.id_data
        if "EEVEE" not in scene.render.engine or not scene.fipt.materials.object_count:
            return False
        probe = light_probe(scene)
        return probe is None or BAKED not in probe

    def is_calibrated(self) -> bool:
        """Whether the unit of light is known."""
        return UNIT in self.id_data

    def has_environment(self) -> bool:
        """Whether light from outside the room was estimated."""
        world = result_world(self.id_data)
        return world is not None and bool(world[WORLD])

    def mapping_node(self) -> bpy.types.Node | None:
        """The node that rotates the environment."""
        world = result_world(self.id_data)
        return None if world is None else world.node_tree.nodes.get(MAPPING)

    def active_light(self) -> FIPT_Light | None:
        """The active row, if its light still exists."""
        if 0 <= self.active < len(self.lights):
            light = self.lights[self.active]
            return light if light.is_alive() else None
        return None
