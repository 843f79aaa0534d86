# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well rooms are emptied: python benchmarks/emptied.py RUN [--out DIR].

RUN is a finished run of the example room. Each case removes furniture from its results and renders the place
in Cycles; the truth is the example's own model without that furniture, rendered by the same settings. PSNRs
are those of tone-mapped pixels that show the furniture before, and of all others.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from benchmarks.metrics import psnr  # noqa: E402
from fipt_blender.core.report.comparison import tone_mapped  # noqa: E402

# name -> objects, the camera's place and target in the room (metres)
CASES = {
    "sofa": (("Sofa", "Pillows"), (0.6, 0.9, 1.5), (-1.9, -0.3, 0.4)),
    "armchair": (("Armchair",), (-0.9, 0.5, 1.6), (0.8, -1.0, 0.35)),
    "cabinet": (("Cabinet", "Cabinet_ornaments"), (0.3, 0.9, 1.5), (2.2, -0.35, 0.4)),
}
WIDTH, HEIGHT, SAMPLES = 192, 128, 64


def look(scene: bpy.types.Scene, position: tuple[float, ...], target: tuple[float, ...]) -> None:
    """Let the scene's camera look at a target, with a lens of 75 degrees."""
    camera = bpy.data.objects.new("emptied", bpy.data.cameras.new("emptied"))
    scene.collection.objects.link(camera)
    scene.camera, camera.data.angle = camera, np.radians(75.0)
    camera.location = position
    camera.rotation_euler = (Vector(target) - camera.location).to_track_quat("-Z", "Y").to_euler()
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    bpy.context.view_layer.update()


def picture() -> np.ndarray:
    """(HEIGHT, WIDTH, 3) radiance that the scene's camera sees."""
    from benchmarks.cycles_pixels import render_pixels
    from fipt_blender.blend.pictures.cycles import RenderOptions

    return render_pixels(bpy.context.scene, RenderOptions(SAMPLES))


def shows(names: tuple[str, ...]) -> np.ndarray:
    """(HEIGHT, WIDTH) bool: pixels whose centre shows one of these objects."""
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    corners = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=scene)]
    right_top, _, left_bottom, left_top = corners
    graph, found = bpy.context.evaluated_depsgraph_get(), np.zeros((HEIGHT, WIDTH), bool)
    for row, column in np.ndindex(HEIGHT, WIDTH):
        right, down = (column + 0.5) / WIDTH, (row + 0.5) / HEIGHT
        point = left_top + right * (right_top - left_top) + down * (left_bottom - left_top)
        start = camera.matrix_world.translation
        hit, *_, item, _ = scene.ray_cast(graph, start, point - start)
        found[row, column] = hit and item.name.replace(" ", "_") in names
    return found


def furniture(names: tuple[str, ...]) -> list[bpy.types.Object]:
    """The objects of these names, in whose place the example's model has spaces."""
    return [item for item in bpy.data.objects if item.name.replace(" ", "_") in names]


def emptied(run: Path, case: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """The estimated room before and after furniture is removed; names of what completes it."""
    from fipt_blender import api

    names, position, target = CASES[case]
    bpy.ops.wm.open_mainfile(filepath=str(run / "room.blend"), load_ui=False, use_scripts=False)
    look(bpy.context.scene, position, target)
    before = picture()
    surfaces = api.remove_from_room(furniture(names))
    return before, picture(), surfaces


def truth(case: str, textures: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The modelled room with and without the furniture; (HEIGHT, WIDTH) bool, the pixels that show it."""
    import make_room

    names, position, target = CASES[case]
    make_room.build_room(1, textures, thin=False)  # the seed of examples/room
    look(bpy.context.scene, position, target)
    region, whole = shows(names), picture()
    bpy.data.batch_remove(furniture(names))
    return whole, picture(), region


def compared(made: np.ndarray, true: np.ndarray, region: np.ndarray) -> float:
    """PSNR in dB of a picture within a region."""
    return psnr(float(((tone_mapped(made)[region] - tone_mapped(true)[region]) ** 2).mean()))


def main() -> None:
    """Print the figures of all cases, and keep their pictures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "emptied")
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    options = parser.parse_args()
    import fipt_blender

    fipt_blender.register()
    options.out.mkdir(parents=True, exist_ok=True)
    for case in options.cases:
        before, after, surfaces = emptied(options.run.resolve(), case)
        whole, empty, region = truth(case, options.out / "textures")
        np.savez(options.out / f"{case}.npz", before=before, after=after, whole=whole, empty=empty)
        figures = {
            "emptied": compared(after, empty, region),
            "with the furniture": compared(before, empty, region),
            "around": compared(after, empty, ~region),
            "estimate": compared(before, whole, ~region),
        }
        found = ", ".join(f"{name} {value:.1f} dB" for name, value in figures.items())
        print(f"{case}: {found}; {', '.join(surfaces)}", flush=True)


if __name__ == "__main__":
    main()
