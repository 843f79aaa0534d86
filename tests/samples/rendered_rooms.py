"""A tiny estimated room in the open file, with a run folder whose photograph is a render of it."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import OpenEXR
from mathutils import Matrix

from fipt_blender.blend.capture import cameras, importing
from fipt_blender.blend.lights.fixture_nodes import emission_material
from fipt_blender.blend.marks import BACK, BASE, FIXTURE, FIXTURE_SOURCES
from fipt_blender.blend.node_trees import node_tree
from fipt_blender.blend.outliner import FIXTURES, ROOM, collection
from fipt_blender.blend.pictures import cycles, image_files
from fipt_blender.blend.pictures.cycles import RenderOptions
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.run_files import read_capture
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings

SIZE = (32, 20)
VIEW = "val/000"


def make_scene(folder: Path) -> RunFolder:
    """Floor, wall and a lamp above them; a view that looks down at them, and one from the other side."""
    scene = bpy.context.scene
    _quad(scene, "Floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)])
    _quad(scene, "Wall", [(-2, 2, 0), (2, 2, 0), (2, 2, 2.5), (-2, 2, 2.5)])
    corners = [(-0.5, -0.5, 2.4), (-0.5, 0.5, 2.4), (0.5, 0.5, 2.4), (0.5, -0.5, 2.4)]
    lamp = _quad(scene, "Fixture.001", corners, FIXTURES)
    lamp[FIXTURE], lamp[BASE], lamp[BACK] = "Fixture.001", [8.0, 8.0, 8.0], [0.0, 0.0, 0.0]
    lamp[FIXTURE_SOURCES] = "[]"
    lamp.data.materials[0] = emission_material("Fixture.001", lamp[BASE], lamp[BACK])
    run = RunFolder(folder / "run")
    run.create(make_settings("draft"))
    scene.fipt.run_folder = str(run.root)
    views = [_view(run, VIEW, "held_back", 0.0), _view(run, "train/000", "train", np.pi)]
    matrix = np.eye(4).tolist()
    capture = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    for path in (run.capture_json, run.ingest_json):
        write_json(path, {**capture, "world_from_source": matrix, "views": views})
    for view in views:
        write_exr(run.root / view["image"], np.zeros((SIZE[1], SIZE[0], 3), np.float32))
    for view in read_capture(run.capture_json).views:
        cameras.add_camera(scene, run, view)
    importing.fill_views(scene, run)
    cameras.use_view(scene, cameras.find_camera(VIEW, scene))
    bpy.context.view_layer.update()
    return run


def diffuse_floor(size: float, albedo: float) -> None:
    """A square diffuse plane (`size` metres) at the origin."""
    bpy.ops.mesh.primitive_plane_add(size=size)
    material = bpy.data.materials.new("floor")
    nodes = node_tree(material).nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (albedo, albedo, albedo, 1.0)
    material.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)


def photograph(run: RunFolder, spp: int = 64) -> np.ndarray:
    """Replace the held-back view's photograph by a render of the room; returns it."""
    path = run.root / "photo.exr"
    scene = bpy.context.scene
    cycles.render_exr(scene, path, RenderOptions(spp, seed=5, denoise=False), cameras.find_camera(VIEW, scene))
    image = image_files.read_pixels(path)
    write_exr(run.root / "photos/val_000.exr", image)
    return image


def exr_layers(path: Path) -> dict[str, np.ndarray]:
    """Layers of an EXR, (H, W, C) f32; newer versions of Blender write each as a part."""
    file = OpenEXR.File(str(path), separate_channels=True)
    channels = {name: channel for part in range(len(file.parts)) for name, channel in file.channels(part).items()}
    layers: dict[str, list[str]] = {}
    for name in sorted(channels, key=lambda name: "RGBAZ".index(name[-1])):
        layers.setdefault(name.rpartition(".")[0], []).append(name)
    return {
        layer: np.stack([channels[name].pixels.astype(np.float32) for name in names], axis=-1)
        for layer, names in layers.items()
    }


def _view(run: RunFolder, name: str, split: str, turn: float) -> dict:
    # A camera in Blender's axes at (0, -1.8, 1.2) that looks down at 60 degrees from the vertical.
    matrix = Matrix.Rotation(turn, 4, "Z") @ Matrix.Translation((0, -1.8, 1.2))
    pose = np.array(matrix @ Matrix.Rotation(np.radians(65.0), 4, "X")) @ np.diag([1.0, -1.0, -1.0, 1.0])
    width, height = SIZE
    lens = {"fx": 24.0, "fy": 24.0, "cx": width / 2, "cy": height / 2}
    image = f"photos/{name.replace('/', '_')}.exr"
    return {"name": name, "split": split, "image": image, "parts": None, "semantics": None,
            "width": width, "height": height, "camera_to_world": pose.tolist(), **lens}  # fmt: skip


def _quad(scene, name, points, target=ROOM):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], [(0, 1, 2, 3)])
    mesh.materials.append(bpy.data.materials.new(name))
    item = bpy.data.objects.new(name, mesh)
    collection(scene, target).objects.link(item)
    return item
