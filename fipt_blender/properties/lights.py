# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Lights: fixtures, new lights and the environment.

What belongs to a light is kept with it, in custom properties of its object, so that it moves with the
object into other scenes and files; the list only shows it. Their names are here for `blend` as well.
"""

from __future__ import annotations

import math
from typing import Any

import bpy

FIXTURE = "fipt_fixture"  # the fixture's name in emitters.json
NEW_LIGHT = "fipt_light"  # a light that the artist added
FIXTURE_LIGHT = "fipt_fixture_light"  # a Blender light that stands for a fixture, its child
BASE = "fipt_base"  # rgb as estimated or added: radiance of a fixture's front, watts of a light
BACK = "fipt_back"  # rgb radiance of a fixture's back
ON, SOLO, STOPS = "fipt_on", "fipt_solo", "fipt_stops"
TINT, COLOR, KELVIN = "fipt_tint", "fipt_color", "fipt_kelvin"
WRITTEN = "fipt_written"  # the strength that we wrote last; another one is the artist's
VISIBILITY = "fipt_visibility"  # of a fixture that Blender lights stand for: which rays saw it before (JSON)
WORLD_ON, WORLD_FACTOR = "fipt_on", "fipt_factor"
WORLD = "fipt_world"  # marks a world as ours; 1 where the run has an environment
OWN_WORLD = "fipt_own_world"  # of a scene: ours, while the original one is shown
MAPPING = "FIPT Mapping"

TINTS = (
    ("ESTIMATED", "As Estimated", "The colour that the photographs show", "EYEDROPPER", 0),
    ("COLOR", "Colour", "A colour of your choice, as bright as before", "COLOR", 1),
    ("TEMPERATURE", "Temperature", "The colour of a glowing body, as bright as before", "LIGHT_SUN", 2),
)
_MAX_STOPS = 20.0


def _get(key: str, default: Any) -> Any:
    def get(self: FIPT_Light) -> Any:
        return default if self.object is None else self.object.get(key, default)

    return get


def _set(key: str) -> Any:
    def set_value(self: FIPT_Light, value: Any) -> None:
        _change(self, {key: value})

    return set_value


def _change(self: FIPT_Light, values: dict[str, Any]) -> None:
    if self.object is not None:
        from ..blend.light_state import change

        change(self.id_data, self.object, values)


def _get_factor(self: FIPT_Light) -> float:
    return 2.0 ** float(_get(STOPS, 0.0)(self))


def _set_factor(self: FIPT_Light, value: float) -> None:
    _change(self, {STOPS: max(math.log2(max(value, 2.0**-_MAX_STOPS)), -_MAX_STOPS)})


def _get_color(self: FIPT_Light) -> tuple[float, float, float]:
    if self.object is None:
        return (1.0, 1.0, 1.0)
    from ..blend import tint

    return tint.shown_color(self.object)


def _set_color(self: FIPT_Light, value: Any) -> None:
    _change(self, {COLOR: tuple(value), TINT: 1})


def _get_kelvin(self: FIPT_Light) -> float:
    if self.object is None:
        return 6504.0
    from ..blend import tint

    return tint.shown_temperature(self.object)


def _set_kelvin(self: FIPT_Light, value: float) -> None:
    _change(self, {KELVIN: value, TINT: 2})


class FIPT_Light(bpy.types.PropertyGroup):
    """One row of the list: a fixture or a light that was added."""

    object: bpy.props.PointerProperty(type=bpy.types.Object)
    on: bpy.props.BoolProperty(
        name="On",
        description="Switch the light; a fixture that is off is black and still blocks light",
        get=_get(ON, True),
        set=_set(ON),
    )
    solo: bpy.props.BoolProperty(
        name="Solo",
        description="Only lights with a star shine; the others and the environment rest",
        get=_get(SOLO, False),
        set=_set(SOLO),
    )
    stops: bpy.props.FloatProperty(
        name="Stops",
        description="Power in stops: +1 is twice as bright, -1 half as bright, 0 as estimated",
        min=-_MAX_STOPS,
        max=_MAX_STOPS,
        soft_min=-5.0,
        soft_max=5.0,
        step=10,
        precision=2,
        get=_get(STOPS, 0.0),
        set=_set(STOPS),
    )
    factor: bpy.props.FloatProperty(
        name="Factor",
        description="Power as a factor: 1 is as estimated",
        min=0.0,
        soft_max=10.0,
        max=2.0**_MAX_STOPS,
        step=10,
        precision=3,
        get=_get_factor,
        set=_set_factor,
    )
    tint: bpy.props.EnumProperty(
        name="Colour From",
        description="What gives the light its colour; its brightness stays",
        items=TINTS,
        get=_get(TINT, 0),
        set=_set(TINT),
    )
    color: bpy.props.FloatVectorProperty(
        name="Colour",
        description="Colour of the light; its brightness stays",
        subtype="COLOR",
        size=3,
        min=0.0,
        max=1.0,
        get=_get_color,
        set=_set_color,
    )
    kelvin: bpy.props.FloatProperty(
        name="Temperature (K)",
        description="Colour temperature in kelvin: 2,700 is a warm lamp, 6,500 daylight; brightness stays",
        min=1000.0,
        max=20000.0,
        soft_min=1800.0,
        soft_max=12000.0,
        step=5000,
        precision=0,
        get=_get_kelvin,
        set=_set_kelvin,
    )

    def is_here(self) -> bool:
        """Whether the light is still in the list's scene."""
        return self.object is not None and self.id_data in self.object.users_scene

    def is_alive(self) -> bool:
        """The same, but quick enough for drawing: whether anything besides this row uses the object."""
        return self.object is not None and self.object.users > 1


