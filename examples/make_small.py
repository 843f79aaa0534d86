# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the extension's own small capture from the example room: fewer and smaller views, no ground truth.

python examples/make_small.py            (once, after make_room.py; the result is part of the repository)
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
mi.set_variant("scalar_rgb")

from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr  # noqa: E402

SOURCE, TARGET = HERE / "room", HERE.parent / "fipt_blender" / "example"
SIZE = (128, 72)
VIEWS = {"train": 20, "val": 2}


def make_split(name: str, count: int) -> None:
    """Copy `count` views of a split, evenly chosen from its list, at `SIZE`."""
    data = json.loads((SOURCE / name / "transforms.json").read_text(encoding="utf-8"))
    frames = data["frames"]
    frames = [frames[i * len(frames) // count] for i in range(count)]
    for frame in frames:
        image = Path(frame["file_path"])
        ids = Path("IndexMA") / image.name
        write_exr(TARGET / name / image, averaged(read_radiance(SOURCE / name / image)), half=True)
        write_exr(TARGET / name / ids, at_centers(read_ids(SOURCE / name / ids)), half=True)
    (width, height), camera = SIZE, {"camera_angle_x": data["camera_angle_x"]}
    small = {**camera, "width": width, "height": height, "frames": frames}
    (TARGET / name / "transforms.json").write_text(json.dumps(small), encoding="utf-8")


def averaged(image: np.ndarray) -> np.ndarray:
    """The image (H, W, 3) at `SIZE`; each pixel is the mean over its area."""
    box = mi.load_dict({"type": "box"})
    bitmap = mi.Bitmap(np.ascontiguousarray(image, np.float32))
    return np.array(bitmap.resample(SIZE, box, (mi.FilterBoundaryCondition.Clamp,) * 2))


def at_centers(ids: np.ndarray) -> np.ndarray:
    """The ids (H, W) at `SIZE`; each pixel has the one at its center."""
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(int)
        for new, old in zip(SIZE[::-1], ids.shape[:2], strict=True)
    )
    return ids[np.ix_(rows, columns)]


def main() -> None:
    """Write the capture anew."""
    shutil.rmtree(TARGET, ignore_errors=True)
    for name, count in VIEWS.items():
        make_split(name, count)
    for name in ("scene.obj", "LICENSE.txt"):
        shutil.copyfile(SOURCE / name, TARGET / name)


if __name__ == "__main__":
    main()
