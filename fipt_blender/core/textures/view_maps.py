"""Maps of the estimate in the pixels of some views: base colour, roughness, metallic, emission, confidence.

They are written to results/maps, for the report and for users who want images instead of textures.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import drjit as dr
import numpy as np

from ..capture.images import write_exr
from ..capture.views import View
from ..light.baking import SUBPIXELS
from ..material.fields import RoomFields
from ..optics.lights import AreaLights, EmitterTable
from ..pixels.camera_rays import trace_pixels
from ..run.documents import read_document
from ..run.result_contents import Emitters
from ..run.runfolder import RunFolder, write_json
from ..surface.room import Room, load_room


def write_view_maps(run: RunFolder, fields: RoomFields, views: Sequence[View]) -> list[Path]:
    """Write the maps of up to three views, preferably held-back ones, and maps.json; returns the files."""
    room = load_room(run)
    table = EmitterTable.from_fixtures(read_document(run.emitters_json, Emitters).fixtures)
    lights = AreaLights(room.vertices, room.triangles, table)
    folder = run.results / "maps"
    listed, files = [], []
    chosen = sorted(views, key=lambda view: view.split != "held_back")[:3]
    for index, view in enumerate(chosen):
        names = {}
        for name, values in view_maps(room, lights, fields, shrunk(view, 640)).items():
            path = folder / f"{index:03d}_{name}.exr"
            write_exr(path, values, half=True)
            names[name] = path.relative_to(run.root).as_posix()
            files.append(path)
        listed.append({"view": view.name, **names})
    write_json(folder / "maps.json", {"views": listed})
    return [*files, folder / "maps.json"]


def view_maps(room: Room, lights: AreaLights, fields: RoomFields, view: View) -> dict[str, np.ndarray]:
    """The maps of one view: means over places in each pixel, as a photograph is a mean over the pixel.

    Returns:
        Arrays by name: base_color (H,W,3), roughness (H,W), metallic (H,W), emission (H,W,3) radiance in the
        photographs' units, confidence (H,W,3). All are zero where the view does not see the room; all but
        emission are zero on emitters.
    """
    surface = trace_pixels(room, view, SUBPIXELS)
    emitter = np.array(lights.is_emitter(surface.triangle, surface.valid))
    facing = dr.select(surface.front, 1.0, -1.0)
    emission = np.array(lights.radiance(surface.triangle, facing, surface.valid)).T
    # Rays that miss the room have no surface point of which the fields could be asked.
    valid = np.array(surface.valid)
    points = np.array(surface.position).T.astype(np.float32)[valid], np.array(surface.triangle)[valid]
    base_color, roughness, metallic = fields.query(*points)
    confidence = fields.confidence(*points)

    def means(values: np.ndarray) -> np.ndarray:
        return values.reshape(view.height, view.width, len(SUBPIXELS), *values.shape[1:]).mean(axis=2)

    def on_surfaces(values: np.ndarray) -> np.ndarray:
        places = np.zeros((len(valid), *values.shape[1:]), np.float32)
        places[valid] = values
        places[emitter] = 0.0
        return means(places)

    return {
        "base_color": on_surfaces(base_color),
        "roughness": on_surfaces(roughness),
        "metallic": on_surfaces(metallic),
        "emission": means(emission),
        "confidence": on_surfaces(confidence),
    }


def shrunk(view: View, width: int) -> View:
    """The same view with a lower resolution if it has more than `width` columns."""
    if view.width <= width:
        return view
    height = max(round(view.height * width / view.width), 1)
    return view.resized(width, height)
