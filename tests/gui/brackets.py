#!/usr/bin/env python3
"""Makes a camera's brackets of the example's images, and a solve of their cameras: `brackets.py CAPTURE OUT`.

Writes OUT/card/IMG_NNNN.jpg, three exposures for each of a few views, and OUT/solve/transforms.json. Runs in
the engine's Python.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from fipt_blender.core.capture.images import read_radiance
from samples.photographs import exif, write_jpeg

VIEWS = 6
STOPS = (-3.0, 0.0, 3.0)  # relative to an exposure in which the median pixel is at a fifth of white
MIDDLE = 0.2
ENLARGEMENT = 2
FIRST = 4209  # number of the first file
_APART = 30  # seconds between brackets


def main(capture: Path, out: Path) -> None:
    """Write the photographs and the solve."""
    rig = json.loads((capture / "train" / "transforms.json").read_text(encoding="utf-8"))
    frames = []
    for index, frame in enumerate(rig["frames"][:VIEWS]):
        radiance = read_radiance(capture / "train" / frame["file_path"])
        radiance = radiance.repeat(ENLARGEMENT, 0).repeat(ENLARGEMENT, 1)
        write_bracket(out / "card", index, radiance)
        pose = np.array(frame["transform_matrix"])
        pose[:3, [0, 2]] *= -1.0  # the example's cameras look along Z, with X to the left
        name = f"IMG_{FIRST + len(STOPS) * index}.jpg"
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    height, width = radiance.shape[:2]
    focal = 0.5 * width / np.tan(0.5 * rig["camera_angle_x"])
    intrinsics = {"w": width, "h": height, "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}
    (out / "solve").mkdir(parents=True, exist_ok=True)
    text = json.dumps({**intrinsics, "frames": frames})
    (out / "solve" / "transforms.json").write_text(text, encoding="utf-8")


def write_bracket(folder: Path, index: int, radiance: np.ndarray) -> None:
    """The exposures of one view as JPEG with EXIF, one second apart."""
    unit = MIDDLE / 0.5  # the same for all views: the example's median radiance is near a half
    for place, stops in enumerate(STOPS):
        values = np.clip(radiance * unit * 2.0**stops, 0.0, 1.0) ** (1.0 / 2.2)
        name = f"IMG_{FIRST + len(STOPS) * index + place}.jpg"
        pixels = np.round(255.0 * values).astype(np.uint8)
        write_jpeg(folder / name, pixels, exif(2.0**stops / 15.0, index * _APART + place))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
