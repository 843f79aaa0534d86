# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python3 benchmarks/real_cost.py CAPTURE OUTPUT: time, memory and disk of photographs of real size.

The capture's training photographs are enlarged to each size (more views by rotated cameras, see
benchmarks/resampled.py) with a lens distortion that must be undone, then `ingest`, `survey` and `estimate`
run on them, each as a process of its own. The pictures show no more than before: only the costs count.
Prints a table and writes real_cost.json to OUTPUT. Peak memory includes mapped files.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.prepared import clear, prepare
from benchmarks.resampled import write_views
from fipt_blender.bridge.interpreter import engine_command, engine_environment
from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr
from fipt_blender.core.conventions import opencv_to_opengl_camera
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings

DISTORTION = 0.002  # k1 of the lens: the pictures are not distorted, so that it must be small
SATURATED = 0.99  # share of values below which a JPEG is not clipped
NOISE = 0.01  # of a JPEG, relative to white: without it the files would be smaller than a camera's
ASPECT = 4.0 / 3.0


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="real_cost.py", description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="capture whose photographs are enlarged")
    add("output", type=Path, metavar="OUTPUT", help="folder for captures, runs and figures")
    add("--views", default="20,60", metavar="N,N", help="numbers of photographs (default: 20,60)")
    add("--megapixels", default="2,12", metavar="N,N", help="of each photograph (default: 2,12)")
    add("--kind", choices=("jpeg", "exr"), default="jpeg", help="of the photographs (default: jpeg)")
    add("--preset", default="draft", help="draft, medium or high (default: draft)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of the runs")
    add("--no-survey", action="store_true", help="leave out the check of the views")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; returns 0, or 1 after an error."""
    arguments = make_parser().parse_args(list(argv))
    # No view may be left out: that would change the size.
    changes = {"reject_views": "false", **dict(change.partition("=")[::2] for change in arguments.set)}
    rows: list[dict[str, Any]] = []
    try:
        settings = make_settings(arguments.preset, changes)
        source = prepare(arguments.capture, arguments.output.absolute() / "input")
        for views in sorted(int(text) for text in arguments.views.split(",")):
            for megapixels in sorted(float(text) for text in arguments.megapixels.split(",")):
                capture = arguments.output.absolute() / "capture"
                write_capture(source, capture, views, megapixels, arguments.kind)
                run = RunFolder(arguments.output.absolute() / "run")
                clear(run)
                run.create(settings)
                row: dict[str, Any] = {"views": views, "megapixels": megapixels, "kind": arguments.kind}
                rows.append({**row, "steps": measure(source, capture, run, not arguments.no_survey)})
                rows[-1] |= {"capture_gb": size_gb(capture), "run_gb": size_gb(run.root)}
                rows[-1]["folders_gb"] = {
                    path.name: size_gb(path) for path in sorted(run.root.iterdir()) if path.is_dir()
                }
                rows[-1]["stages"] = read_document(run.statistics_json, dict)["stages"]
                write_json(arguments.output.absolute() / "real_cost.json", {"runs": rows})
                print(format_row(rows[-1]), flush=True)
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    return 0


def write_capture(source: RunFolder, folder: Path, views: int, megapixels: float, kind: str) -> None:
    """Write a capture with transforms.json, enlarged photographs and their part masks.

    Args:
        source: run with the photographs.
        folder: of the capture; an existing one is replaced.
        kind: jpeg, or exr for half floats.
    """
    shutil.rmtree(folder, ignore_errors=True)
    small = RunFolder(folder / "small")
    write_views(source, small, views)
    height = round((megapixels * 1e6 / ASPECT) ** 0.5)
    size = round(height * ASPECT), height
    entries = read_document(small.capture_json, dict)["views"]
    images = [read_radiance(small.resolve(entry["image"])) for entry in entries]
    white = float(np.quantile(np.concatenate([image.ravel() for image in images]), SATURATED))
    grain = np.random.default_rng(0).normal(0.0, NOISE, (size[1], size[0], 3)).astype(np.float32)
    frames = []
    for number, (entry, image) in enumerate(zip(entries, images, strict=True)):
        enlarged = np.stack(
            [
                np.asarray(Image.fromarray(image[..., k]).resize(size, Image.Resampling.BILINEAR))
                for k in range(3)
            ],
            axis=-1,
        )
        path = folder / "images" / f"{number:04d}.{'jpg' if kind == 'jpeg' else 'exr'}"
        path.parent.mkdir(exist_ok=True)
        if kind == "jpeg":
            codes = srgb_encoded(np.clip(enlarged / white, 0.0, 1.0)) + np.roll(grain, 97 * number, axis=1)
            picture = Image.fromarray((np.clip(codes, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8))
            picture.save(path, quality=95)
        else:
            write_exr(path, enlarged, half=True)
        if entry.get("parts"):
            ids = Image.fromarray(read_ids(small.resolve(entry["parts"])).astype(np.uint16))
            parts = folder / "parts" / f"{number:04d}.png"
            parts.parent.mkdir(exist_ok=True)
            ids.resize(size, Image.Resampling.NEAREST).save(parts)
        x, y = size[0] / entry["width"], size[1] / entry["height"]
        pose = opencv_to_opengl_camera(np.array(entry["camera_to_world"]))
        frames.append(
            {
                "file_path": f"images/{path.name}",
                "transform_matrix": pose.tolist(),
                **{"w": size[0], "h": size[1], "k1": DISTORTION, "camera_model": "OPENCV"},
                **{"fl_x": entry["fx"] * x, "fl_y": entry["fy"] * y},
                **{"cx": entry["cx"] * x, "cy": entry["cy"] * y},
            }
        )
    shutil.rmtree(small.root)
    write_json(folder / "transforms.json", {"frames": frames})


def measure(source: RunFolder, capture: Path, run: RunFolder, survey: bool) -> dict[str, dict[str, float]]:
    """Run the engine's commands; {command: seconds, processor seconds, peak memory in GB}."""
    steps = {"ingest": command(run, "ingest", str(capture), str(run.root), "--up-axis", "z")}
    for path in (source.room_npz, source.room_json):
        shutil.copyfile(path, run.root / path.name)
    if survey:
        checked = RunFolder(run.survey)
        checked.root.mkdir()
        for path in (run.room_npz, run.room_json):
            shutil.copyfile(path, checked.root / path.name)
        data = read_document(run.capture_json, dict)
        for entry in data["views"]:
            for kind in ("image", "parts", "semantics", "mask"):
                if entry.get(kind):
                    entry[kind] = str(run.resolve(entry[kind]))
        write_json(checked.capture_json, data)
        steps["survey"] = command(run, "survey", str(checked.root))
    steps["estimate"] = command(run, "estimate", str(run.root))
    steps["all"] = {
        "seconds": sum(step["seconds"] for step in steps.values()),
        "processor": sum(step["processor"] for step in steps.values()),
        "peak_gb": max(step["peak_gb"] for step in steps.values()),
    }
    return steps


