"""`prepare` in this process, and folders as it leaves them: two brackets, a single photograph, the steps' facts."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import write_json
from fipt_blender.prepare import command
from fipt_blender.prepare.preparation import (
    Group,
    Photograph,
    Preparation,
    PreparationFolder,
    PrepareSettings,
    write_preparation,
)
from samples.textured_room import FOCAL, HEIGHT, WIDTH

SHUTTERS = (0.01, 0.04, 0.16)
SIZE = (24, 16)


def prepare(photographs: Path, capture: Path, steps: str, *changes: str) -> Reporter:
    """Run steps of the command with changed settings; returns what was reported."""
    reporter = Reporter()
    command.run(argparse.Namespace(photographs=photographs, run=capture, steps=steps, set=list(changes)), reporter)
    return reporter


def facts(folder: PreparationFolder, step: str) -> dict:
    return json.loads(folder.facts(step).read_text(encoding="utf-8"))


def single(source: Path, names: Iterable[str], size: tuple[int, int], **others: object) -> Preparation:
    """Photographs that are groups of their own; `others`: of all of them."""
    photographs = tuple(Photograph(f"{name}.jpg", "ldr", *size, **others) for name in names)
    return Preparation(source, photographs, tuple(Group(item.path[:-4], (item.path,)) for item in photographs))


def run_with(folder: PreparationFolder, preparation: Preparation, steps: list[str], **settings: object) -> Reporter:
    """Run steps with some settings; returns what was reported."""
    write_preparation(folder, replace(preparation, settings=PrepareSettings(**settings)))
    reporter = Reporter()
    command.run_steps(folder, steps, reporter)
    return reporter


def placed_model(poses: Iterable[np.ndarray], seen: Iterable[list[np.ndarray]] = ()) -> pycolmap.Reconstruction:
    """A solve of views v1, v2, ... of the textured room with these poses (4, 4); `seen`: places (2,) of points."""
    model, params = pycolmap.Reconstruction(), [FOCAL, 0.5 * WIDTH, 0.5 * HEIGHT]
    camera = pycolmap.Camera(camera_id=1, model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=params)
    model.add_camera_with_trivial_rig(camera)
    for number, (pose, places) in enumerate(zip_longest(poses, seen, fillvalue=[]), start=1):
        points = pycolmap.Point2DList([pycolmap.Point2D(place) for place in places])
        image = pycolmap.Image(name=f"v{number}.exr", camera_id=1, image_id=number, points2D=points)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(pose)[:3]))
    return model


def make_preparation(source: Path, names: tuple[str, ...] = ("IMG_1", "IMG_4", "IMG_7")) -> Preparation:
    """Two brackets and a single photograph, which is not used."""
    photographs = [
        Photograph(
            path=f"IMG_{index + 1}.jpg",
            kind="ldr",
            width=SIZE[0],
            height=SIZE[1],
            shutter=SHUTTERS[index % 3],
            aperture=8.0,
            iso=100.0,
            exposure=SHUTTERS[index % 3] / 64.0,
        )
        for index in range(7)
    ]
    paths = [photograph.path for photograph in photographs]
    parts = (paths[:3], paths[3:6], paths[6:])
    groups = [Group(name, tuple(part), len(part) > 1) for name, part in zip(names, parts, strict=True)]
    return Preparation(source, tuple(photographs), tuple(groups))


def write_prepared(folder: PreparationFolder, preparation: Preparation) -> None:
    """prepare.json, merged images with a clipped corner, and the facts of merging and solving."""
    write_preparation(folder, preparation)
    rng = np.random.default_rng(3)
    images = []
    for group in preparation.used_groups:
        write_exr(folder.image(group), rng.random((SIZE[1], SIZE[0], 3), np.float32))
        mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
        mask[:4, :4] = 255
        folder.clipped.mkdir(parents=True, exist_ok=True)
        Image.fromarray(mask).save(folder.clipped_mask(group))
        images.append({"name": group.name, "clipped_share": 16.0 / mask.size, "shift_pixels": 1.5})
    first, second = (group.name for group in preparation.used_groups)
    curve = np.linspace(0.0, 1.0, 16) ** 2.2
    write_json(
        folder.facts("merge"),
        {
            "key": "a",
            "messages": [],
            "seconds": 3.0,
            "images": images,
            "response": {"curves": [curve.tolist()] * 3, "uncertainty": 0.02},
        },
    )
    warning = {"code": "views-left-out", "text": "1 of 2 views has no camera.", "remedy": "Take more."}
    write_json(
        folder.facts("solve"),
        {
            "key": "b",
            "seconds": 70.0,
            "messages": [warning],
            "registered": [{"name": first, "points": 120, "reprojection_error": 0.6}],
            "left_out": [{"name": second, "reason": "It shares too few points.", "remedy": ""}],
            "reprojection_error": 0.6,
        },
    )
