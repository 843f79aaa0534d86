"""Model the example room in Blender and render it as a capture with ground truth.

python examples/make_room.py --out examples/room
blender --background --python examples/make_room.py -- --out DIR --render-python /path/with/mitsuba/python
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import room_cameras  # noqa: E402
import room_export  # noqa: E402
import room_furniture  # noqa: E402
import room_materials  # noqa: E402
import room_ornaments  # noqa: E402
import room_shell  # noqa: E402
import room_textures  # noqa: E402
import room_thin  # noqa: E402


def parse_arguments(words: list[str]) -> argparse.Namespace:
    """The command line; in Blender only what follows `--` belongs to the script."""
    parser = argparse.ArgumentParser(prog="make_room.py", description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=HERE / "room", help="folder of the capture")
    parser.add_argument(
        "--views", type=int, default=40, help="training views; held-back ones are 15 %% of that"
    )
    parser.add_argument("--size", default="192x108", metavar="WxH", help="pixels of an image")
    parser.add_argument("--spp", type=int, default=64, help="paths a pixel")
    parser.add_argument("--seed", type=int, default=1, help="seed of textures, furniture, cameras and noise")
    parser.add_argument(
        "--thin", action="store_true", help="add thin things, such as bars and strips of light"
    )
    parser.add_argument("--blend", type=Path, help="also save the modelled room as a .blend")
    parser.add_argument("--render-python", default=sys.executable, help="a Python that has mitsuba")
    parser.add_argument("--no-render", action="store_true", help="stop before the images")
    return parser.parse_args(words)


def build_room(seed: int, textures: Path, thin: bool) -> None:
    """Model everything into an empty scene; `thin` adds room_thin's things."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    textures.mkdir(parents=True, exist_ok=True)
    for name in room_textures.MAKERS:
        save_png(textures / f"{name}.png", room_textures.encode(room_textures.make_texture(name, seed)))
    for material in chosen_materials(thin):
        room_materials.make_principled(material, textures)
    rng = np.random.default_rng([seed, 5])
    room_shell.build_shell()
    room_furniture.build_sofa()
    room_furniture.build_armchair()
    room_furniture.build_coffee_table()
    room_furniture.build_bookshelf(rng)
    room_furniture.build_cabinet()
    room_furniture.build_mirror()
    room_furniture.build_pictures()
    room_ornaments.build_lamp()
    room_ornaments.build_rug()
    room_ornaments.build_plant(rng)
    room_ornaments.build_radiator()
    room_ornaments.build_clock()
    room_ornaments.build_bin()
    room_ornaments.build_sill_bottles()
    if thin:
        room_thin.build_thin(np.random.default_rng([seed, 6]))


def chosen_materials(thin: bool) -> list[room_materials.RoomMaterial]:
    """The room's materials, in the order of their ids."""
    return [*room_materials.MATERIALS, *(room_thin.MATERIALS if thin else [])]


def save_png(path: Path, pixels: np.ndarray) -> None:
    """Write sRGB bytes (H, W, 3), row 0 at the top, by way of Blender's own images."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(path.stem, width, height)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels[::-1] / np.float32(255)
    image.pixels.foreach_set(rgba.ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def write_cameras(folder: Path, poses: list[np.ndarray], width: int, height: int) -> None:
    """transforms.json of one split."""
    folder.mkdir(parents=True, exist_ok=True)
    frames = [
        {"file_path": f"Image/{k:03d}_0001.exr", "transform_matrix": pose.tolist()}
        for k, pose in enumerate(poses)
    ]
    table = {"camera_angle_x": room_cameras.FOV_X, "width": width, "height": height, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(table, indent=1) + "\n")


def write_relight(folder: Path, poses: list[np.ndarray], corners: np.ndarray, radiance: list[float]) -> None:
    """relight.json: a lamp that faces down, with corners (4, 3), for views with all other lamps off."""
    table = {
        "comment": "the room's emitters off (black, non-reflecting surfaces); one added one-sided rectangle; "
        "its back is black; it is visible to the camera",
        "light": {
            "vertices": corners.tolist(),
            "faces": [[0, 1, 2], [0, 2, 3]],
            "radiance": radiance,
            "normal": [0.0, -1.0, 0.0],
        },
        "camera_angle_x": room_cameras.FOV_X,
        "views": [
            {"image": f"relight/{k:03d}_0001.exr", "val_index": k, "transform_matrix": pose.tolist()}
            for k, pose in enumerate(poses)
        ],
    }
    (folder / "relight.json").write_text(json.dumps(table, indent=1) + "\n")


def relight_corners() -> np.ndarray:
    """(4, 3) corners of the lamp of relit views, under the ceiling."""
    x, y, z = -0.9, -0.3, 2.8
    corners = [(x - 0.4, y - 0.3, z), (x - 0.4, y + 0.3, z), (x + 0.4, y + 0.3, z), (x + 0.4, y - 0.3, z)]
    return room_cameras.y_up(np.array(corners))


def main() -> int:
    """Build, export, place the cameras, render; the exit status."""
    in_blender = Path(sys.argv[0]).name != Path(__file__).name  # then argv is Blender's own up to `--`
    words = sys.argv[1:]
    if in_blender:
        words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    options = parse_arguments(words)
    width, height = (int(word) for word in options.size.lower().split("x"))
    out = options.out.resolve()
    if out.exists() and any(out.iterdir()) and not (out / "materials.json").exists():
        print(f"{out} is not empty and holds no capture; choose another --out.", file=sys.stderr)
        return 2
    for name in ("train", "val", "relight", "textures"):
        if (out / name).exists():
            shutil.rmtree(out / name)
    build_room(options.seed, out / "textures", options.thin)
    if options.blend:
        bpy.ops.wm.save_as_mainfile(filepath=str(options.blend.resolve()))
    objects = room_export.read_objects()
    room_export.write_obj(out / "scene.obj", objects)
    wanted = ("views", "size", "spp", "seed")
    command = ["make_room.py", *(f"--{name} {getattr(options, name)}" for name in wanted)]
    command += ["--thin"] * options.thin
    room_export.write_tables(out, objects, chosen_materials(options.thin), " ".join(command))
    offsets = np.cumsum([0] + [len(item.vertices) for item in objects])
    triangles = np.concatenate(
        [item.triangles + start for item, start in zip(objects, offsets[:-1], strict=True)]
    )
    tree = BVHTree.FromPolygons(
        np.concatenate([item.vertices for item in objects]).tolist(), triangles.tolist()
    )
    held_back = room_cameras.held_back_poses(max(1, round(options.views * 0.15)))
    training = room_cameras.training_poses(tree, options.views, options.seed, height / width)
    write_cameras(out / "train", training, width, height)
    write_cameras(out / "val", held_back, width, height)
    write_relight(out, held_back[:3], relight_corners(), [90.0, 68.0, 44.0])
    views = f"{len(training)} + {len(held_back)} views"
    print(f"{len(objects)} objects, {len(triangles)} triangles, {views}", flush=True)
    if options.no_render:
        return 0
    render = [options.render_python, str(HERE / "render_room.py"), str(out), "--spp", str(options.spp)]
    return subprocess.run([*render, "--seed", str(options.seed)], check=False).returncode


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)  # some bpy builds crash in their own clean-up; by now everything is on disk
