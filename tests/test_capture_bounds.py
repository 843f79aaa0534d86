# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers, sizes and counts that no capture has are refused in words, whoever has written them."""

from __future__ import annotations

import csv
import json
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest

from benchmarks import fuzz_samples, fuzz_targets
from fipt_blender.core.alignment.mesh_file import read_mesh
from fipt_blender.core.capture.depth_images import DepthView, read_depth
from fipt_blender.core.capture.formats.registry import read_points, read_rig
from fipt_blender.core.capture.formats.rig_files import stored_rotation
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder
from samples.counted import counted_calls
from samples.refusals import error_of

HUGE = "9" * 400


def run_ingest(capture: Path, root: Path, **options) -> tuple[RunFolder, list[str]]:
    """The run folder and the codes of the warnings."""
    run, lines = RunFolder(root), []

    class Stream:
        def write(self, text: str) -> None:
            lines.append(text)

        def flush(self) -> None:
            pass

    ingest(capture, run, CaptureOptions(**options), Reporter(Stream()))
    messages = [json.loads(line) for line in "".join(lines).splitlines()]
    return run, [message["code"] for message in messages if message["type"] == "warning"]


def edit(path: Path, change) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


# ------------------------------------------------------------------------------------- cameras and scales


@pytest.mark.parametrize("length", [1e-308, 1.0, 1e300])
def test_quaternions_of_any_length(length: float) -> None:
    half = length * np.sqrt(0.5)
    turned = stored_rotation(np.array([half, 0.0, 0.0, half])) @ [1.0, 0.0, 0.0]
    assert turned == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


def test_positions_are_checked_in_metres(tmp_path: Path) -> None:
    """What is far in the capture's unit may be near, and the other way round."""
    fuzz_samples.write_transforms(tmp_path)

    def move(data) -> None:
        data["frames"][1]["transform_matrix"][0][3] = 1e9

    edit(tmp_path / "transforms.json", move)
    run, _ = run_ingest(tmp_path, tmp_path / "run", scale=1e-3)
    assert load_capture(run).views[1].camera_to_world[0, 3] == pytest.approx(1e6)


def test_a_capture_json_of_others_has_the_same_bounds(tmp_path: Path) -> None:
    fuzz_samples.write_capture(tmp_path)
    stored = json.loads((tmp_path / "capture.json").read_text())
    for change, code in (
        ({"fx": 1e-5}, "intrinsics-invalid"),
        ({"cx": 1e300}, "intrinsics-invalid"),
        ({"camera_to_world": [[1, 0, 0, 1e9], *stored["views"][0]["camera_to_world"][1:]]}, "file-damaged"),
        ({"camera_to_world": (2.0 * np.eye(4)).tolist()}, "pose-not-rotation"),
    ):
        view = {**stored["views"][0], **change}
        (tmp_path / "capture.json").write_text(json.dumps({**stored, "views": [view]}))
        assert error_of(load_capture, RunFolder(tmp_path)).code == code


def test_points_at_infinity_are_left_out(tmp_path: Path) -> None:
    fuzz_samples.write_points(tmp_path)

    def move(data) -> None:
        for key, value in (("0", 1e308), ("1", 1e20)):
            data[0]["points"][key]["coordinates"][2] = value

    edit(tmp_path / "reconstruction.json", move)
    points = read_points(tmp_path, "opensfm")
    assert len(points) == 148 and np.abs(points).max() < 10.0


# ------------------------------------------------------------------------------------------------- meshes


@pytest.mark.parametrize("kind", ["int", "uint", "float"])
@pytest.mark.parametrize("name", ["vertex_indices", "vertex_index"])
def test_corners_of_a_ply_that_are_no_list(tmp_path: Path, kind: str, name: str) -> None:
    for form, body in (("ascii", b"0 0 0\n0\n"), ("binary_little_endian", bytes(16))):
        header = f"ply\nformat {form} 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        header += f"property float z\nelement face 1\nproperty {kind} {name}\nend_header\n"
        (tmp_path / "mesh.ply").write_bytes(header.encode() + body)
        error = error_of(read_mesh, tmp_path / "mesh.ply")
        assert error.code == "mesh-unreadable" and name in error.text


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
    next(target for target in fuzz_targets.TARGETS if target.name == name).write(tmp_path)
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
    next(target for target in fuzz_targets.TARGETS if target.name == name).write(tmp_path)
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
    target = next(target for target in fuzz_targets.TARGETS if target.name == "realityscan-csv")
    calls = []
    for count in (1_000, 4_000):
        folder = tmp_path / str(count)
        folder.mkdir()
        target.write(folder)
        path = next(folder.rglob("*.csv"))
        with path.open() as file:
            rows = list(csv.reader(file))
        with path.open("w", newline="") as file:
            csv.writer(file).writerows([*rows, *[rows[1]] * count])
        with counted_calls() as counted:
            run, warnings = run_ingest(folder, folder / "run")
        calls.append(counted.calls)
        assert len(load_capture(run).views) == len(rows) - 1 and "photograph-repeated" in warnings
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
    next(target for target in fuzz_targets.TARGETS if target.name == "realityscan-xmp").write(tmp_path)
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
