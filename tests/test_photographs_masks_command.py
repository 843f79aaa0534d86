# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `masks` on a small run, with tiny models."""

from __future__ import annotations

import io
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.images import read_ids, write_exr, write_ids
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.photographs import masks_command, masks_model
from fipt_blender.core.photographs.masks_model import open_masks_model
from fipt_blender.core.photographs.tonemap import network_picture
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from samples.refusals import error_of

pytest.importorskip("transformers")
from samples import mask_models

CODES = np.random.default_rng(1).integers(0, 256, (3, 4, 3), np.uint8).repeat(16, axis=0).repeat(16, axis=1)
LENS = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}
OWN = np.full((48, 64), 7, np.int32)
FOUND = ["train/a", "train/b", "val/d"]  # of the views of capture.json that have no masks


@pytest.fixture(scope="module")
def sam(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return mask_models.write_sam(tmp_path_factory.mktemp("sam"), mask_models.make_sam())


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """Five views: one that is not HDR, one with part masks, one held back, and one that is not ticked."""
    folder = RunFolder(tmp_path / "run")
    folder.create(make_settings())
    views = []
    for name in ("train/a", "train/b", "train/c", "val/d", "train/e"):
        path = tmp_path / f"{name[-1]}.exr"
        split = "held_back" if name.startswith("val") else "train"
        view = {"name": name, "split": split, **LENS, "camera_to_world": np.eye(4).tolist()}
        view |= {"parts": None, "semantics": None, "mask": None}
        if name == "train/b":
            path = path.with_suffix(".png")
            Image.fromarray(CODES).save(path)
            view |= {"encoded": True, "exposure": None}
        else:
            write_exr(path, (CODES / 255.0).astype(np.float32) ** 2.2 * 30.0)
        if name == "train/c":
            write_ids(tmp_path / "own.png", OWN)
            view["parts"] = str(tmp_path / "own.png")
        views.append({**view, "image": str(path)})
    data = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    data |= {"world_from_source": np.eye(4).tolist()}
    write_json(folder.ingest_json, {**data, "views": views})
    write_json(folder.capture_json, {**data, "views": views[:4]})
    return folder


def find_masks(run: RunFolder, model: Path) -> int:
    """Run the command; returns of how many views it has found masks."""
    stream = io.StringIO()
    masks_command.run(Namespace(run=run.root, model=model), Reporter(stream))
    done = parse_message(stream.getvalue().splitlines()[-1])
    return done["data"]["found"]


def entries(path: Path, kind: str) -> dict[str, str | None]:
    return {view["name"]: view[kind] for view in read_json(path)["views"]}


def test_views_without_part_masks_get_regions(run: RunFolder, sam: Path, tmp_path: Path) -> None:
    assert find_masks(run, sam) == 3
    wanted = {name: f"masks/parts/{name}.png" for name in FOUND} | {"train/c": str(tmp_path / "own.png")}
    assert entries(run.capture_json, "parts") == wanted
    assert entries(run.ingest_json, "parts") == {**wanted, "train/e": None}
    assert set(entries(run.capture_json, "semantics").values()) == {None}
    views = {view.name: view for view in load_capture(run).views}
    assert np.array_equal(views["train/c"].part_ids(), OWN)
    finder = open_masks_model(sam)
    shown = {"train/a": network_picture(views["train/a"].radiance()), "train/b": CODES}
    for name, picture in shown.items():
        ids = views[name].part_ids()
        assert np.array_equal(ids, finder(picture)) and len(np.unique(ids)) > 2


def test_models_see_large_photographs_averaged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ids are those of the pixel of the smaller picture at the place."""
    monkeypatch.setattr(masks_model, "MOST_SIDE", 6)
    sides = np.repeat(np.float32([1.0, 3.0]), 6)[None, :, None] * np.ones((8, 1, 3), np.float32)
    ids = masks_model.find_masks(lambda picture: picture[..., 0].astype(np.int32), sides, np.uint8)
    assert ids.shape == (8, 12) and np.array_equal(ids, sides[..., 0])


def test_masks_are_found_again_only_where_something_has_changed(run: RunFolder, sam: Path) -> None:
    imported = [(path, path.read_bytes()) for path in (run.ingest_json, run.capture_json)]
    find_masks(run, sam)
    with_masks = run.capture_json.read_bytes()
    for path, content in imported:  # as another import of the same capture writes it
        path.write_bytes(content)
    assert find_masks(run, sam) == 0 and run.capture_json.read_bytes() == with_masks
    image = load_capture(run).views[0].image
    write_exr(image, np.full((48, 64, 3), 0.5, np.float32))
    assert find_masks(run, sam) == 1
    image.rename(image.with_suffix(".aside"))
    assert error_of(find_masks, run, sam).code == "image-missing"


def test_a_stopped_command_goes_on_where_it_was(run: RunFolder, sam: Path, tmp_path: Path) -> None:
    photograph = tmp_path / "d.exr"
    photograph.rename(tmp_path / "aside")
    with pytest.raises(FiptError):
        find_masks(run, sam)
    assert set(entries(run.ingest_json, "parts").values()) == {None, str(tmp_path / "own.png")}
    (tmp_path / "aside").rename(photograph)
    assert find_masks(run, sam) == 1
    assert sum(path is not None for path in entries(run.ingest_json, "parts").values()) == 4


def test_another_kind_of_model_replaces_what_was_found(run: RunFolder, sam: Path, tmp_path: Path) -> None:
    find_masks(run, sam)
    eomt = mask_models.write_segmenter(tmp_path / "eomt", mask_models.make_eomt())
    assert find_masks(run, eomt) == 4, "of the view with part masks, too"
    for path in (run.capture_json, run.ingest_json):
        parts, semantics = entries(path, "parts"), entries(path, "semantics")
        assert parts.pop("train/c") == str(tmp_path / "own.png") and set(parts.values()) == {None}
        names = [*FOUND, "train/c"]
        assert {semantics[name] for name in names} == {f"masks/semantics/{name}.png" for name in names}
    assert not (run.masks / "parts").exists()
    assert set(np.unique(read_ids(run.masks / "semantics" / "train" / "a.png"))) <= set(range(5))
    # Readers look for the names of classes beside a mask.
    assert read_json(run.masks / "semantics" / "train" / "classes.json")["1"] == "floor"
    assert find_masks(run, sam) == 3 and not (run.masks / "semantics").exists()
