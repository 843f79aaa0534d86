"""How well rooms are emptied: python benchmarks/emptied.py RUN [--scene FOLDER] [--out DIR].

RUN is a finished run of the example room or, with --scene, of a capture in the FIPT authors' layout that has
cases here. Each case removes furniture from its results and renders the place in Cycles; the truth is the
model without that furniture, rendered by the same settings. Of a capture's textures only the mean colours are
known, those of the pixels that show them. PSNRs are those of tone-mapped pixels that show the furniture
before, and of all others.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from benchmarks.disturb import read_obj  # noqa: E402
from benchmarks.metrics import psnr  # noqa: E402
from fipt_blender.core.capture.images import read_ids, read_radiance  # noqa: E402
from fipt_blender.core.report.comparison import tone_mapped  # noqa: E402

WIDTH, HEIGHT, SAMPLES = 192, 128, 64


@dataclass(frozen=True)
class Case:
    """Furniture, and the view that shows where it stood.

    Attributes:
        position, target: of the camera, in metres.
        objects: names of the furniture.
        box: its lower and upper corner, where a capture has no objects.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    objects: tuple[str, ...] = ()
    box: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None


EXAMPLE = {
    "sofa": Case((0.6, 0.9, 1.5), (-1.9, -0.3, 0.4), ("Sofa", "Pillows")),
    "armchair": Case((-0.9, 0.5, 1.6), (0.8, -1.0, 0.35), ("Armchair",)),
    "cabinet": Case((0.3, 0.9, 1.5), (2.2, -0.35, 0.4), ("Cabinet", "Cabinet_ornaments")),
}
CAPTURES = {
    "livingroom": {
        "picture": Case((0.9, -3.7, 1.6), (3.0, -2.9, 1.7), box=((2.92, -3.6, 1.2), (3.004, -2.2, 2.3))),
        "cabinet": Case(
            (0.3, -3.2, 1.4), (-2.2, -1.75, 0.6), box=((-2.425, -2.2, 0.032), (-2.05, -1.3, 1.25))
        ),
        "sofa": Case((0.4, -1.4, 1.7), (0.3, -4.5, 0.3), box=((-0.7, -4.95, 0.035), (1.3, -3.9, 0.95))),
    }
}


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


def named(case: Case) -> list[bpy.types.Object]:
    """The objects of a case's names, in whose place the example's model has spaces."""
    return [item for item in bpy.data.objects if item.name.replace(" ", "_") in case.objects]


def furniture(case: Case) -> dict[bpy.types.Object, np.ndarray]:
    """(faces,) bool of each object that has some: all faces of a case's objects, or those in its box."""
    found = {item: np.ones(len(item.data.polygons), bool) for item in named(case)}
    for item in bpy.context.scene.objects if case.box else ():
        if item.type == "MESH":
            points = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
            inside = ((points > case.box[0]) & (points < case.box[1])).all(axis=1)
            found[item] = np.array([inside[list(face.vertices)].all() for face in item.data.polygons])
    return found


def shows(chosen: dict[bpy.types.Object, np.ndarray]) -> np.ndarray:
    """(HEIGHT, WIDTH) bool: pixels whose centre shows one of these faces."""
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    corners = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=scene)]
    right_top, _, left_bottom, left_top = corners
    graph, found = bpy.context.evaluated_depsgraph_get(), np.zeros((HEIGHT, WIDTH), bool)
    for row, column in np.ndindex(HEIGHT, WIDTH):
        right, down = (column + 0.5) / WIDTH, (row + 0.5) / HEIGHT
        point = left_top + right * (right_top - left_top) + down * (left_bottom - left_top)
        start = camera.matrix_world.translation
        hit, _, _, face, item, _ = scene.ray_cast(graph, start, point - start)
        found[row, column] = hit and item in chosen and chosen[item][face]
    return found


def emptied(run: Path, case: Case) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """The estimated room before and after furniture is removed; names of what completes it."""
    from fipt_blender import api

    bpy.ops.wm.open_mainfile(filepath=str(run / "room.blend"), load_ui=False, use_scripts=False)
    look(bpy.context.scene, case.position, case.target)
    before, box = picture(), None
    if case.box:
        low, high = map(np.array, case.box)
        box = bpy.data.objects.new("Removed", None)
        box.empty_display_type, box.location, box.scale = "CUBE", (low + high) / 2.0, (high - low) / 2.0
        bpy.context.scene.collection.objects.link(box)
        bpy.context.view_layer.update()
    surfaces = api.remove_from_room(named(case), box)
    return before, picture(), surfaces


