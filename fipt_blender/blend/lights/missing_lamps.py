# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that the mesh lacks, as Blender lights of their place, size and radiance.

Photographs show them, or nothing shows them, and they are inferred.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import bpy
from mathutils import Vector

from ...core.run.documents import read_document
from ...core.run.kinds import as_json
from ...core.run.result_contents import Emitters
from ...core.run.runfolder import RunFolder
from ..marks import BASE, INFERRED, MISSING_LAMP, NEW_LIGHT, UNIT
from ..outliner import LIGHTS, collection
from . import light_state
from .calibration import scene_unit


def note_missing(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Remember with the scene which missing lamps of a run have no light yet, for the panel.

    Inferred ones get theirs at once, in place of those of earlier results: without them the room is dark.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    emitters = read_document(run.emitters_json, Emitters, "Run the estimation again.")
    added = [list(item[MISSING_LAMP]) for item in scene.objects if MISSING_LAMP in item]
    inferred = {lamp.position: lamp for lamp in emitters.missing if lamp.inferred}
    for item in [item for item in scene.objects if INFERRED in item]:
        if tuple(item[MISSING_LAMP]) not in inferred:
            bpy.data.objects.remove(item)
    for lamp in inferred.values():
        if list(lamp.position) not in added:
            _add(scene, as_json(lamp))[INFERRED] = lamp.share
    light_state.refresh(scene)
    lamps = [
        lamp
        for lamp in emitters.missing
        if max(lamp.radiance) > 0.0 and not lamp.inferred and list(lamp.position) not in added
    ]
    scene.fipt.lights.missing_lamps = json.dumps(lamps, default=as_json) if lamps else ""


def add_missing(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """A point light for each lamp that was noted; they are noted no longer."""
    settings = scene.fipt.lights
    lamps = json.loads(settings.missing_lamps or "[]")
    made = [_add(scene, lamp) for lamp in lamps]
    settings.missing_lamps = ""
    light_state.refresh(scene)
    light_state.list_lights(scene)
    return made


def _add(scene: bpy.types.Scene, lamp: Mapping[str, Any]) -> bpy.types.Object:
    """A point light for a ball, an area light for a disc, of its position, radius (metres) and radiance."""
    name, facing = "Unseen Light" if lamp.get("inferred") else "Missing Lamp", lamp.get("facing")
    data = bpy.data.lights.new(name, "POINT" if facing is None else "AREA")
    if facing is None:
        data.shadow_soft_size = lamp["radius"]
        if hasattr(data, "use_soft_falloff"):  # without it the falloff is that of a sphere
            data.use_soft_falloff = False
    else:
        data.shape, data.size = "DISK", 2.0 * lamp["radius"]
    item = bpy.data.objects.new(data.name, data)
    item[NEW_LIGHT] = 1
    item[MISSING_LAMP] = [float(value) for value in lamp["position"]]
    # P = pi A L of a sphere or a disc.
    area = (4.0 if facing is None else 1.0) * math.pi * lamp["radius"] ** 2
    item[BASE] = [math.pi * area * value for value in lamp["radiance"]]
    item[UNIT] = scene_unit(scene)
    item.location = lamp["position"]
    if facing is not None:
        item.rotation_euler = Vector(facing).to_track_quat("-Z", "Y").to_euler()
    collection(scene, LIGHTS).objects.link(item)
    return item
