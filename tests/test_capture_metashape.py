# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers of Metashape and RealityScan: poses to 1e-5, and pixels of points in the room to 1e-4."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.radial import MOST_ERROR
from samples import rig_writers as write
from samples.camera_poses import random_rotation
from samples.metashape_writers import (
    Chunk,
    metashape_chunk,
    metashape_sensor,
    write_metashape,
    write_realityscan_colmap,
    write_realityscan_csv,
    write_realityscan_xmp,
)
from samples.rig_checks import assert_same, error_of, read

BROWN3 = write.Style((-0.12, 0.03, -0.006), (0.002, -0.001))


def moved_chunk(shots: list[write.Shot]) -> Chunk:
    rotation = random_rotation(np.random.default_rng(5))
    return Chunk(shots, 0.0254, rotation, np.array([12.0, -3.0, 0.5]))


@pytest.mark.parametrize("component", [False, True])
@pytest.mark.parametrize(
    "style",
    [replace(BROWN3, aspect=1.01), write.Style((-0.1, 0.02, -0.004, 0.001), (0.002, -0.001), fisheye=True)],
)
def test_metashape(tmp_path: Path, style: write.Style, component: bool) -> None:
    shots = write.make_shots(style)
    write.write_photographs(tmp_path, shots)
    write_metashape(tmp_path, [metashape_chunk(moved_chunk(shots), component)])
    for path in (tmp_path, tmp_path / "cameras.xml"):
        rig = read(path)
        assert rig.source == "metashape" and rig.up_axis is None and not rig.notes
        assert_same(rig, shots)


def test_metashape_with_a_fourth_radial_coefficient_is_fitted(tmp_path: Path) -> None:
    shots = write.make_shots(write.Style((-0.2, 0.06, -0.02, 0.004), (0.002, -0.001)))
    write.write_photographs(tmp_path, shots)
    write_metashape(tmp_path, [metashape_chunk(Chunk(shots))])
    assert_same(read(tmp_path), shots, pixels=MOST_ERROR)


def test_metashape_rig_follows_its_master(tmp_path: Path) -> None:
    first, second = write.make_shots(BROWN3, count=2)
    chunk = moved_chunk([first, second])
    inside = np.linalg.inv(chunk.inside(first)) @ chunk.inside(second)
    rotation, translation = write.text(inside[:3, :3]), write.text(inside[:3, 3])
    offset = f"<rotation>{rotation}</rotation><translation>{translation}</translation>"
    document = metashape_chunk(replace(chunk, shots=[first]))
    document = document.replace("</sensors>", metashape_sensor(1, second, offset) + "</sensors>")
    slave = f'<camera id="1" sensor_id="1" master_id="0" label="{Path(second.name).stem}"/>'
    write.write_photographs(tmp_path, [first, second])
    write_metashape(tmp_path, [document.replace("</cameras>", slave + "</cameras>")])
    assert_same(read(tmp_path), [first, second])


def test_metashape_reads_the_largest_of_several_chunks(tmp_path: Path) -> None:
    shots = write.make_shots(count=4)
    write.write_photographs(tmp_path, shots)
    chunks = [metashape_chunk(Chunk(part)) for part in (shots[:1], shots[1:])]
    write_metashape(tmp_path, chunks)
    rig = read(tmp_path)
    assert_same(rig, shots[1:])
    assert [note.code for note in rig.notes] == ["several-models"] and "(1, 3 " in rig.notes[0].text


def test_metashape_with_geographic_coordinates_is_named(tmp_path: Path) -> None:
    shots = write.make_shots(count=2)
    chunk = Chunk(
        [replace(shot, centre=shot.centre + 4e6) for shot in shots], 1.0, np.eye(3), np.full(3, 4e6)
    )
    write_metashape(tmp_path, [metashape_chunk(chunk)])
    assert [note.code for note in read(tmp_path).notes] == ["georeferenced"]


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ('type="frame"', 'type="spherical"', "camera-model"),
        ("<k1>", "<b2>0.5</b2><k1>", "camera-model"),
        ("<f>", "<g>", "rig-damaged"),
        ("</cx>", "x</cx>", "rig-damaged"),
        ('<?xml version="1.0" encoding="UTF-8"?>', '<!DOCTYPE a [<!ENTITY b "c">]>', "rig-damaged"),
        ("<scale>0.0254", "<scale>-1", "rig-damaged"),
    ],
)
def test_metashape_that_cannot_be_used(tmp_path: Path, old: str, new: str, code: str) -> None:
    write_metashape(tmp_path, [metashape_chunk(moved_chunk(write.make_shots(BROWN3, 1)))])
    document = (tmp_path / "cameras.xml").read_text()
    assert old in document
    (tmp_path / "cameras.xml").write_text(document.replace(old, new))
    assert error_of(read, tmp_path).code == code


def test_metashape_sensor_without_calibration(tmp_path: Path) -> None:
    write_metashape(tmp_path, [metashape_chunk(Chunk(write.make_shots(count=1)))])
    document = (tmp_path / "cameras.xml").read_text().replace("calibration", "covariance")
    (tmp_path / "cameras.xml").write_text(document)
    assert error_of(read, tmp_path).code == "intrinsics-missing"


@pytest.mark.parametrize("writer", [write_realityscan_csv, write_realityscan_xmp])
def test_realityscan(tmp_path: Path, writer) -> None:
    shots = write.make_shots(BROWN3)
    writer(tmp_path, shots)
    rig = read(tmp_path)
    assert rig.source == "realityscan" and rig.up_axis == "z"
    assert_same(rig, shots)


def test_realityscan_xmp_values_may_be_attributes(tmp_path: Path) -> None:
    shots = write.make_shots(BROWN3, 1)
    write_realityscan_xmp(tmp_path, shots)
    path = tmp_path / f"{Path(shots[0].name).stem}.xmp"
    document = path.read_text()
    start, end = document.index("      <xcr:Rotation>"), document.index("      <xcr:Position>")
    attribute = (
        document[start:end]
        .strip()
        .replace("<xcr:Rotation>", 'xcr:Rotation="')
        .replace("</xcr:Rotation>", '"')
    )
    path.write_text((document[:start] + document[end:]).replace('xcr:Skew="0"', f'xcr:Skew="0" {attribute}'))
    assert_same(read(tmp_path), shots)


def test_realityscan_colmap_export(tmp_path: Path) -> None:
    shots = write.make_shots(write.Style(aspect=1.01))
    write_realityscan_colmap(tmp_path, shots)
    rig = read(tmp_path)
    assert rig.source == "colmap"
    assert_same(rig, shots)


@pytest.mark.parametrize(
    ("old", "new"), [("brown4t2", "division"), ('Skew="0"', 'Skew="0.1"'), ('Ratio="1"', 'Ratio="1.1"')]
)
def test_realityscan_lenses_that_are_not_supported(tmp_path: Path, old: str, new: str) -> None:
    write_realityscan_xmp(tmp_path, write.make_shots(BROWN3, 1))
    path = tmp_path / "IMG_0000.xmp"
    path.write_text(path.read_text().replace(old, new))
    assert error_of(read, tmp_path).code == "camera-model"


@pytest.mark.parametrize("writer", [write_realityscan_csv, write_realityscan_xmp])
def test_sizes_that_only_photographs_have_need_the_photographs(tmp_path: Path, writer) -> None:
    writer(tmp_path, write.make_shots(BROWN3, 2))
    (tmp_path / "IMG_0001.jpg").unlink()
    error = error_of(read, tmp_path)
    assert error.code == "image-missing" and "IMG_0001" in error.text
