# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that the photographs show and the mesh lacks, as Blender lights of their place, size and radiance."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import bpy

from ...core.run.documents import read_document
from ...core.run.kinds import as_json
from ...core.run.result_contents import Emitters
from ...core.run.runfolder import RunFolder
from ..marks import BASE, MISSING_LAMP, NEW_LIGHT, UNIT
from ..outliner import LIGHTS, collection
from . import light_state
from .calibration import scene_unit


def note_missing(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Remember with the scene which missing lamps of a run have no light yet, for the panel.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    emitters = read_document(run.emitters_json, Emitters, "Run the estimation again.")
    added = [list(item[MISSING_LAMP]) for item in scene.objects if MISSING_LAMP in item]
    lamps = [
        lamp for lamp in emitters.missing if max(lamp.radiance) > 0.0 and list(lamp.position) not in added
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
    """A point light of a ball's position, radius (metres) and radiance."""
    data = bpy.data.lights.new("Missing Lamp", "POINT")
    data.shadow_soft_size = lamp["radius"]
    if hasattr(data, "use_soft_falloff"):  # without it the falloff is that of a sphere
        data.use_soft_falloff = False
    item = bpy.data.objects.new(data.name, data)
    item[NEW_LIGHT] = 1
    item[MISSING_LAMP] = [float(value) for value in lamp["position"]]
    # P = pi A L of a sphere.
    item[BASE] = [4.0 * math.pi**2 * lamp["radius"] ** 2 * value for value in lamp["radiance"]]
    item[UNIT] = scene_unit(scene)
    item.location = lamp["position"]
    collection(scene, LIGHTS).objects.link(item)
    return item
