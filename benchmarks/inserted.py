# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python benchmarks/inserted.py RUN CAPTURE OUT [VIEW]: balls in a photograph, against the truth.

The truth is the example room with the ball in it, rendered like its photographs; those that were
estimated from do not show it. RUN is a finished run of CAPTURE (examples/room). The ball, diffuse grey or a
mirror, stands where the main job would put one. OUT/inserted.json gets PSNR (dB, tone-mapped) against the
truth: inside the ball's outline, where its shadow or light is, and elsewhere; of the composite, and of the
photograph without the ball. OUT has the pictures.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "examples")]

BALLS = {"grey": (0.5, 1.0, 0.0), "mirror": (0.95, 0.05, 1.0)}  # base colour, roughness, metallic
TRUTH_SPP = 256  # of Mitsuba; Cycles has the scene's settings
CHANGED = 0.02  # share of white from which a pixel belongs to the shadow


def main(argv: list[str]) -> int:
    """Composite, render the truth in another process, compare."""
    run, capture, out = (Path(argument).absolute() for argument in argv[:3])
    view = argv[3] if len(argv) > 3 else "val/000"
    out.mkdir(parents=True, exist_ok=True)
    scene = open_room(run, view)
    figures = {}
    for name, surface in BALLS.items():
        ball = place(scene, run, view, surface)
        composite(scene, ball, out / f"{name}.exr")
        wanted = out / f"{name}.json"
        subprocess.run([sys.executable, __file__, "truth", str(capture), str(wanted)], check=True)
        truth = np.load(out / f"{name}_truth.npy")
        figures[name] = compare(out, name, truth, 2.0**scene.view_settings.exposure)
    (out / "inserted.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(figures, indent=1))
    return 0


def open_room(run: Path, view: str):
    """The run's room.blend in Blender's module, looking through a view."""
    import bpy

    import fipt_blender
    from fipt_blender.blend.capture.cameras import find_camera, use_view

    fipt_blender.register()
    bpy.ops.wm.open_mainfile(filepath=str(run / "room.blend"), use_scripts=False)
    scene = bpy.context.scene
    scene.fipt.run_folder = str(run)
    use_view(scene, find_camera(view, scene))
    scene.cycles.pixel_filter_type = "BOX"  # as the photographs
    return scene


def place(scene, run: Path, view: str, surface: tuple[float, float, float]):
    """A ball where the main job would insert one; replaces an earlier one."""
    import bpy
    from mathutils import Vector

    from fipt_blender.blend.capture.view_geometry import view_geometry
    from fipt_blender.blend.insert.balls import add_ball
    from fipt_blender.blend.insert.support import choose_view
    from fipt_blender.blend.outliner import INSERTED, collection
    from fipt_blender.blend.room.arrays import read_room
    from fipt_blender.blend.room.rays import make_cast
    from fipt_blender.core.run.run_files import read_capture
    from fipt_blender.core.run.runfolder import RunFolder

    bpy.data.batch_remove(collection(scene, INSERTED).objects)
    folder = RunFolder(run)
    entry = read_capture(folder.capture_json).view(view)
    _, support = choose_view(make_cast(read_room(folder)), [(view, view_geometry(entry))])
    ball = add_ball(scene, Vector(support.point), "gray_ball", 2.0 * support.radius)
    shader = next(node for node in ball.active_material.node_tree.nodes if "Base Color" in node.inputs)
    color, roughness, metallic = surface
    shader.inputs["Base Color"].default_value = (color, color, color, 1.0)
    shader.inputs["Roughness"].default_value, shader.inputs["Metallic"].default_value = roughness, metallic
    if metallic == 0.0:
        shader.inputs["Specular IOR Level"].default_value = 0.0  # diffuse alone
    bpy.context.view_layer.update()
    center = [*support.point[:2], support.point[2] + support.radius]
    ball["truth"] = {"center": center, "radius": support.radius,
                     "surface": list(surface), "view": view}  # fmt: skip
    return ball


def composite(scene, ball, path: Path) -> None:
    """The picture over the photograph, with its layers, and what the truth needs to know beside it."""
    from dataclasses import replace

    from fipt_blender.blend.pictures import orders
    from fipt_blender.blend.pictures.image_files import photograph
    from fipt_blender.core.run.run_files import read_capture
    from fipt_blender.core.run.runfolder import RunFolder

    run, view = RunFolder(scene.fipt.run_folder), scene.camera["fipt_view"]
    order = orders.order_picture(scene, run, scene.camera, plate=True)
    orders.carry_out(replace(order, path=str(path)))
    np.save(
        path.with_name(f"{path.stem}_plate.npy"), photograph(run, read_capture(run.capture_json).view(view))
    )
    path.with_suffix(".json").write_text(json.dumps(ball["truth"].to_dict()), encoding="utf-8")


def render_truth(capture: Path, wanted: Path) -> None:
    """Mitsuba's render of the room with the ball, as the photographs were made: (H, W, 3), NAME_truth.npy."""
    from fipt_blender.core.device.variant import set_variant

    set_variant()
    import room_mitsuba
    from room_files import read_capture

    ball = json.loads(wanted.read_text(encoding="utf-8"))
    x, y, z = ball["center"]
    color, roughness, metallic = ball["surface"]
    if metallic:
        bsdf = {"type": "roughconductor", "alpha": roughness**2, "distribution": "ggx", "material": "none",
                "specular_reflectance": {"type": "rgb", "value": color}}  # fmt: skip
    else:
        bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}}
    # The files' world has Y up.
    shape = {"type": "sphere", "center": [x, z, -y], "radius": ball["radius"], "bsdf": bsdf,
             "base_color": {"type": "srgb", "color": [color] * 3}}  # fmt: skip
    loaded = read_capture(capture)
    split, number = ball["view"].split("/")
    room = room_mitsuba.load_room(loaded, added={"ball": shape})
    pose = np.array(loaded.poses[split][int(number)])
    image = room.image(pose, room.maps(pose, seed=7), TRUTH_SPP, seed=7)
    np.save(wanted.with_name(f"{wanted.stem}_truth.npy"), image)


