"""Captures that `ingest` refuses: a clear error, and no file written."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.paths import foreign_fault, is_network, leads_outside
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.prepare.preparation import PreparationFolder, read_preparation
from samples import fuzz_samples
from samples.capture_files import make_samples, write_transforms
from samples.child_processes import posix
from samples.ingesting import edited_json, put, run_ingest, set_pixels
from samples.refusals import error_of


@pytest.fixture
def run(tmp_path):
    return RunFolder(tmp_path / "run")


def change_frame(folder: Path, index: int = 1, **values: object) -> None:
    with edited_json(folder / "transforms.json") as data:
        data["frames"][index].update(values)


def change_pose(folder: Path, change: np.ndarray, x: float | None = None) -> None:
    with edited_json(folder / "transforms.json") as data:
        matrix = np.array(data["frames"][1]["transform_matrix"]) @ change
        matrix[0, 3] = matrix[0, 3] if x is None else x
        data["frames"][1]["transform_matrix"] = matrix.tolist()


def rename(folder: Path, suffix: str) -> None:
    path = folder / "images" / "001_0001"
    path.with_suffix(".exr").unlink()
    path.with_suffix(suffix).write_bytes(b"x")
    change_frame(folder, file_path=f"images/001_0001{suffix}")


def black(folder: Path) -> None:
    for index in range(3):
        set_pixels(folder.parent, lambda pixels: pixels * 0.0, f"{index:03d}_0001")


# Code of the refusal, and what is done to the capture's folder.
BAD = {
    "missing": ("image-missing", lambda p: (p / "images/001_0001.exr").unlink()),
    "size": ("image-size", lambda p: set_pixels(p.parent, lambda x: x[:-1])),
    "nan": ("image-not-finite", lambda p: set_pixels(p.parent, lambda x: put(x, np.nan))),
    "inf": ("image-not-finite", lambda p: set_pixels(p.parent, lambda x: put(x, np.inf))),
    "negative": ("image-negative", lambda p: set_pixels(p.parent, lambda x: put(x, -0.1))),
    "turned": ("image-size", lambda p: set_pixels(p.parent, lambda x: x.swapaxes(0, 1))),
    "folding lens": ("camera-model", lambda p: change_frame(p, k1=-0.8)),
    "other format": ("image-format", lambda p: rename(p, ".bmp")),
    "damaged png": ("image-unreadable", lambda p: rename(p, ".png")),
    "black": ("image-black", black),
    "unreadable": ("image-unreadable", lambda p: (p / "images/001_0001.exr").write_text("x")),
    "scaled": ("pose-not-rotation", lambda p: change_pose(p, 1.01 * np.eye(4))),
    "mirrored": ("pose-not-rotation", lambda p: change_pose(p, np.diag([-1, 1, 1, 1]))),
    "nan pose": ("pose-not-rotation", lambda p: change_pose(p, np.eye(4), np.nan)),
    "far": ("pose-far", lambda p: change_pose(p, np.eye(4), -1e9)),
    "short": ("intrinsics-invalid", lambda p: change_frame(p, fl_x=1e-5)),
    "long": ("intrinsics-invalid", lambda p: change_frame(p, fl_x=1e308)),
    "focal": ("intrinsics-invalid", lambda p: change_frame(p, fl_x=-40.0)),
    "centre": ("intrinsics-invalid", lambda p: change_frame(p, cx=400.0)),
    "mask size": ("mask-size", lambda p: write_exr(p / "parts/001_0001.exr", np.ones((4, 4)))),
    "mask": ("mask-not-ids", lambda p: write_exr(p / "parts/001_0001.exr", np.full((48, 32), 0.5))),
    "no frames": ("no-views", lambda p: (p / "transforms.json").write_text('{"frames": []}')),
    "no format": ("cameras-missing", lambda p: (p / "transforms.json").unlink()),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_captures_leave_nothing_behind(tmp_path, run, case):
    code, spoil = BAD[case]
    # the first view is distorted, so that a late error would find its image already written
    samples = make_samples(3)
    samples[0] = make_samples(1, model="OPENCV")[0]
    write_transforms(tmp_path / "in", samples)
    spoil(tmp_path / "in")
    caught = error_of(run_ingest, tmp_path / "in", run)
    assert caught.code == code and caught.text and not run.root.exists()
    run.create(make_settings())
    before = sorted(run.root.rglob("*"))
    assert error_of(run_ingest, tmp_path / "in", run).code == code
    assert sorted(run.root.rglob("*")) == before and not run.capture_json.exists()


@pytest.mark.parametrize(
    "options", [*({"scale": scale} for scale in (0.0, float("nan"), 1e7, 1e-308)), {"hold_back": 1}, {"hold_back": -3}]
)
def test_bad_options(tmp_path, run, options):
    write_transforms(tmp_path / "in", make_samples(2))
    assert error_of(run_ingest, tmp_path / "in", run, **options).code == "setting-invalid"
    assert not run.root.exists()


def test_run_of_another_version_is_left_alone(tmp_path, run):
    write_transforms(tmp_path / "in", make_samples(2))
    run.create(make_settings())
    with edited_json(run.run_json) as data:
        data["version"] = 99
    assert error_of(run_ingest, tmp_path / "in", run).code == "run-version" and not run.capture_json.exists()


def test_full_disk_while_writing(tmp_path, run, monkeypatch):
    """The disk is full at the second undistorted image: the first is deleted, capture.json not written."""
    write_transforms(tmp_path / "in", make_samples(3, model="OPENCV"))
    calls = []

    def full(path, array, half=False):
        calls.append(path)
        if len(calls) == 2:
            raise FiptError.of("disk-full", f"The disk is full; {path}.", "Free some space.")
        write_exr(path, array, half)

    monkeypatch.setattr("fipt_blender.core.capture.photograph.write_exr", full)
    assert error_of(run_ingest, tmp_path / "in", run).code == "disk-full"
    assert not run.capture_json.exists() and not list(run.images.rglob("*.exr"))


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(5, "Input/output error")])
@pytest.mark.parametrize("place", ["photograph.write_exr", "ingest.write_mesh", "ingest.write_json"])
def test_an_import_that_is_stopped_anywhere_leaves_no_run_folder(tmp_path, run, monkeypatch, place, error):
    def stop(*_, **__):
        raise error

    write_transforms(tmp_path / "in", make_samples(3, model="OPENCV"))
    monkeypatch.setattr(f"fipt_blender.core.capture.{place}", stop)
    with pytest.raises(type(error)):
        run_ingest(tmp_path / "in", run)
    assert not run.root.exists()


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda data, view: data.update(version=2), "capture-version"),
        (lambda data, view: view.pop("fx"), "file-damaged"),
        (lambda data, view: view.update(fx=1e-5), "intrinsics-invalid"),
        (lambda data, view: view.update(cx=1e300), "intrinsics-invalid"),
        (lambda data, view: view.update(camera_to_world=[1, 2]), "file-damaged"),
        (lambda data, view: view["camera_to_world"][0].__setitem__(3, 1e9), "file-damaged"),
        (lambda data, view: view.update(camera_to_world=(2.0 * np.eye(4)).tolist()), "pose-not-rotation"),
    ],
)
def test_changed_capture_json_is_refused(tmp_path, change, code):
    fuzz_samples.write_capture(tmp_path)
    load_capture(RunFolder(tmp_path))
    with edited_json(tmp_path / "capture.json") as data:
        change(data, data["views"][0])
    assert error_of(load_capture, RunFolder(tmp_path)).code == code


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Two photographs in the capture, one of the same kind outside, in a folder whose name begins alike."""
    write_transforms(tmp_path / "capture", make_samples(2))
    (tmp_path / "capture-other").mkdir()
    inside = tmp_path / "capture" / "images" / "000_0001.exr"
    (tmp_path / "capture-other" / "secret.exr").write_bytes(inside.read_bytes())
    return tmp_path / "capture"


