"""Numbers, sizes and counts that no capture has are refused in words, whoever has written them."""

from __future__ import annotations

import csv
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.depth_images import DepthView, read_depth
from fipt_blender.core.capture.formats.registry import read_points, read_rig
from fipt_blender.core.capture.formats.rig_files import stored_rotation
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.run.runfolder import RunFolder
from samples import fuzz_samples, fuzz_targets
from samples.counted import counted_calls
from samples.ingesting import edited_json, run_ingest, warnings
from samples.refusals import error_of

HUGE = "9" * 400


def write_sample(name: str, folder: Path) -> None:
    next(target for target in fuzz_targets.TARGETS if target.name == name).write(folder)


# ------------------------------------------------------------------------------------- cameras and scales


@pytest.mark.parametrize("length", [1e-308, 1.0, 1e300])
def test_quaternions_of_any_length(length: float) -> None:
    half = length * np.sqrt(0.5)
    turned = stored_rotation(np.array([half, 0.0, 0.0, half])) @ [1.0, 0.0, 0.0]
    assert turned == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


def test_positions_are_checked_in_metres(tmp_path: Path) -> None:
    """What is far in the capture's unit may be near, and the other way round."""
    fuzz_samples.write_transforms(tmp_path)
    with edited_json(tmp_path / "transforms.json") as data:
        data["frames"][1]["transform_matrix"][0][3] = 1e9
    run_ingest(tmp_path, RunFolder(tmp_path / "run"), scale=1e-3)
    assert load_capture(RunFolder(tmp_path / "run")).views[1].camera_to_world[0, 3] == pytest.approx(1e6)


def test_points_at_infinity_are_left_out(tmp_path: Path) -> None:
    fuzz_samples.write_points(tmp_path)
    with edited_json(tmp_path / "reconstruction.json") as data:
        data[0]["points"]["0"]["coordinates"][2], data[0]["points"]["1"]["coordinates"][2] = 1e308, 1e20
    points = read_points(tmp_path, "opensfm")
    assert len(points) == 148 and np.abs(points).max() < 10.0


# --------------------------------------------------------------------------------------------------- JSON


# The camera file of each reader in JSON, and a number in it that the reader uses.
NUMBERS = {
    "transforms": ("transforms.json", '"fl_x": 9.0'),
    "fipt-synthetic": ("train/transforms.json", '"camera_angle_x": 1.2'),
    "opensfm": ("reconstruction.json", '"width": 12'),
    "openmvg": ("sfm_data.json", '"focal_length": 9.0'),
    "meshroom": (None, '"sensorWidth": "6.4"'),
    "polycam": (None, '"width": 12'),
    "record3d": (None, '"w": 12'),
    "scannetpp": (None, '"w": 12'),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_huge_numbers_in_camera_files(tmp_path: Path, name: str) -> None:
    write_sample(name, tmp_path)
    file, number = NUMBERS[name]
    paths = [tmp_path / file] if file else [*tmp_path.rglob("*.json"), *tmp_path.rglob("*.sfm")]
    texts = {path: path.read_text() for path in paths if path.is_file()}
    path = next(path for path, text in texts.items() if number in text)
    path.write_text(texts[path].replace(number, f"{number.rpartition(' ')[0]} {HUGE}", 1))
    assert error_of(read_rig, tmp_path, "auto", CaptureOptions()).code == "rig-damaged"
    # In a field that nobody reads it does no harm.
    opening = "[{" if texts[path].lstrip().startswith("[") else "{"
    path.write_text(texts[path].replace(opening, f'{opening}"unread": {HUGE}, ', 1))
    assert read_rig(tmp_path, "auto", CaptureOptions()).views


# --------------------------------------------------------------------------------------- sizes and counts


@pytest.mark.parametrize(
    ("name", "file"), [("record3d", "metadata.json"), ("fipt-real", "cam.txt"), ("colmap-text", "images.txt")]
)
def test_a_camera_file_of_terabytes_is_not_read(tmp_path: Path, name: str, file: str) -> None:
    write_sample(name, tmp_path)
    path = next(tmp_path.rglob(file))
    with path.open("r+b") as opened:
        opened.truncate(1 << 40)  # of zeros that take no space
    tracemalloc.start()
    refused = error_of(read_rig, tmp_path, "auto", CaptureOptions()).code
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert refused in ("rig-damaged", "format-unknown", "cameras-missing")
    assert most < 10_000_000


def test_a_table_of_many_equal_rows(tmp_path: Path) -> None:
    """The work grows with the number of rows, not with its square."""
    calls = []
    for count in (120, 480):
        folder = tmp_path / str(count)
        folder.mkdir()
        write_sample("realityscan-csv", folder)
        path = next(folder.rglob("*.csv"))
        with path.open() as file:
            rows = list(csv.reader(file))
        with path.open("w", newline="") as file:
            csv.writer(file).writerows([*rows, *[rows[1]] * count])
        with counted_calls() as counted:
            told = warnings(run_ingest(folder, RunFolder(folder / "run")))
        calls.append(counted.calls)
        assert len(load_capture(RunFolder(folder / "run")).views) == len(rows) - 1 and "photograph-repeated" in told
    assert calls[1] < 5 * calls[0], calls


def test_a_later_depth_image_of_gigapixels(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 50_000, 50_000, 16, 0, 0, 0, 0)
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    view = DepthView(path, 12, 8, 9.0, 9.0, 6.0, 4.0, 0.001, np.eye(4))
    assert error_of(read_depth, view, 1.0).code == "depth-unreadable"


# ----------------------------------------------------------------------------------------------- XMP files


def test_xmp_files_without_a_pose_are_told(tmp_path: Path) -> None:
    write_sample("realityscan-xmp", tmp_path)
    paths = sorted(tmp_path.rglob("*.xmp"))
    whole = paths[1].read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", whole.replace(b"<", b"\0", 1)):
        paths[1].write_bytes(damaged)
        error = error_of(read_rig, tmp_path, "auto", CaptureOptions())
        assert error.code == "rig-damaged" and paths[1].name in error.text
    text = whole.decode()
    # As RealityScan writes one of a photograph that it could not align, and as other programs write theirs.
    unaligned = text.replace("Position", "Nothing").replace("Rotation", "Nothing2")
    paths[1].write_text(unaligned)
    rig = read_rig(tmp_path, "auto", CaptureOptions())
    assert len(rig.views) == len(paths) - 1 and [note.code for note in rig.notes] == ["pose-lost"]
    paths[1].write_text("<x:xmpmeta xmlns:x='adobe:ns:meta/'/>")
    assert [note.code for note in read_rig(tmp_path, "auto", CaptureOptions()).notes] == ["images-unused"]