def command(run: RunFolder, *arguments: str) -> dict[str, float]:
    """Run one engine command.

    Raises:
        FiptError: ``run-failed``.
    """
    python = Path(sys.executable)
    started = time.monotonic()
    with open(run.root / "log.txt", "ab") as log:
        child = subprocess.Popen(
            engine_command(python, *arguments), stdout=log, stderr=log, env=engine_environment(python)
        )
        _, status, usage = os.wait4(child.pid, 0)
    if status:
        raise FiptError("run-failed", f"{arguments[0]} has failed.", f"See {run.root / 'log.txt'}.")
    return {
        "seconds": round(time.monotonic() - started, 1),
        "processor": round(usage.ru_utime + usage.ru_stime, 1),
        "peak_gb": round(usage.ru_maxrss * 1024 / 1e9, 2),
    }


def size_gb(folder: Path) -> float:
    """Size of all files below a folder in GB."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return round(sum(path.stat().st_size for path in files) / 1e9, 3)


def format_row(row: dict[str, Any]) -> str:
    """The figures of one size as lines."""
    lines = [
        f"{row['views']} x {row['megapixels']:g} megapixels ({row['kind']}):"
        f" capture {row['capture_gb']:.2f} GB, run folder {row['run_gb']:.2f} GB {row['folders_gb']}"
    ]
    for name, step in row["steps"].items():
        values = f"{step['seconds']:8.1f} s {step['processor']:8.1f} s of processor {step['peak_gb']:6.2f} GB"
        lines.append(f"  {name:10s}{values}")
    stages = ", ".join(f"{stage['name']} {stage['seconds']:.0f}" for stage in row["stages"])
    return "\n".join([*lines, f"  seconds of stages: {stages}"])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
