"""The page that shows the method by the engine's functions works, and a stage can be swapped."""

from __future__ import annotations

import functools
import importlib.util
import json
from pathlib import Path
from unittest.mock import patch

import numpy as np

from fipt_blender.core import conventions
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.estimate import training_stages
from fipt_blender.core.estimate.light_stages import bake_shadings
from fipt_blender.core.material import training
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder
from samples.small_captures import FEW, QUICK, UNTRAINED, SmallCapture, panel_capture, pinhole, some_views

PAGE = Path(__file__).resolve().parent.parent / "examples" / "engine.py"


def write_capture(root: Path, capture: SmallCapture) -> None:
    """transforms.json, images and an OBJ file."""
    frames = []
    for index, (image, pose) in enumerate(zip(capture.images, capture.poses, strict=True)):
        write_exr(root / "images" / f"{index}.exr", image)
        lens = vars(pinhole(pose))
        frame = {"w": lens["width"], "h": lens["height"], "fl_x": lens["fx"], "fl_y": lens["fy"]}
        matrix = conventions.opencv_to_opengl_camera(pose).tolist()
        frame |= {"cx": lens["cx"], "cy": lens["cy"], "transform_matrix": matrix}
        frames.append(frame | {"file_path": f"images/{index}.exr"})
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))
    lines = ["v {} {} {}".format(*vertex) for vertex in capture.room.vertices.tolist()]
    lines += ["f {} {} {}".format(*triangle) for triangle in (capture.room.triangles + 1).tolist()]
    (root / "scene.obj").write_text("\n".join(lines) + "\n")


def test_the_page_goes_from_a_capture_to_textures(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("engine_page", PAGE)
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    (tmp_path / "images").mkdir()
    write_capture(tmp_path, some_views(panel_capture()))
    swapped = []

    @functools.wraps(bake_shadings)
    def mine(*given, **named):
        swapped.append("shadings")
        return bake_shadings(*given, **named)

    run = RunFolder(tmp_path / "run")
    settings = {**QUICK, **FEW, **UNTRAINED, "rounds": 0, "force": True}
    with patch.object(training, "PRETRAINING_STEPS", 4), patch.object(training_stages, "PRETRAINING_STEPS", 4):
        page.estimate(tmp_path, run, settings, {"shadings": mine})
    (image,) = read_document(run.textures_json, dict)["images"]
    color = read_radiance(run.root / image["base_color"])
    assert swapped and color.shape == (64, 64, 3) and 0.0 < np.median(color) < 1.0


def test_it_is_one_page() -> None:
    assert len(PAGE.read_text().splitlines()) <= 80