@pytest.mark.parametrize("key", ["file_path", "mask_path"])
def test_paths_that_lead_outside_are_refused(capture: Path, key: str) -> None:
    """Except into the user's folder, and in our own files."""
    outside = capture.parent / "capture-other" / "secret.exr"
    for path in (
        "../capture-other/secret.exr",
        "images/../../capture-other/secret.exr",
        "..\\\\capture-other\\\\secret.exr",
        str(outside),
    ):
        change_frame(capture, 0, **{key: path})
        error = error_of(read_rig, capture, "auto", CaptureOptions())
        assert error.code == "path-outside" and "--images" in error.remedy
    if key == "file_path":
        for options in (CaptureOptions(images=outside.parent), CaptureOptions(own_paths=True)):
            assert read_rig(capture, "auto", options).views[0].image == outside


def test_paths_inside_stay_usable(capture: Path) -> None:
    inside = capture / "images" / "000_0001.exr"
    for path in (str(inside), "./images/000_0001.exr", "images/../images/000_0001.exr"):
        change_frame(capture, 0, file_path=path)
        assert read_rig(capture, "auto", CaptureOptions()).views[0].image.resolve() == inside.resolve()
    # A photograph that was moved together with the file is found by its name.
    change_frame(capture, 0, file_path="/gone/elsewhere/000_0001.exr")
    (capture / "000_0001.exr").write_bytes(inside.read_bytes())
    assert read_rig(capture, "auto", CaptureOptions()).views[0].image == capture / "000_0001.exr"