def compare(out: Path, name: str, truth: np.ndarray, exposure: float) -> dict[str, dict[str, float]]:
    """PSNR by region, of the composite and of the untouched photograph; writes pictures side by side."""
    import OpenEXR
    from PIL import Image

    from fipt_blender.core.report.comparison import psnr, tone_mapped

    channels = OpenEXR.File(str(out / f"{name}.exr"), separate_channels=True).channels()

    def layer(prefix: str, letters: str = "RGB") -> np.ndarray:
        return np.stack([channels[prefix + letter].pixels.astype(np.float32) for letter in letters], axis=-1)

    plate = np.load(out / f"{name}_plate.npy")
    picture, alpha = layer("Composite.Combined."), layer("ViewLayer.Combined.", "A")[..., 0]
    shown = [tone_mapped(image, exposure) for image in (plate, picture, truth)]
    Image.fromarray((np.concatenate(shown, axis=1) * 255).round().astype(np.uint8)).save(out / f"{name}.png")
    changed = np.abs(shown[2] - shown[0]).max(axis=-1) > CHANGED
    beside = alpha <= 0.0
    regions = {"outline": alpha > 0.5, "shadow": beside & changed, "elsewhere": beside & ~changed}
    return {
        region: {
            "pixels": int(inside.sum()),
            "composite": psnr(picture[inside], truth[inside], exposure),
            "photograph": psnr(plate[inside], truth[inside], exposure),
        }
        for region, inside in regions.items()
        if inside.any()
    }


if __name__ == "__main__":
    if sys.argv[1] == "truth":
        render_truth(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        sys.exit(main(sys.argv[1:]))
