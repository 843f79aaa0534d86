# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the estimate says about the pixels of some views: base colour, roughness, metallic, emitted
radiance, and how well the first three are known.

Written below results/maps for the report and for anyone who wants images instead of textures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import drjit as dr
import numpy as np

from ..capture.images import write_exr
from ..capture.views import View
from ..job.runfolder import RunFolder, read_json, write_json
from ..material.fields import RoomFields
from ..render.lights import AreaLights, EmitterTable
from ..scene.pixels import trace_pixels
from ..scene.room import Room, load_room

MAX_VIEWS = 3
MAX_WIDTH = 640


def write_view_maps(run: RunFolder, fields: RoomFields, views: Sequence[View]) -> list[Path]:
    """Write the maps of a few views, held-back ones first, and maps.json; returns the files.

    Raises:
        FiptError: where the run's room or emitters can't be read, or ``disk-full``, ``run-unwritable``.
    """
    room = load_room(run)
    table = EmitterTable.from_fixtures(read_json(run.emitters_json))
    lights = AreaLights(room.vertices, room.triangles, table)
    folder = run.results / "maps"
    listed, files = [], []
    chosen = sorted(views, key=lambda view: view.split != "held_back")[:MAX_VIEWS]
    for index, view in enumerate(chosen):
        entry = {"view": view.name}
        for name, values in view_maps(room, lights, fields, shrunk(view, MAX_WIDTH)).items():
            path = folder / f"{index:03d}_{name}.exr"
            write_exr(path, values, half=True)
            entry[name] = path.relative_to(run.root).as_posix()
            files.append(path)
        listed.append(entry)
    write_json(folder / "maps.json", {"views": listed})
    return [*files, folder / "maps.json"]


def view_maps(room: Room, lights: AreaLights, fields: RoomFields, view: View) -> dict[str, np.ndarray]:
    """The maps of one view at its pixels' centres.

    Returns:
        base_color (H,W,3), roughness (H,W), metallic (H,W), emission (H,W,3) radiance in the photographs'
        units; zero where the view misses the room, and materials zero on emitters.
    """
    surface = trace_pixels(room, view)
    emitter = lights.is_emitter(surface.triangle, surface.valid)
    facing = dr.select(surface.front, 1.0, -1.0)
    emission = np.array(lights.radiance(surface.triangle, facing, surface.valid)).T
    reflects = np.array(surface.valid & ~emitter)
    points = np.array(surface.position).T.astype(np.float32), np.array(surface.triangle)
    base_color, roughness, metallic = fields.query(*points)
    confidence = fields.confidence(*points)
    for values in (base_color, roughness, metallic, confidence):
        values[~reflects] = 0.0
    size = (view.height, view.width)
    return {
        "base_color": base_color.reshape(*size, 3),
        "roughness": roughness.reshape(size),
        "metallic": metallic.reshape(size),
        "emission": emission.reshape(*size, 3),
        "confidence": confidence.reshape(*size, 3),
    }


def shrunk(view: View, width: int) -> View:
    """The same view with fewer pixels, if it has more than `width` columns."""
    if view.width <= width:
        return view
    height = max(round(view.height * width / view.width), 1)
    x, y = width / view.width, height / view.height
    return replace(
        view, width=width, height=height, fx=view.fx * x, cx=view.cx * x, fy=view.fy * y, cy=view.cy * y
    )
