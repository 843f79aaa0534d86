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
FRAMES = ("GiltFrame", "BlackFrame", "Mount")  # materials of frames around pictures and the mirror


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


def turned(text: str) -> str:
    """An OBJ file with its frames' faces, `v/t/n` or `v//n`, and their normals turned into the room.

    The frames of `room` look at the wall, so that Blender would hide them with all that is seen from behind.
    That room itself stays as it is, since measured figures belong to it.
    """
    lines: list[str] = []
    block: list[str] = []
    # Normals: added before this object, the file's before it, and the file's so far.
    shift = first = count = 0
    for line in [*text.splitlines(), "o"]:
        if line.startswith("vn "):
            count += 1
        if line.split(" ")[0] == "o":
            added = _turn_object(block, shift, first, count)
            lines += block
            shift, first, block = shift + added, count, []
        block.append(line)
    return "\n".join(lines) + "\n"


def _turn_object(block: list[str], shift: int, first: int, count: int) -> int:
    """Turn an object's frames, whose lines are changed in place; returns how many normals were added.

    Args:
        shift: normals that were added to objects before. first, count: the object's range of normals, from 0.
    """
    normals = [index for index, line in enumerate(block) if line.startswith("vn ")]
    negated: dict[int, int] = {}
    is_framed, material = bool(block) and block[0].startswith(("o Frame_", "o Mirror")), ""
    for index, line in enumerate(block):
        kind, *words = line.split(" ")
        if kind == "usemtl":
            material = words[0]
        if kind != "f":
            continue
        corners = [word.rpartition("/") for word in words]
        numbers = [int(number) for _, _, number in corners]
        if is_framed and material in FRAMES:
            corners, numbers = corners[::-1], numbers[::-1]
            numbers = [negated.setdefault(number, count + 1 + len(negated)) for number in numbers]
        words = [f"{corner}/{n + shift}" for (corner, _, _), n in zip(corners, numbers, strict=True)]
        block[index] = " ".join([kind, *words])
    turned_normals = []
    for number in negated:
        values = [-float(value) + 0.0 for value in block[normals[number - 1 - first]].split(" ")[1:]]
        turned_normals.append("vn " + " ".join(f"{value:g}" for value in values))
    if negated:
        block[normals[-1] + 1 : normals[-1] + 1] = turned_normals
    return len(negated)


def main() -> None:
    """Write the capture anew."""
    shutil.rmtree(TARGET, ignore_errors=True)
    for name, count in VIEWS.items():
        make_split(name, count)
    shutil.copyfile(SOURCE / "LICENSE.txt", TARGET / "LICENSE.txt")
    text = (SOURCE / "scene.obj").read_text(encoding="utf-8")
    (TARGET / "scene.obj").write_text(turned(text), encoding="utf-8")


if __name__ == "__main__":
    main()