def _own_world(scene: bpy.types.Scene) -> bpy.types.World | None:
    """Our world of a scene, shown or not."""
    for world in (scene.world, scene.get(OWN_WORLD)):
        if world is not None and WORLD in world:
            return world
    return None


def _world_value(key: str, default: Any) -> Any:
    def get(self: FIPT_LightsSettings) -> Any:
        world = _own_world(self.id_data)
        return default if world is None else world.get(key, default)

    return get


def _set_world_value(key: str) -> Any:
    def set_value(self: FIPT_LightsSettings, value: Any) -> None:
        world = _own_world(self.id_data)
        if world is not None:
            from ..blend.light_state import refresh_world

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
    active: bpy.props.IntProperty(name="Light", description="Fixtures and lights of the room", options=set())
    environment_on: bpy.props.BoolProperty(
        name="Environment",
        description="Switch the light that comes from outside the room",
        get=_world_value(WORLD_ON, True),
        set=_set_world_value(WORLD_ON),
    )
    environment_factor: bpy.props.FloatProperty(
        name="Strength",
        description="Strength of the environment: 1 is as estimated",
        min=0.0,
        soft_max=10.0,
        precision=3,
        get=_world_value(WORLD_FACTOR, 1.0),
        set=_set_world_value(WORLD_FACTOR),
    )
    environment_rotation: bpy.props.FloatProperty(
        name="Rotation",
        description="Turns the environment around the vertical axis",
        subtype="ANGLE",
        soft_min=-math.pi,
        soft_max=math.pi,
        get=_get_rotation,
        set=_set_rotation,
    )
    median_radiance: bpy.props.FloatProperty(
        description="Median radiance of the photographs, in their unit; 0 while unknown", min=0.0
    )

    def own_world(self) -> bpy.types.World | None:
        """Our world of the scene, shown or not."""
        return _own_world(self.id_data)

    def has_environment(self) -> bool:
        """Whether the run estimated light from outside."""
        world = _own_world(self.id_data)
        return world is not None and bool(world[WORLD])

    def mapping_node(self) -> bpy.types.Node | None:
        """The node that turns the environment."""
        world = _own_world(self.id_data)
        return None if world is None else world.node_tree.nodes.get(MAPPING)

    def active_light(self) -> FIPT_Light | None:
        """The row that is chosen, if its light is still there."""
        if 0 <= self.active < len(self.lights):
            light = self.lights[self.active]
            return light if light.is_alive() else None
        return None


CLASSES = (FIPT_Light, FIPT_LightsSettings)
