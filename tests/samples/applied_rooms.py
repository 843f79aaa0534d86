"""A small room with a finished run, and an engine that bakes constants for Apply Results."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from fipt_blender.blend import outliner
from fipt_blender.blend.pictures.image_files import read_pixels
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.textures import bake
from fipt_blender.jobs import run_job
from samples.at_once import export_room
from samples.spots import spot_camera

MEDIAN = 0.36
RADIANCE = [8.0, 4.0, 2.0]


class ConstantFields:
    base_color, roughness, metallic = (0.6, 0.3, 0.1), 0.7, 0.25

    def query(self, positions, triangles):
        count = len(positions)
        base_color = np.tile(self.base_color, (count, 1))
        return base_color, np.full(count, self.roughness), np.full(count, self.metallic)

    def confidence(self, positions, triangles):
        return np.ones((len(positions), 3))


def use_fake_engine(monkeypatch, fields=None) -> list[str]:
    """Let Apply Results bake fields in this process, `ConstantFields` without any; returns the list to which bakes
    are added."""
    bakes: list[str] = []
    real = run_job.open_job

    def fake(step, run):
        def work():
            made = bake.textures_made(run)
            if made.kept() is None:
                bakes.append(step.name)
                with made.making():
                    bake.bake(run, fields or ConstantFields())

        return replace(step, command=None, function=work) if step.command else step

    def open_job(run, steps, *_, **options):
        return real(run, [fake(step, run) for step in steps], run_job.Launch(Path(sys.executable), {}), **options)

    monkeypatch.setattr(run_job, "open_job", open_job)
    return bakes


def panel_and_cube() -> list[bpy.types.Object]:
    """A mirrored panel of three quads, of which the last is a lamp, and a cube with a bevel and slots on mesh
    and object."""
    mesh = bpy.data.meshes.new("panel")
    points = [(x, y, 0.0) for x in range(4) for y in range(2)]
    mesh.from_pydata(points, [], [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(3)])
    panel = bpy.data.objects.new("panel", mesh)
    panel.matrix_world = Matrix.Translation((5, 0, 0)) @ Matrix.Diagonal((-1, 1, 1, 1))
    bpy.context.scene.collection.objects.link(panel)
    bpy.ops.mesh.primitive_cube_add(location=(0, 5, 0))
    cube = bpy.context.object
    cube.modifiers.new("Bevel", "BEVEL")
    for name in ("red", "green", "blue"):
        cube.data.materials.append(bpy.data.materials.new(name))
    cube.material_slots[1].link = "OBJECT"
    cube.material_slots[1].material = bpy.data.materials.new("own")
    cube.data.polygons.foreach_set("material_index", np.array([0, 1, 2, 2, 1, 0], np.int32))
    return [panel, cube]


def emitter(name: str, triangles: np.ndarray, centroid=(2.5, 0.5, 0.0), back=(0.0, 0.0, 0.0)) -> dict:
    """An entry of emitters.json whose front shines with RADIANCE; by default the panel's lamp."""
    entry = {"name": name, "triangles": triangles.tolist(), "radiance": RADIANCE, "back_radiance": list(back)}
    return {**entry, "area": 1.0, "centroid": [float(value) for value in centroid], "power": [0, 0, 0]}


def make_scene(folder: Path, environment: bool = True) -> bpy.types.Scene:
    """A file with an artist's room (`panel_and_cube`), world and lights, and the run estimated from it."""
    scene = bpy.context.scene
    room = outliner.collection(scene, outliner.ROOM)
    panel, cube = panel_and_cube()
    cube.name = "cube"
    for item in (panel, cube):
        item.users_collection[0].objects.unlink(item)
        room.objects.link(item)
    cube.modifiers["Bevel"].show_render = False
    cube.active_material_index = 2
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    scene.collection.objects.link(lamp)
    scene.world = bpy.data.worlds.new("sky")
    scene.view_settings.exposure = 1.25
    bpy.context.view_layer.update()

    run = RunFolder(folder)
    run.create(make_settings())
    arrays = export_room([panel, cube], run)
    lit = np.flatnonzero((arrays.triangle_object == 0) & (arrays.triangle_polygon == 2))
    sky = {"image": "environment.exr", "observed_share": 1.0} if environment else None
    if environment:
        write_exr(run.environment_exr, np.full((8, 16, 3), 2.0, np.float32))
    write_json(run.emitters_json, {"fixtures": [emitter("Fixture.001", lit)], "environment": sky})
    write_json(run.statistics_json, {"radiance_scale": MEDIAN})
    run.fields_npz.write_bytes(b"estimated")
    scene.fipt.run_folder = str(folder)
    scene.fipt.materials.texel_density = 16.0
    return scene


