"""What a room looks like in renders, comparisons and exports, measured in a Blender with its own OCIO.

As a module, with a folder and the working space where that is not the default, it writes seen.json to the folder.
"""

from __future__ import annotations

import json
import os
import re
import signal
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector

import fipt_blender
from benchmarks.cycles_pixels import render_pixels
from fipt_blender.blend.color_spaces import to_scene_linear
from fipt_blender.blend.export.exporting import export_room
from fipt_blender.blend.insert.balls import add_ball
from fipt_blender.blend.lights import light_state
from fipt_blender.blend.marks import fixtures_of
from fipt_blender.blend.pictures.cycles import RenderOptions
from fipt_blender.blend.render_settings import set_up
from fipt_blender.blend.results import maps
from fipt_blender.properties.materials import SHOWN
from samples import applied_rooms, rendered_rooms
from samples.spots import spot_camera

CUSTOM = (1.0, 0.25, 0.5)


def measure(folder: Path, monkeypatch: pytest.MonkeyPatch, working_space: str = "") -> dict:
    """Colours in linear Rec.709, with the extension registered; working spaces came with Blender 5.0."""
    seen = {}
    for part in (applied, compared):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        if working_space:
            bpy.ops.wm.set_working_color_space(working_space=working_space, convert_colors=True)
        seen |= part(folder / part.__name__, monkeypatch)
    return seen


def spot(scene: bpy.types.Scene, position: tuple, target: tuple) -> list[float]:
    """The mean radiance (3,) of a spot that a camera at `position` sees."""
    options = RenderOptions(64, denoise=False)
    with spot_camera(scene, position, target, 5, 0.2):
        return [float(value) for value in render_pixels(scene, options).mean(axis=(0, 1))]


def imported_texel(path: Path) -> list[float]:
    """The first texel (3,) of the base colour in a .glb file, in sRGB's codes from 0 to 1."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path))
    bpy.data.batch_remove(set(bpy.data.objects) - before)
    images = [image for image in bpy.data.images if "base_color" in image.name]
    (texel,) = {tuple(image.pixels[:3]) for image in images}
    return list(texel)


def applied(folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict:
    """Results: renders of lamp, room and sky, the panel's colours and what exports hold."""
    seen = {}
    scene = applied_rooms.make_applied_scene(folder / "run", monkeypatch)
    set_up(scene)
    (lamp,) = fixtures_of(scene)
    light_state.refresh(scene)
    seen["lamp"] = spot(scene, (2.5, 0.5, 2.0), (2.5, 0.5, 0.0))
    seen["cube"] = spot(scene, (0.0, 5.0, 4.0), (0.0, 5.0, 1.0))
    seen["sky"] = spot(scene, (0.0, -9.0, 0.0), (0.0, -20.0, 0.0))
    for suffix in ("glb", "usda"):
        path = folder / f"room.{suffix}"
        export_room(scene, path)
        text = path.read_bytes().decode("latin-1")
        if suffix == "usda":
            seen["usda"] = json.loads(re.search(r"emissiveColor = \((.*?)\)", text)[1].join("[]"))
        else:
            lit = re.search(r'"emissiveFactor":(\[.*?\]).*?"emissiveStrength":([\d.]+)', text)
            seen["glb"] = [value * float(lit[2]) for value in json.loads(lit[1])]
            seen["texture"] = imported_texel(path)
    light_state.list_lights(scene)
    (row,) = (row for row in scene.fipt.lights.lights if row.object == lamp)
    row.color = to_scene_linear(CUSTOM)  # as in the panel's field
    np.testing.assert_allclose(row.color, to_scene_linear(CUSTOM), rtol=1e-3)
    seen["custom"] = spot(scene, (2.5, 0.5, 2.0), (2.5, 0.5, 0.0))
    for name, *_ in SHOWN:
        maps.show(scene, name)
    maps.show(scene, "ESTIMATED")
    sample = add_ball(scene, Vector((0.0, -5.0, 0.0)), "gray_ball", 4.0)
    seen["ball"] = spot(scene, (0.0, -9.0, 1.0), (0.0, -5.0, 1.0))
    bpy.data.objects.remove(sample)
    return seen


def compared(folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict:
    """A picture over a photograph, which is itself a render of the room."""
    run = rendered_rooms.make_scene(folder)
    scene = bpy.context.scene
    floor = bpy.data.objects["Floor"].data.materials[0]
    floor.node_tree or setattr(floor, "use_nodes", True)
    photo = rendered_rooms.photograph(run, 64)
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    bpy.ops.fipt.final_picture()
    picture = Path(scene.fipt.insert.picture).with_suffix(".exr")
    composite = rendered_rooms.exr_layers(picture)["Composite.Combined"][..., :3]
    return {"composite": float(np.abs(composite - photo).max()) < 1e-3 * float(photo.max())}


if __name__ == "__main__":
    fipt_blender.register()
    root, *space = sys.argv[1:]
    (Path(root) / "seen.json").write_text(json.dumps(measure(Path(root), pytest.MonkeyPatch(), *space)))
    os.kill(os.getpid(), signal.SIGTERM)  # leaving some modules of Blender fails
