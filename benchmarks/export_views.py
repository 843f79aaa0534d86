# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python benchmarks/export_views.py room.blend OUT [N]: what is lost when a finished room is exported.

Exports the room as glTF and USD, imports each into an empty file and renders the first N held-back views in
Cycles, in Blender's Python module. OUT/export.json gets the PSNR in sRGB against the source.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.eevee_views import figures, opened, render, set_size

SAMPLES = 64  # and denoised; two renders of the source with other seeds tell the noise that is left
_LENS = ("lens", "sensor_width", "sensor_height", "sensor_fit", "shift_x", "shift_y", "clip_start")
_PATHS = ("max_bounces", "diffuse_bounces", "glossy_bounces", "sample_clamp_indirect", "blur_glossy")


def main(argv: list[str]) -> int:
    """Export, import, render, compare and write."""
    out, count = Path(argv[1]).absolute(), int(argv[2]) if len(argv) > 2 else 2
    out.mkdir(parents=True, exist_ok=True)
    scene, cameras = opened(argv[0], count)
    paths = {name: getattr(scene.cycles, name) for name in _PATHS}
    set_up(scene, paths)
    set_size(scene, cameras[0])
    size = (scene.render.resolution_x, scene.render.resolution_y)
    again = [_picture(scene, cameras, out, name, seed) for name, seed in (("source", 0), ("again", 1))]
    files = [out / "room.glb", out / "room.usdc"]
    for file in files:
        bpy.ops.fipt.export_room(filepath=str(file))
    poses = [
        (camera.matrix_world.copy(), {name: getattr(camera.data, name) for name in _LENS})
        for camera in cameras
    ]
    for tree in bpy.data.node_groups:
        if tree.name.startswith("FIPT Agreement"):
            mute(tree)
    pictures = {"plain": _picture(scene, cameras, out, "plain", 2)}
    for file in files:
        pictures[file.suffix] = imported(file, poses, size, paths, out)
    exposure = 0.18 / float(np.median(np.concatenate([image.reshape(-1) for image in again[0]])))
    found = {
        name: [figures(a, b, exposure) for a, b in zip(images, again[0], strict=True)]
        for name, images in {"noise": again[1], **pictures}.items()
    }
    (out / "export.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1), flush=True)
    return 0


def set_up(scene: bpy.types.Scene, paths: dict[str, float]) -> None:
    """Cycles with a fixed number of samples, denoised, with the source's bounces."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = SAMPLES, True
    scene.cycles.use_adaptive_sampling = False
    for name, value in paths.items():
        setattr(scene.cycles, name, value)


def mute(tree: bpy.types.NodeTree) -> None:
    """Mute all nodes of a group in the materials that have it."""
    for material in bpy.data.materials:
        for node in material.node_tree.nodes if material.node_tree else ():
            if node.type == "GROUP" and node.node_tree == tree:
                node.mute = True


def imported(
    file: Path,
    poses: list[tuple[object, dict[str, object]]],
    size: tuple[int, int],
    paths: dict[str, float],
    out: Path,
) -> list[np.ndarray]:
    """The views of an exported room in a file with nothing else."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if file.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(file))
    else:
        bpy.ops.wm.usd_import(filepath=str(file))
    scene = bpy.context.scene
    set_up(scene, paths)
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    cameras = []
    for matrix, lens in poses:
        data = bpy.data.cameras.new("View")
        for name, value in lens.items():
            setattr(data, name, value)
        camera = bpy.data.objects.new("View", data)
        scene.collection.objects.link(camera)
        camera.matrix_world = matrix
        cameras.append(camera)
    return _picture(scene, cameras, out, file.suffix[1:], 3)


def _picture(
    scene: bpy.types.Scene, cameras: list[bpy.types.Object], out: Path, name: str, seed: int
) -> list[np.ndarray]:
    scene.cycles.seed = seed
    return [render(scene, camera, out / f"{name}_{index}.exr") for index, camera in enumerate(cameras)]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