def make_applied_scene(folder: Path, monkeypatch) -> bpy.types.Scene:
    """The file of `make_scene` with its run's results applied, by an engine that bakes `ConstantFields`."""
    use_fake_engine(monkeypatch)
    scene = make_scene(folder)
    assert bpy.ops.fipt.apply_results() == {"FINISHED"}
    return scene


def front(item: bpy.types.Object) -> np.ndarray:
    """Radiance (3,) of a fixture's front in its material."""
    bpy.context.view_layer.update()
    node = item.data.materials[0].node_tree.nodes["FIPT Front"]
    return np.array(node.inputs["Color"].default_value)[:3] * node.inputs["Strength"].default_value


def world_strength() -> float:
    return bpy.data.worlds["FIPT World"].node_tree.nodes["FIPT Background"].inputs["Strength"].default_value


def picture(scene, position, target, size=9, ortho=0.2):
    """A spot in a small Cycles render with the view transform, 0 to 1, (3,)."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.render.image_settings.file_format, scene.render.dither_intensity = "PNG", 0.0
    scene.render.filepath = path = bpy.app.tempdir + "shown.png"
    with spot_camera(scene, position, target, size, ortho):
        bpy.ops.render.render(write_still=True, scene=scene.name)
    return read_pixels(path).mean(axis=(0, 1))


def fingerprint(scene: bpy.types.Scene) -> dict:
    """All that Revert must restore: every data-block with its settings, links and custom properties."""
    bpy.context.view_layer.update()
    found = {}
    kinds = "objects meshes materials images worlds lights collections node_groups"
    for kind in kinds.split():
        for block in getattr(bpy.data, kind):
            found[f"{kind}/{block.name}"] = (block.users, sorted(block.keys()), _details(block))
    view = scene.view_settings
    found["scene"] = (
        scene.render.engine,
        scene.world and scene.world.name,
        sorted({*scene.keys()} - {"cycles"}),  # there once one of its settings was set
        (view.view_transform, view.look, view.exposure, view.gamma, view.use_curve_mapping),
        sorted(item.name for item in scene.objects),
        [(layer.name, [group.name for group in layer.lightgroups], sorted(layer.keys()))
         for layer in scene.view_layers],
    )  # fmt: skip
    return found


def _details(block) -> tuple:
    if isinstance(block, bpy.types.Object):
        return (
            block.data.name,
            [[round(value, 6) for value in row] for row in block.matrix_basis],
            [(slot.link, slot.material and slot.material.name) for slot in block.material_slots],
            block.active_material_index if block.type == "MESH" else 0,
            [(each.name, each.show_viewport, each.show_render) for each in block.modifiers],
            (block.hide_viewport, block.hide_render, block.lightgroup),
            sorted(each.name for each in block.users_collection),
        )
    if isinstance(block, bpy.types.Mesh):
        index = np.empty(len(block.polygons), np.int32)
        block.polygons.foreach_get("material_index", index)
        co = np.empty(3 * len(block.vertices), np.float32)
        block.vertices.foreach_get("co", co)
        return (
            index.tolist(),
            co.tolist(),
            [each and each.name for each in block.materials],
            [layer.name for layer in block.uv_layers],
            block.uv_layers.active_index,
            sorted(each.name for each in block.attributes),
        )
    if isinstance(block, bpy.types.Collection):
        return ([item.name for item in block.objects], block.hide_viewport, block.hide_render)
    return ()
