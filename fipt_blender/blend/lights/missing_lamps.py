# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that no photograph shows, as Blender lights of the place, size and radiance that explain it."""

from __future__ import annotations

import math

import bpy
from mathutils import Vector

from ...core.run.documents import read_document
from ...core.run.result_contents import Emitters, MissingLamp
from ...core.run.runfolder import RunFolder
from ..marks import BASE, INFERRED, MISSING_LAMP, NEW_LIGHT, UNIT
from ..outliner import LIGHTS, collection
from . import light_state
from .area_lights import shaped_light
from .calibration import scene_unit


def add_inferred(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Add the inferred lights of a run, in place of those of earlier results: without them the room is dark.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    emitters = read_document(run.emitters_json, Emitters, "Run the estimation again.")
    added = [list(item[MISSING_LAMP]) for item in scene.objects if MISSING_LAMP in item]
    inferred = {lamp.position: lamp for lamp in emitters.missing}
    for item in [item for item in scene.objects if INFERRED in item]:
        if tuple(item[MISSING_LAMP]) not in inferred:
            bpy.data.objects.remove(item)
    for lamp in inferred.values():
        if list(lamp.position) not in added:
            _add(scene, lamp)[INFERRED] = lamp.share
    light_state.refresh(scene)


def _add(scene: bpy.types.Scene, lamp: MissingLamp) -> bpy.types.Object:
    """A point light for a ball, an area light for a disc, of its position, radius (metres) and radiance."""
    size = 2.0 * lamp.radius
    item = shaped_light("Unseen Light", "POINT" if lamp.facing is None else "DISK", size, size)
    item[NEW_LIGHT] = 1
    item[MISSING_LAMP] = [float(value) for value in lamp.position]
    # P = pi A L of a sphere or a disc.
    area = (4.0 if lamp.facing is None else 1.0) * math.pi * lamp.radius**2
    item[BASE] = [math.pi * area * value for value in lamp.radiance]
    item[UNIT] = scene_unit(scene)
    item.location = lamp.position
    if lamp.facing is not None:
        item.rotation_euler = Vector(lamp.facing).to_track_quat("-Z", "Y").to_euler()
    collection(scene, LIGHTS).objects.link(item)
    return item