NETWORK = ("//server/share/a.exr", "\\\\server\\share\\a.exr", "\\\\.\\COM1", "\\\\?\\C:\\a.exr", "/\\server/a.exr")


@pytest.mark.parametrize("path", NETWORK)
def test_no_path_leads_to_another_computer_or_a_device(tmp_path: Path, path: str) -> None:
    assert is_network(path) and leads_outside(tmp_path, path) and foreign_fault(path)
    assert error_of(RunFolder(tmp_path).resolve, path).code == "path-outside"


def test_paths_of_the_synthetic_layout_stay_inside(tmp_path: Path) -> None:
    fuzz_samples.write_fipt_synthetic(tmp_path / "capture")
    (tmp_path / "secret.exr").write_bytes(b"x")
    train = tmp_path / "capture" / "train"
    for path in (str(tmp_path / "secret.exr"), "../../secret.exr", *NETWORK[:2]):
        change_frame(train, 0, file_path=path)
        assert error_of(read_rig, tmp_path / "capture", "auto", CaptureOptions()).code == "path-outside"
    change_frame(train, 0, file_path="./Image/000_0001.exr")
    rig = read_rig(tmp_path / "capture", "auto", CaptureOptions())
    assert rig.views[0].image.resolve() == (train / "Image" / "000_0001.exr").resolve()


@posix
def test_a_capture_json_names_images_and_meshes_of_this_computer_only(tmp_path: Path) -> None:
    fuzz_samples.write_capture(tmp_path / "run")
    file = tmp_path / "run" / "capture.json"
    data = json.loads(file.read_text())
    (tmp_path / "a.exr").write_bytes(b"x")
    os.mkfifo(tmp_path / "pipe.exr")
    for key, allowed in (("image", "a.exr"), ("mesh", "room.obj")):
        holder = data if key == "mesh" else data["views"][0]
        kept = holder[key]
        holder[key] = str(tmp_path / allowed)  # which need not exist
        file.write_text(json.dumps(data))
        load_capture(RunFolder(tmp_path / "run"))
        for path in ("/etc/passwd", str(tmp_path / "pipe.exr"), "../a.exr", "/proc/self/environ"):
            holder[key] = path
            file.write_text(json.dumps(data))
            caught = error_of(load_capture, RunFolder(tmp_path / "run"))
            assert caught.code == "path-outside" and path in caught.text
        holder[key] = kept


def test_a_prepare_json_names_photographs_of_its_folder_only(tmp_path: Path) -> None:
    fuzz_samples.write_preparation(tmp_path)
    folder = PreparationFolder(tmp_path)
    data = json.loads(folder.prepare_json.read_text())
    assert len(read_preparation(folder).photographs) == 2
    for path in ("/etc/passwd", "../../a.exr", "a/../../b.exr", *NETWORK[:2]):
        changed = json.loads(json.dumps(data))
        changed["photographs"][0]["path"] = changed["groups"][0]["photographs"][0] = path
        folder.prepare_json.write_text(json.dumps(changed))
        assert "leads out of" in str(error_of(read_preparation, folder))
    changed = {**data, "settings": {**data["settings"], "cameras": "//server/share"}}
    folder.prepare_json.write_text(json.dumps(changed))
    assert error_of(read_preparation, folder).code == "path-network"
