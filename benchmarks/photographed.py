# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture with ground truth whose images went through a camera and `prepare`.

    python benchmarks/photographed.py CAPTURE OUT [--kind jpeg] [--frames 3] [--stops 2] [--reach 1.05]

copies CAPTURE to OUT/capture and replaces its images by what `prepare` merges from simulated brackets, in the
units of the originals, which the exposures tell. To compare: python dev.py accuracy OUT/capture.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.brackets import (
    CEILING_EXPOSURE,
    add_camera_arguments,
    make_camera,
    merge,
    score,
    write_bracket,
)
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.run.documents import read_document

SPLITS = ("train", "val")


def main() -> None:
    """Write brackets, merge them and put the merged images in place of the originals."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path, help="a capture in the FIPT authors' layout")
    parser.add_argument("out", type=Path)
    add_camera_arguments(parser)
    arguments = parser.parse_args()
    capture, photographs = arguments.out / "capture", arguments.out / "photographs"
    shutil.copytree(arguments.source, capture)
    files = [file for split in SPLITS for file in sorted((capture / split / "Image").glob("*.exr"))]
    truths = [read_radiance(file) for file in files]
    camera = make_camera(truths, arguments)
    for index, truth in enumerate(truths):
        write_bracket(photographs, index, truth, camera, arguments.seed)
    folder, warnings = merge(photographs, arguments.out / "prepared", max(truths[0].shape[:2]), camera)
    for warning in warnings:
        print(f"warning: {warning['text']}")
    unit = CEILING_EXPOSURE * float(read_document(folder / "stage" / "merge.json", dict)["scale"])
    merged = [read_radiance(file) / np.float32(unit) for file in sorted((folder / "images").glob("*.exr"))]
    if (
        camera.kind == "jpeg"
    ):  # nothing tells the balance of a response's channels: three factors for all views
        merged = [image / _balance(merged, truths) for image in merged]
    for file, image in zip(files, merged, strict=True):
        write_exr(file, image)
    print(score(merged, truths, camera))


def _balance(images: Sequence[np.ndarray], truths: Sequence[np.ndarray]) -> np.ndarray:
    """(3,) median factor of each channel over all pixels."""
    ratios = np.concatenate(
        [(image / truth).reshape(-1, 3) for image, truth in zip(images, truths, strict=True)]
    )
    return np.nanmedian(ratios, axis=0).astype(np.float32)


if __name__ == "__main__":
    main()