def build_capture(folder: Path) -> None:
    """Model a capture by its mesh and its tables of materials and emitters into an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices, triangles = read_obj(folder / "scene.obj")
    mesh, table = bpy.data.meshes.new("scene"), np.load(folder / "scene.npz")
    mesh.from_pydata(vertices[:, [0, 2, 1]] * (1.0, -1.0, 1.0), [], triangles)  # its vertical is Y
    for row in json.loads((folder / "materials.json").read_text())["materials"]:
        number = row["id"] - 1
        color = mean_color(folder, row["id"]) if row["texture"] else row["base_color"]
        radiance = table["radiance"][table["material"] == number].max(axis=0, initial=0.0)
        mesh.materials.append(principled(row, color, radiance))
    mesh.polygons.foreach_set("material_index", table["material"])
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("scene", mesh))


def mean_color(folder: Path, number: int) -> np.ndarray:
    """(3,) mean base colour of the pixels of the training views that show a material."""
    found = [
        read_radiance(path)[read_ids(folder / "train" / "IndexMA" / path.name) == number]
        for path in sorted((folder / "train" / "BaseColor").iterdir())
    ]
    return np.asarray(np.concatenate(found).mean(axis=0))


def principled(row: dict[str, float], color: np.ndarray, radiance: np.ndarray) -> bpy.types.Material:
    """A material of materials.json; what emits is black behind."""
    material = bpy.data.materials.new(str(row["name"]))
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = nodes["Principled BSDF"].inputs
    shader["Base Color"].default_value = (*color, 1.0)
    shader["Roughness"].default_value, shader["Metallic"].default_value = row["roughness"], row["metallic"]
    if radiance.any():
        shader["Specular IOR Level"].default_value = 0.0
        shader["Emission Color"].default_value = (*(radiance / radiance.max()), 1.0)
        side = nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"]
        front = nodes.new("ShaderNodeMath")
        front.operation, front.inputs[1].default_value = "MULTIPLY_ADD", -float(radiance.max())
        front.inputs[2].default_value = float(radiance.max())
        links.new(side, front.inputs[0])
        links.new(front.outputs[0], shader["Emission Strength"])
    return material


def truth(case: Case, build: Callable[[], None]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The modelled room with and without the furniture; (HEIGHT, WIDTH) bool, the pixels that show it."""
    import bmesh

    build()
    look(bpy.context.scene, case.position, case.target)
    chosen = furniture(case)
    region, whole = shows(chosen), picture()
    for item, faces in chosen.items():
        mesh = bmesh.new()
        mesh.from_mesh(item.data)
        bmesh.ops.delete(mesh, geom=[face for face in mesh.faces if faces[face.index]], context="FACES")
        mesh.to_mesh(item.data)
    return whole, picture(), region


def compared(made: np.ndarray, true: np.ndarray, region: np.ndarray) -> float:
    """PSNR in dB of a picture within a region."""
    return psnr(float(((tone_mapped(made)[region] - tone_mapped(true)[region]) ** 2).mean()))


def main() -> None:
    """Print the figures of all cases, and keep their pictures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--scene", type=Path, help="folder of the capture; the example room without")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "emptied")
    options = parser.parse_args()
    import make_room

    import fipt_blender

    fipt_blender.register()
    options.out.mkdir(parents=True, exist_ok=True)
    cases = EXAMPLE
    build = partial(make_room.build_room, 1, options.out / "textures", thin=False)  # examples/room's seed
    if options.scene:
        cases, build = CAPTURES[options.scene.name], partial(build_capture, options.scene)
    for name, case in cases.items():
        before, after, surfaces = emptied(options.run.resolve(), case)
        whole, empty, region = truth(case, build)
        np.savez(
            options.out / f"{name}.npz", before=before, after=after, whole=whole, empty=empty, region=region
        )
        figures = {
            "emptied": compared(after, empty, region),
            "with the furniture": compared(before, empty, region),
            "around": compared(after, empty, ~region),
            "estimate": compared(before, whole, ~region),
        }
        found = ", ".join(f"{name} {value:.1f} dB" for name, value in figures.items())
        print(f"{name}: {found}; {', '.join(surfaces)}", flush=True)


if __name__ == "__main__":
    main()
