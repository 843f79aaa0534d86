"""Light that no photograph shows, as Blender lights of the place, size and radiance that explain it."""

from __future__ import annotations

import math

import bpy
from mathutils import Vector

from ...core.run.documents import read_document
from ...core.run.result_contents import Emitters, MissingLamp
from ...core.run.runfolder import RunFolder
from ..marks import BASE, INFERRED, MISSING_LAMP, NEW_LIGHT, ON, UNIT, remove_marks
from ..outliner import LIGHTS, collection
from . import light_state
from .area_lights import shaped_light
from .calibration import scene_unit

_SAME_PLACE = 1e-4  # metres
_SAME = 2.0  # distance within which lamps of two estimates are one, in its radius


def add_inferred(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Add the inferred lights of a run, in place of those of earlier results: without them the room is dark.

    Those that are still inferred keep the artist's settings; other ones with settings are switched off.
    """
    emitters = read_document(run.emitters_json, Emitters, "Run the estimation again.")
    lamps = {lamp.position: lamp for lamp in emitters.missing}
    for item in [item for item in scene.objects if INFERRED in item]:
        before = tuple(item[MISSING_LAMP])
        near = min(lamps, key=lambda place: math.dist(place, before), default=before)
        lamp = lamps.get(near)
        if lamp and math.dist(near, before) <= _SAME * lamp.radius and item.data.type == _kind(lamp)[0]:
            if math.dist(item.location, before) < _SAME_PLACE:  # else the artist has moved it
                item.location = near
            _write(item, lamps.pop(near))
        elif any(key in item for key in light_state.SETTINGS):
            remove_marks(item, INFERRED, MISSING_LAMP)
            item[ON] = False
        else:
            bpy.data.objects.remove(item)
    for lamp in lamps.values():
        _add(scene, lamp)
    light_state.refresh(scene)


def _kind(lamp: MissingLamp) -> tuple[str, str]:
    """Type and shape of a Blender light: of a ball, or of a disc."""
    return ("POINT", "POINT") if lamp.facing is None else ("AREA", "DISK")


def _add(scene: bpy.types.Scene, lamp: MissingLamp) -> None:
    """Add a point light for a ball, an area light for a disc, of its position and radius, metres."""
    item = shaped_light("Unseen Light", _kind(lamp)[1], 2.0 * lamp.radius, 2.0 * lamp.radius)
    item[NEW_LIGHT], item[UNIT] = 1, scene_unit(scene)
    item.location = lamp.position
    if lamp.facing is not None:
        item.rotation_euler = Vector(lamp.facing).to_track_quat("-Z", "Y").to_euler()
    _write(item, lamp)
    collection(scene, LIGHTS).objects.link(item)


def _write(item: bpy.types.Object, lamp: MissingLamp) -> None:
    """Give a light what is inferred besides its place and shape. P = pi A L of a sphere or a disc."""
    area = (4.0 if lamp.facing is None else 1.0) * math.pi * lamp.radius**2
    item[BASE] = [math.pi * area * value for value in lamp.radiance]
    item[MISSING_LAMP], item[INFERRED] = [float(value) for value in lamp.position], lamp.share
