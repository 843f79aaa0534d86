"""Render the images and ground-truth maps of a capture folder that make_room.py has written.

    python examples/render_room.py examples/room --spp 64

Needs Mitsuba, OpenEXR and Open Image Denoise; reads scene.obj, materials.json, scene.npz, textures/ and the
camera files, so anything in that layout can be rendered.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from room_files import Capture, read_capture, write_exr  # noqa: E402


def render_folder(folder: Path, spp: int, seed: int) -> None:
    """Images, maps, relit images, emitters' pixel counts and the contact sheet of the capture in `folder`."""
    import room_mitsuba
    import room_sheet

    capture = read_capture(folder)
    scene = room_mitsuba.load_room(capture)
    started, done = time.time(), 0
    total = sum(len(frames) for frames in capture.poses.values()) + len(capture.relight["views"])
    lit = {split: np.zeros((len(capture.emitters), 2), int) for split in capture.poses}
    for split, poses in capture.poses.items():
        for k, pose in enumerate(poses):
            maps = scene.maps(pose, seed=seed + 1000)
            image = scene.image(pose, maps, spp, seed=seed * 100003 + done)
            save_view(folder / split, k, image, maps)
            lit[split] += count_emitter_pixels(capture, maps)
            done += 1
            print(f"{split} {k}: {done}/{total}, {time.time() - started:.0f} s", flush=True)
    for row, emitter in enumerate(capture.emitters):
        emitter["front_pixels"], emitter["back_pixels"] = (int(n) for n in lit["train"][row])
    (folder / "emitters.json").write_text(json.dumps(capture.emitters, indent=1) + "\n")
    relit = room_mitsuba.load_room(capture, light=capture.relight["light"])
    (folder / "relight").mkdir(exist_ok=True)
    for view in capture.relight["views"]:
        pose = np.array(view["transform_matrix"])
        image = relit.image(pose, relit.maps(pose, seed=seed + 1000), 2 * spp, seed=seed * 100003 + done)
        write_exr(folder / view["image"], image.astype(np.float16))
        done += 1
    room_sheet.make_sheet(folder)


def save_view(folder: Path, index: int, image: np.ndarray, maps: dict[str, np.ndarray]) -> None:
    """One view in the layout of the paper's synthetic data; training views without Normal and Depth."""
    write_exr(folder / "Image" / f"{index:03d}_0001.exr", image.astype(np.float16))
    for name, values in maps.items():
        if name.startswith("_") or (folder.name == "train" and name in ("Normal", "Depth")):
            continue
        kind = np.float32 if name in ("IndexMA", "IndexOB", "segmentation") else np.float16
        stem = f"{index:03d}" if name in ("albedo", "segmentation") else f"{index:03d}_0001"
        values = values.astype(kind)
        if folder.name == "train" and name in ("BaseColor", "DiffCol", "albedo"):
            values = shortened(values)
        write_exr(folder / name / f"{stem}.exr", values)


def shortened(values: np.ndarray) -> np.ndarray:
    """Half floats rounded to 8 bits of mantissa (0.2 %): the colour maps shrink by a sixth."""
    bits = values.view(np.uint16).astype(np.uint32)
    return ((bits + 2) & 0xFFFC).astype(np.uint16).view(np.float16)


def count_emitter_pixels(capture: Capture, maps: dict[str, np.ndarray]) -> np.ndarray:
    """(emitters, 2): pixels whose centre sees the front and the back of each emitter."""
    counts = np.zeros((len(capture.emitters), 2), int)
    for row, emitter in enumerate(capture.emitters):
        first, end = emitter["triangles"]
        mine = (maps["_triangle"] >= first) & (maps["_triangle"] < end)
        counts[row] = (mine & maps["_front"]).sum(), (mine & ~maps["_front"]).sum()
    return counts


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--spp", type=int, default=64, help="paths a pixel; relit views get twice as many")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    from fipt_blender.core.device.variant import set_variant

    set_variant()
    render_folder(options.folder.resolve(), options.spp, options.seed)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
